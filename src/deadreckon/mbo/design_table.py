"""Tables of experiments before they become designs: reading of files, and checks of which rows have a score and all inputs."""

import shlex
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import compute, decoded, flat, is_missing, is_number, is_string, is_text, some_numbers
from deadreckon.data.formats.any_table import table_of_kind
from deadreckon.data.formats.cells import PLAIN, Known, converted
from deadreckon.data.formats.csv_out import plain
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.kind import sniff
from deadreckon.errors import UserError

_SHOWN = 5  # largest number of runs of rows, and of columns, in one message
_EXACT = 2**53  # up to which float64 holds every whole number
_KNOWN = Known(pairs=False)  # words of a pair, such as yes and no, stay levels


def read_designs(
    path: Path | str,
    ways: Mapping[str, Any],
    ignored: Collection[str] = (),
    numbers: Collection[str] = (),
    targets: Collection[str] = (),
    texts: Collection[str] = (),
) -> tuple[pa.Table, Dialect | None, list[str], bool]:
    """Reads a table as `data.formats.any_table.table_of_kind` does, except that ignored columns stay texts, without messages.

    Levels such as yes and no stay texts, too, unless the column is among `numbers`: proposals have the words of the table, so
    that they can be appended to it.

    Args:
        path: of the file.
        ways: options of `table_of_kind`.
        ignored: columns that are no part of the designs.
        numbers: columns that must be numbers, such as scores.
        targets: columns of the scores, where they are known: rows without any do not decide how columns are read (`by_scored`).
        texts: columns that stay texts if the reader leaves them so (`named_levels`).

    Returns:
        As `table_of_kind`, and whether the reader converts texts that are numbers, as all do but the one of Parquet.
    """
    known = _KNOWN._replace(texts=frozenset(ignored), flags=frozenset(numbers))
    kind = sniff(path, ways.get("separator"))
    table, dialect, told = table_of_kind(path, kind, ways, known)
    table = _plain(table) if kind == "csv" else table
    known = known._replace(texts=known.texts | {*texts})
    if converts := kind != "parquet":
        table, told = by_scored(table, dialect, told, targets, known)
    return table, dialect, told, converts


def _plain(table: pa.Table) -> pa.Table:
    """The table whose appended proposals have levels as other rows do: see `csv_out.plain`."""
    for name, column in zip(table.column_names, table.columns, strict=True):
        if not is_string(column.type):
            continue
        found = {text: as_written for text in column.unique().to_pylist() if text and (as_written := plain(text)) != text}
        if found:
            cells = pa.array([found.get(text, text) for text in column.to_pylist()], column.type)
            table = table.set_column(table.column_names.index(name), name, cells)
    return table


def read_for(
    path: Path | str, ways: Mapping[str, Any], target: str | None, options: Mapping[str, Any]
) -> tuple[pa.Table, list[str], bool]:
    """Reads a table for `Designs.from_frame` with the keywords `options`.

    Args:
        path: of the file.
        ways: options of `formats.any_table.table_of_kind`.
        target: the column to maximise; None: it is not known yet.
        options: of which `targets`, `ignore`, `weights`, `kinds` and `levels` say how columns are read.

    Returns:
        The table, the reader's messages, and whether it converts texts that are numbers.
    """
    targets, kinds = set(options.get("targets") or ()), options.get("kinds")
    scores = [each for each in (target,) if each is not None]
    numbers = {*targets, *scores, *(options.get("weights") or ()), *as_numbers(kinds)}
    ignored, texts = set(options.get("ignore") or ()) - targets, named_levels(kinds, options.get("levels"))
    table, _, told, converts = read_designs(path, ways, ignored, numbers, targets or scores, texts)
    return table, told, converts


def by_scored(
    table: pa.Table, dialect: Dialect | None, told: list[str], targets: Collection[str], known: Known = _KNOWN
) -> tuple[pa.Table, list[str]]:
    """A table as read from a file, in which rows without a score do not decide that a column of numbers is one of texts.

    A reader converts columns as a whole, so a word such as TBD in a planned run leaves all cells of its column texts. Where the
    cells of rows with a score are numbers (truth values, dates), the column is converted, and such words become missing cells.
    Other cells of planned runs are kept, so that these are not proposed again.

    Args:
        table: as read by a reader that converts texts.
        dialect: of the file.
        told: messages of the reader.
        targets: columns of the scores; those that the table lacks do not count.
        known: the types of some columns.

    Returns:
        The table, and the messages; those of the reader about a converted column are replaced by one that says so.
    """
    scores = [target for target in targets if target in table.column_names]
    absent = (
        np.all([is_missing(flat(table, target)) for target in scores], axis=0) if scores else np.zeros(table.num_rows, bool)
    )
    if absent.all() or not absent.any():
        return table, told
    for column in table.column_names:
        if column in scores or column in known.texts or not is_string(table.column(column).type):
            continue
        cells = np.array(table.column(column).to_pylist(), object)
        if is_string(_converted(column, cells[~absent], dialect, known)[0].type):
            continue
        for gone in _odd(column, cells[~absent].tolist(), cells[absent].tolist(), dialect, known):
            lost = np.array([out and cell in gone for out, cell in zip(absent, cells)])
            left = [None if out else cell for out, cell in zip(lost, cells)]
            values, lines = _converted(column, left, dialect, known)
            if lost.any() and not is_string(values.type):
                row = int(lost.argmax())
                words = ": ", " is read as texts", " has cells of several types"
                mistaken = tuple(f"column {column}{text}" for text in words)
                told = [*(line for line in told if not line.startswith(mistaken)), *lines]
                text = f"{cells[row]!r} in row {row}, which has none, counts as missing"
                told.append(f"column {column} is read by the rows with a score; {text}")
                table = table.set_column(table.column_names.index(column), column, values)
                break
    return table, told


