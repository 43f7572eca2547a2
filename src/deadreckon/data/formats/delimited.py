"""Reading of delimited text files (CSV and its dialects, plain or gzipped) as pyarrow tables."""

import codecs
import csv
import io
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow

from deadreckon.data.arrow import compute as _compute
from deadreckon.data.arrow import is_string
from deadreckon.data.formats.cells import MISSING, NOTHING, Known, converted, with_dates, without
from deadreckon.data.formats.dialect import HEAD, Dialect, sniff
from deadreckon.data.formats.marks import LARGEST, of_large
from deadreckon.data.formats.spool import Spool
from deadreckon.data.formats.words import with_words
from deadreckon.errors import UserError, reading
from deadreckon.foreign.door import opened, unpacked
from deadreckon.names import repeated

_BLOCK = 1 << 22  # bytes that are parsed at once; no row may be longer
_SEEN = 2_000  # rows at the beginning, whose cells `sniff` has examined as texts
_NULLS = (*MISSING, "-nan", "-NaN", "#N/A N/A", "1.#QNAN", "-1.#IND")


def read_delimited(
    path: Path | str, asked: Dialect, spool: Spool | None = None, known: Known = NOTHING
) -> tuple[pa.Table, Dialect, list[str]]:
    """Reads a delimited text file.

    Types are those that fit all cells of a column: integers, numbers, truth values, dates, else texts.

    Args:
        path: of the file, plain or gzipped.
        asked: the known part of its dialect.
        spool: where columns are kept; None: in memory.
        known: the types of some columns.

    Returns:
        The table, the dialect in which it was read, and messages, one line for each difference from plain CSV and for each
        assumption that may be wrong.

    Raises:
        UserError: one line with the file and the line or the column.
    """
    with reading(path, "CSV"), opened(path) as file:
        source = unpacked(path, file)
        table, dialect, told = _read(path, source, asked, spool, known)
        if known.plain:  # read again, because the types must not depend on which columns are kept
            source.seek(0)
            texts = _read(path, source, asked, None, Known(known.texts | set(known.plain)))[0]
            for name in known.plain:
                if name in texts.column_names:
                    known.keep(name, without(texts[name], ("",)) if is_string(texts[name].type) else texts[name])
    table, order, lines = converted(table, dialect, spool, known._replace(plain=None))
    return table, with_dates(dialect, order), told + lines


def _read(
    path: Path | str, source: BinaryIO, asked: Dialect, spool: Spool | None, known: Known
) -> tuple[pa.Table, Dialect, list[str]]:
    """The table as pyarrow reads it, its dialect, and messages."""
    head, whole = _head(source)
    dialect, told = sniff(path, head, whole, asked)
    source.seek(0)
    table = with_words(_parsed(path, source, dialect, spool, known), source, _options(dialect), spool, known)
    told += _of_zeros(source, table, dialect, spool) + _of_large(source, table, dialect)
    told += _of_names(table.column_names)
    table = _named(path, table)
    table, lines = _decoded(path, table, dialect, known=asked.encoding is not None or not head.isascii())
    told += lines
    dialect = replace(dialect, encoding=None if lines else asked.encoding)  # it has two, or the next file may have another
    table, lines = _without_empty(table)
    told += lines
    told += _of_quotes(path, table, dialect)
    if not table.num_rows:
        raise UserError(f"{path}: the log has no rows, only a line of names")
    return table, dialect, told


def _head(source: BinaryIO) -> tuple[bytes, bool]:
    """The first bytes of the file, with at least three line ends if it has so many, and whether they are the whole file."""
    head = source.read(HEAD)
    while head.count(b"\n") + head.count(b"\r") < 3:
        more = source.read(HEAD)
        if not more:
            return head, True
        head += more
    return head, not source.read(1)


def _options(dialect: Dialect) -> tuple[arrow.ReadOptions, arrow.ParseOptions]:
    """pyarrow's options for reading and parsing a file."""
    read = arrow.ReadOptions(encoding=dialect.encoding, skip_rows=dialect.skip or 0, block_size=_BLOCK)
    # Line ends within quotes may occur anywhere; allowing them has no measurable cost.
    return read, arrow.ParseOptions(delimiter=dialect.separator, quote_char=dialect.quote, newlines_in_values=True)


def _parsed(path: Path | str, source: BinaryIO, dialect: Dialect, spool: Spool | None, known: Known) -> pa.Table:
    read, parse = _options(dialect)
    convert: dict[str, Any] = {"decimal_point": dialect.decimal, "null_values": _NULLS}
    convert |= {"column_types": dict.fromkeys(known.texts, pa.string())} if known.texts else {}
    try:
        if spool is not None:
            return spool.read(source, read, parse, convert)
        return arrow.read_csv(source, read, parse, arrow.ConvertOptions(**convert))
    except (pa.ArrowInvalid, UnicodeError) as error:
        _diagnose(path, dialect)
        text = " ".join(str(error).split())
        if "Empty CSV" in text:
            raise UserError(f"{path}: the log has no rows, only a line of names") from error
        raise UserError(f"{path}: cannot be read as CSV, it is damaged or cut short ({text[:200]})") from error