def _odd(column: str, scored: list[Any], others: list[Any], dialect: Dialect | None, known: Known) -> Iterator[set[str]]:
    """Cells among `others` without which the column may be converted as the `scored` cells are; the fewest first."""
    planned = {cell for cell in others if cell is not None}
    alone = {cell for cell in planned if is_string(_converted(column, [cell], dialect, known)[0].type)}
    yield alone

    def apart(cells: list[Any]) -> set[str]:
        """Those converted alone but not beside the scored ones (dates beside numbers, 1,234 beside 1234), by halves: most often
        they are few."""
        if not cells or not is_string(_converted(column, [*scored, *cells], dialect, known)[0].type):
            return set()
        half = len(cells) // 2
        return set(cells) if len(cells) == 1 else apart(cells[:half]) | apart(cells[half:])

    yield alone | apart(sorted(planned - alone))
    yield planned


def _converted(column: str, cells: Any, dialect: Dialect | None, known: Known) -> tuple[Any, list[str]]:
    """Texts as a reader converts a column of them, and its messages."""
    table, _, told = converted(pa.table({column: pa.array(cells, pa.string())}), dialect or PLAIN, known=known)
    return table.column(column), told


def whole_again(table: pa.Table, columns: Sequence[str]) -> tuple[pa.Table, list[str]]:
    """The table of a library whose whole numbers become others where a cell is missing, as in pandas, with these restored.

    Args:
        table: of which cells in these columns are missing in rows without a score only.
        columns: that may hold whole numbers: of NumPy's floats (`numpy_floats`), and nothing that is given says otherwise.

    Returns:
        The table, and a message for each column of whole numbers with missing cells, which becomes one of integers.
    """
    told = []
    for column in columns:
        if not pa.types.is_floating(table.column(column).type):
            continue
        values = flat(table, column).to_numpy(zero_copy_only=False).astype(np.float64)
        absent = np.isnan(values)
        whole = np.where(absent, 0.0, values)
        if absent.any() and (whole == np.round(whole)).all() and np.abs(whole).max() < _EXACT:
            cells = pa.array(whole.astype(np.int64), mask=absent)
            table = table.set_column(table.column_names.index(column), column, cells)
            row = int(absent.argmax())
            text = f"holds whole numbers beside a missing cell (row {row}), and is read as such; if others may be proposed, say"
            told.append(f"column {column} {text} kind continuous")
    return table, told


def numpy_floats(frame: Any) -> set[str]:
    """The columns of a pandas table, or of a mapping, that are of NumPy's floats, which have no missing whole numbers."""
    types = {str(key): getattr(frame[key], "dtype", None) for key in (frame.keys() if hasattr(frame, "keys") else ())}
    return {name for name, stored in types.items() if isinstance(stored, np.dtype) and stored.kind == "f"}


def named_levels(kinds: Mapping[str, str] | None, levels: Mapping[str, Sequence[Any]] | None) -> set[str]:
    """The columns whose given kind or levels say that texts in them are names, also where most of these are numbers: levels
    that are numbers or truth values do not."""
    given, truths = levels or {}, ("true", "false")
    stored = lambda level: (text := str(level).strip()).lower() in truths or is_number(text)  # noqa: E731
    names = {name for name, kind in (kinds or {}).items() if kind == "categorical" and not given.get(name)}
    return names | {name for name, some in given.items() if not all(map(stored, some))}


def as_numbers(kinds: Mapping[str, str] | None) -> set[str]:
    """The columns whose given kind is continuous or integer."""
    return {name for name, kind in (kinds or {}).items() if kind in ("continuous", "integer")}


def name_of(path: Path | str) -> str:
    """The name of data: that of its file without the ending."""
    name = Path(path).name.removesuffix(".gz")
    return name.rpartition(".")[0] or name


def trimmed(table: pa.Table, columns: Sequence[str]) -> pa.Table:
    """The table with blanks removed at both ends of the texts of these columns; cells of blanks only are missing."""
    for column in columns:
        if not is_text(table.column(column).type):
            continue
        texts = decoded(flat(table, column))
        plain = compute.utf8_trim_whitespace(texts)
        if compute.all(compute.equal(plain, texts)).as_py() is False:
            blank = compute.and_(compute.equal(plain, ""), compute.not_equal(texts, ""))
            kept = compute.if_else(blank, pa.scalar(None, plain.type), plain)
            table = table.set_column(table.column_names.index(column), column, kept)
    return table


def scored(name: str, table: pa.Table, targets: Sequence[str]) -> tuple[np.ndarray, str]:
    """The rows with a score of at least one target, counted from 0, and a message about the other rows, or an empty text.

    Raises:
        UserError: no row has one.
    """
    absent = np.all([is_missing(flat(table, target)) for target in targets], axis=0)
    if not absent.any():
        return np.arange(table.num_rows), ""
    if absent.all():
        raise UserError(f"{name}: {' and '.join(targets)} is empty in all rows, so no design is known to be better")
    gone = np.flatnonzero(absent)
    count = f"{len(gone):,} row{'s' * (len(gone) > 1)}"
    which = f"{count} without {' or '.join(targets)} left out, as planned: {rows_told(gone)}"
    return np.flatnonzero(~absent), f"{which}; give a run that failed a score, such as the worst one"


def check_filled(name: str, table: pa.Table, inputs: Sequence[str], others: Sequence[str], rows: np.ndarray) -> None:
    """Refuses columns that are empty in some of the given rows.

    Raises:
        UserError: one line with all such columns and rows, and what can be done.
    """
    found = {column: rows[is_missing(flat(table, column))[rows]] for column in (*inputs, *others)}
    holes = {column: gone for column, gone in found.items() if len(gone)}
    if not holes:
        return
    empty = rows[np.all([np.isin(rows, found[column]) for column in inputs], axis=0)]
    if len(inputs) > 1 and rows[-1] in empty:  # such as a line of means below the table
        raise UserError(f"{name}: all inputs are empty in {rows_told(empty)}; leave {'it' if len(empty) == 1 else 'them'} out")
    named = list(holes)[:_SHOWN]
    listed = ", ".join(f"{column} is empty in {rows_told(holes[column], '')}" for column in named)
    more = f" and {len(holes) - _SHOWN} more columns" if len(holes) > _SHOWN else ""
    remedy = "fill the cells in or leave the rows out"
    if not set(holes) & set(others):
        one = "column" if len(holes) == 1 else "columns"
        remedy = f"fill the cells in, leave the rows out, or ignore the {one} (--ignore {shlex.join(named)})"
    raise UserError(f"{name}: column {listed}{more}, counted from 0; {remedy}")


def numbers_of(name: str, table: pa.Table, column: str, rows: np.ndarray) -> np.ndarray:
    """(rows,) float64 values of a column in the given rows, which must be finite numbers or truth values.

    Raises:
        UserError: one is not; the line names its row.
    """
    cells = flat(table, column)
    if is_text(cells.type) and len(rows) < len(cells):  # the texts of other rows may be no numbers
        here = pa.array(np.isin(np.arange(len(cells)), rows))
        cells = compute.if_else(here, decoded(cells), pa.scalar(None, decoded(cells).type))
    values = some_numbers(name, column, cells)[0][rows]
    if (wrong := ~np.isfinite(values)).any():
        row = int(np.argmax(wrong))
        what = "is empty" if np.isnan(values[row]) else f"has {values[row]}"
        raise UserError(f"{name}: column {column} {what} in row {rows[row]}")
    return values


def groups_of(name: str, table: pa.Table, column: str, rows: np.ndarray) -> np.ndarray:
    """(rows,) group number, from 0, of each of the given rows, by a column of any values.

    Raises:
        UserError: there is only one group, or each row is a group of its own.
    """
    values = flat(table, column)
    codes = compute.dictionary_encode(decoded(values)).indices.to_numpy(zero_copy_only=False)[rows]
    found = np.unique(codes, return_inverse=True)[1].reshape(-1)
    if (count := found.max() + 1) in (1, len(rows)):
        what = "the same value in all rows" if count == 1 else "another value in every row"
        raise UserError(f"{name}: column {column} has {what}, and groups of rows (--groups) are two or more with several rows")
    return found


def score_name(target: str, weights: Mapping[str, float] | None) -> str:
    """The name of a score: the target, plus the weighted columns."""
    return target + "".join(f" {'-' if weight < 0 else '+'} {abs(weight):g} {key}" for key, weight in (weights or {}).items())


def rows_told(rows: np.ndarray, how: str = ", counted from 0") -> str:
    """Ascending rows as written in a message: row 3; rows 3, 5 to 9."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    named = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs[:_SHOWN]]
    rest = sum(map(len, runs[_SHOWN:]))
    return f"row{'s' * (len(rows) > 1)} {', '.join(named)}{f' and {rest:,} more' if rest else ''}{how}"


def warn(name: Path | str, lines: Sequence[str]) -> None:
    """Issues a warning for each line about a file or a table, attributed to the caller of the calling function."""
    for line in lines:
        warnings.warn(f"{name}: {line}", stacklevel=3)