def _of_large(source: BinaryIO, table: pa.Table, dialect: Dialect) -> list[str]:
    """Messages on columns of whole numbers that exceed 64-bit integers only in rows that `sniff` has not examined.

    They became columns of floats; only such columns are read again, as texts.
    """
    names, twice = [], set(repeated(table.column_names))
    for name, values in () if table.num_rows <= _SEEN else zip(table.column_names, table.columns, strict=True):
        if pa.types.is_floating(values.type) and name not in twice:
            high, head = _compute.max(values).as_py(), values[:_SEEN].drop_null()
            whole = len(head) and _compute.all(_compute.equal(head, _compute.floor(head))).as_py()
            names += [name] if high is not None and high >= LARGEST and whole else []
    if not names:
        return []
    source.seek(0)
    convert = arrow.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.string()))
    found: dict[str, str] = {}
    for batch in arrow.open_csv(source, *_options(dialect), convert):
        for name in names:
            cells = _compute.utf8_trim_whitespace(batch.column(name))
            cells = cells.filter(_compute.match_substring_regex(cells, r"^\d{19,}$")).to_pylist()
            odd = next((cell for cell in cells if int(cell) >= LARGEST), None)
            found |= {name: odd} if odd is not None and name not in found else {}
    return [f"column {_clean(name)}: {of_large(cell)}" for name, cell in found.items()]


def _diagnose(path: Path | str, dialect: Dialect) -> None:
    """Refuses the first row that cannot be read, with its line number; does nothing if there is none."""
    with opened(path) as file:  # opened again, because threads of pyarrow may still be reading from the other file object
        _refuse_rows(path, io.TextIOWrapper(unpacked(path, file), dialect.encoding or "utf-8", newline=""), dialect)


def _refuse_rows(path: Path | str, lines: io.TextIOWrapper, dialect: Dialect) -> None:
    line, width = 1, 0
    try:
        reader = csv.reader(lines, delimiter=dialect.separator or ",", quotechar=dialect.quote, strict=True)
        while True:
            line = reader.line_num + 1
            cells = next(reader, None)
            if cells is None:
                return
            if line <= (dialect.skip or 0) or not cells:
                continue
            width = width or len(cells)
            if len(cells) != width:
                raise UserError(
                    f"{path}: line {line} has {len(cells)} cell{'s' * (len(cells) > 1)}, the line of names has {width}: "
                    f"{str(dialect.separator).join(cells)[:60]!r}; is a separator missing or too many, or does a text that "
                    "holds one lack its quotes?"
                )
    except UnicodeError as error:
        raise UserError(
            f"{path}: line {line} or a later one is not {dialect.encoding}; name the encoding (--encoding)"
        ) from error
    except csv.Error as error:
        if "end of data" in str(error) or "field larger" in str(error):
            text = f"a quote ({dialect.quote}) opens a text and none closes it"
        else:
            text = f"a text in quotes does not end at a separator ({error})"
        raise UserError(f"{path}: in line {line} {text}; a quote within a text is written twice") from error


def _of_zeros(source: BinaryIO, table: pa.Table, dialect: Dialect, spool: Spool | None) -> list[str]:
    """Messages on columns of whole numbers of which some are written with leading zeros, like codes.

    The parsed numbers do not show them, so the columns are read again, as bytes.
    """
    twice = set(repeated(table.column_names))
    names = [name for name in table.column_names if name not in twice]
    names = [name for name in names if pa.types.is_integer(table.schema.field(name).type)]
    found: dict[str, str] = {}
    if not names or not _may_have_zeros(source, dialect):
        return []
    if spool is not None:
        batches: Iterable[pa.RecordBatch] = spool.cells.select(names).to_batches()
    else:
        source.seek(0)
        texts = dict.fromkeys(names, pa.binary())
        convert = arrow.ConvertOptions(column_types=texts, include_columns=names)
        batches = arrow.open_csv(source, *_options(dialect), convert)
    row = 0
    for batch in batches:
        for name in (name for name in names if name not in found):
            cells = batch.column(name)
            at = _compute.index(_compute.match_substring_regex(cells, r"^\s*0\d"), pa.scalar(True)).as_py()
            if at >= 0:
                cell = cells[at].as_py().decode().strip()
                text = f"{cell!r} is read as the number {int(cell)} (row {row + at}); put a letter before codes"
                found[name] = f"column {_clean(name)}: {text}"
        row += batch.num_rows
    return list(found.values())


def _may_have_zeros(source: BinaryIO, dialect: Dialect) -> bool:
    """Whether a cell may begin with a zero and another digit, by the bytes of the file, which is faster than parsing."""
    if codecs.lookup(dialect.encoding or "utf-8").name not in ("utf-8", "cp1252", "iso8859-1", "ascii"):
        return True
    before = np.zeros(256, bool)
    before[list(f"{dialect.separator}{dialect.quote}\r\n\t ".encode())] = True
    source.seek(0)
    last = b"\n"
    while block := source.read(_BLOCK):
        seen = np.frombuffer(last + block, np.uint8)
        zeros = np.flatnonzero(seen[1:-1] == ord("0")) + 1
        following = seen[zeros + 1]
        if (before[seen[zeros - 1]] & (following >= ord("0")) & (following <= ord("9"))).any():
            return True
        last = seen[-2:].tobytes()
    return False


def _of_names(names: list[str]) -> list[str]:
    shown = [name for name in names if name != _clean(name)]
    return [f"blanks around or within names of columns are taken out, such as of {shown[0]!r}"] if shown else []


def _clean(name: str) -> str:
    """A name without blanks around it and with single blanks within."""
    return " ".join(name.split())


def _named(path: Path | str, table: pa.Table) -> pa.Table:
    """The table with clean and different names; a column without a name must be the first, with row numbers, or empty."""
    names = [_clean(name) for name in table.column_names]
    kept = [index for index, name in enumerate(names) if name or table.column(index).null_count < table.num_rows]
    table = table.select(kept).rename_columns([names[index] for index in kept])
    first: dict[str, int] = {}
    for column, index in enumerate(kept):
        name = names[index]
        if name and first.setdefault(name, index) != index:
            text = f"the name {name!r} is given to columns {first[name] + 1} and {index + 1}"
            raise UserError(f"{path}: {text}; rename one of them")
        if not name and (column or not _counts(table.column(column))):
            raise UserError(f"{path}: column {index + 1} has no name; give it one in the line of names")
    return table


def _counts(values: Any) -> bool:
    """Whether a column may hold row numbers: integers, each once."""
    return pa.types.is_integer(values.type) and not values.null_count and len(_compute.unique(values)) == len(values)


def _decoded(path: Path | str, table: pa.Table, dialect: Dialect, known: bool) -> tuple[pa.Table, list[str]]:
    """The table with columns decoded that are not UTF-8 after the head: from Windows-1252; refused if UTF-8 is `known`."""
    told = []
    for index, name in enumerate(table.column_names):
        if not pa.types.is_binary(table.schema.field(index).type):
            continue
        values: list[Any] = table.column(index).to_pylist()
        for row, value in enumerate(values):
            try:
                values[row] = None if value is None else value.decode("utf-8")
            except UnicodeDecodeError as error:
                assert value is not None
                if known:
                    raise UserError(
                        f"{path}: column {name}, row {row}: {value[:40]!r} is not {dialect.encoding}; name the encoding "
                        "(--encoding latin-1, for one)"
                    ) from error
                values[row] = text = value.decode("cp1252", "replace")
                if not told:
                    told.append(
                        f"from row {row} on the text is not UTF-8, and is read as Windows-1252 (Latin-1), such as "
                        f"{text[:30]!r} (--encoding)"
                    )
        table = table.set_column(index, name, pa.array(values, pa.string()))
    return table, told


def _without_empty(table: pa.Table) -> tuple[pa.Table, list[str]]:
    """The table without rows of empty cells at its end, which spreadsheets leave there."""
    rows = table.num_rows
    # Only texts are looked at: values of other types, such as times in nanoseconds, need further packages in Python.
    empty = lambda cell: not cell.is_valid or (pa.types.is_string(cell.type) and cell.as_py() == "")  # noqa: E731
    while rows and all(empty(values[rows - 1]) for values in table.columns):
        rows -= 1
    if rows == table.num_rows:
        return table, []
    return table.slice(0, rows), [f"rows of empty cells at the end are left out: {table.num_rows - rows}"]


def _of_quotes(path: Path | str, table: pa.Table, dialect: Dialect) -> list[str]:
    """Refuses a quote that is never closed; returns messages on quoted texts that contain lines like rows."""
    told: list[str] = []
    last = False
    for name, values in zip(table.column_names, table.columns, strict=True):
        if not pa.types.is_string(values.type):
            continue
        last |= bool(table.num_rows) and "\n" in (values[-1].as_py() or "")
        separator = str(dialect.separator)
        for text in values.filter(_compute.match_substring(values, "\n")).to_pylist() if table.num_columns > 1 else []:
            inner = [line for line in text.splitlines()[1:-1] if line.count(separator) == table.num_columns - 1]
            if inner:
                told.append(
                    f"column {name}: a text in quotes holds lines that look like rows, such as {inner[0][:40]!r}; is a quote "
                    "missing, or one too many?"
                )
                break
    if last:  # all that follows a quote that is never closed is in the last row
        _diagnose(path, dialect)
    return told
