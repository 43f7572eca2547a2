"""The dialect of a delimited text file: separators of columns, decimals and thousands, and the encoding.

What is not given is detected from the beginning of the file. There is a message, which names the option, for each difference
from a plain file (commas, decimal points, UTF-8) and for each choice that the file leaves open.
"""

import codecs
import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from deadreckon.data.formats.marks import Marks, of_digits
from deadreckon.errors import UserError

HEAD = 1 << 18  # bytes that are examined at the beginning of a file, more if they have fewer than three line ends
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "vertical bars"}
DATES = ("iso", "day-first", "month-first")
_SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "\\t": "\t", "pipe": "|", "bar": "|", "space": " "}
_DECIMALS = {"point": ".", "dot": ".", "comma": ","}
_THOUSANDS = {**_DECIMALS, "none": "", "space": " ", "apostrophe": "'", "\u00a0": " ", "\u202f": " ", "’": "'"}
_ROWS = 2_000  # rows of the head whose cells are examined
_PREAMBLE = 20  # largest number of lines above the names
_BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
         (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))  # fmt: skip
_SEP_LINE = re.compile(r'\ufeff?"?sep=(.)"?[ \t]*(?:\r\n|\n|\r|$)', re.IGNORECASE)
_NUMBER = re.compile(r"\s*[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class Dialect:
    """The dialect of a delimited text file; None: to be detected.

    Attributes:
        separator: of columns, one character.
        decimal: decimal separator, a point or a comma.
        thousands: thousands separator: "" for none, a point, a comma, a space or an apostrophe.
        encoding: a name that Python knows.
        quote: character around texts.
        dates: `iso` (only year-month-day is a date), `day-first` or `month-first`; None: determined from the dates.
        skip: lines above the line of names.
        unmarked: whether no cell shows a mark of decimals or thousands, so that `decimal` is only the usual one.
    """

    separator: str | None = None
    decimal: str | None = None
    thousands: str | None = None
    encoding: str | None = None
    quote: str | None = None
    dates: str | None = None
    skip: int | None = None
    unmarked: bool = False

    @property
    def options(self) -> dict[str, str]:
        """The reader's options with which the next such file is read alike, whatever its cells suggest."""
        decimal = None if self.unmarked else self.decimal
        found = {"separator": self.separator, "decimal": decimal, "thousands": self.thousands,
                 "encoding": self.encoding, "dates": self.dates}  # fmt: skip
        # Where nothing marks thousands the next file may: what its marks mean is settled by the mark of decimals.
        return {key: value for key, value in found.items() if value}

    @classmethod
    def asked(
        cls,
        separator: str | None = None,
        decimal: str | None = None,
        thousands: str | None = None,
        encoding: str | None = None,
        dates: str | None = None,
    ) -> "Dialect":
        """The dialect by a user's options, with words such as `tab`, `comma` and `none` for what is hard to type.

        Raises:
            UserError: an option has a value that is not valid.
        """
        if separator is not None:
            separator = _SEPARATORS.get(separator, separator)
            if len(separator) != 1 or separator.isalnum() or separator in '"\n\r':
                raise UserError(f"--separator takes one character, or comma, semicolon, tab, pipe or space, not {separator!r}")
        if decimal is not None and (decimal := _DECIMALS.get(decimal, decimal)) not in (".", ","):
            raise UserError(f"--decimal takes a point or a comma (. or ,), not {decimal!r}")
        if thousands is not None and (thousands := _THOUSANDS.get(thousands, thousands)) not in ("", ".", ",", " ", "'"):
            raise UserError(f"--thousands takes none, point, comma, space or apostrophe, not {thousands!r}")
        if decimal is not None and decimal == thousands:
            raise UserError(f"--decimal and --thousands are both {decimal!r}; one of them must be another")
        if encoding is not None:
            try:
                codecs.lookup(encoding)
                "".encode(encoding)  # refuses codecs that are no encodings of text
            except (LookupError, ValueError) as error:  # a null character, or Python's `undefined`
                raise UserError(
                    f"--encoding {encoding}: unknown; known are utf-8, utf-16, latin-1, cp1252 and others"
                ) from error
        if dates is not None and dates not in DATES:
            raise UserError(f"--dates takes {', '.join(DATES[:-1])} or {DATES[-1]}, not {dates!r}")
        return cls(separator, decimal, thousands, encoding, dates=dates)


class _Layout(NamedTuple):
    """The head of a file, split by one separator.

    Attributes:
        rows: (first line, cells) of each row from the names on, without empty lines.
        skip: number of lines above the names.
        share: of the rows that have as many cells as there are names.
        named: whether the first row can be names: no numbers, except for those of numbered columns.
    """

    rows: list[tuple[int, list[str]]]
    skip: int
    share: float
    named: bool

    @property
    def columns(self) -> int:
        return len(self.rows[0][1]) if self.rows else 0

    @property
    def rank(self) -> tuple[bool, bool, int, float, int]:
        """The larger, the more likely is the separator."""
        return self.named, self.share > 0.5, -self.skip, self.share, self.columns


def sniff(path: Path | str, head: bytes, whole: bool, asked: Dialect) -> tuple[Dialect, list[str]]:
    """Detects the dialect of a file; only `dates` may stay None.

    Rules: the encoding is that of the byte order mark, UTF-16 where every second byte is zero, UTF-8 where the bytes are valid,
    else Windows-1252. The separator is that of a first line `sep=;`, else the one of commas, semicolons, tabs and bars which
    splits most rows into as many cells as there are names. Lines above the names are skipped if they begin with `#` or have
    one cell. Decimals and thousands: see `Marks.resolve`.

    Args:
        path: named in errors.
        head: the first bytes; the last line may be cut.
        whole: `head` is all of the file.
        asked: the given options, which are not detected.

    Returns:
        The dialect, and messages, one line for each difference from plain CSV and for each assumption that may be wrong.

    Raises:
        UserError: the head is not a table, or does not have the given dialect.
    """
    told: list[str] = []
    encoding = asked.encoding or encoding_of(head, whole)
    text = _decoded(path, head, whole, encoding)
    if asked.encoding is None and encoding != "utf-8":
        told.append(_of_encoding(text, encoding))
    separator, start, said = asked.separator, 0, _SEP_LINE.match(text)
    text = text.removeprefix("\ufeff")
    if said is not None:
        start, separator = 1, separator or said[1]
    quote = asked.quote or ("'" if _single_quotes(text) else '"')
    layouts = {}
    for each in [separator] if separator else SEPARATORS:
        layouts[each] = _layout(text, whole, each, quote, start)
    fitting = {each: layout for each, layout in layouts.items() if layout.columns > 1}
    if not fitting:
        line = next((line for line in text.splitlines()[start:] if line.strip()), "")[:60]
        if separator:
            raise UserError(f"{path}: no {separator!r} separates columns in its line of names {line!r} (--separator)")
        raise UserError(f"{path}: a table has two columns or more, and nothing separates any in {line!r} (--separator)")
    separator = max(fitting, key=lambda each: fitting[each].rank)
    layout = fitting[separator]
    if asked.separator is None:
        told += _of_separator(separator, fitting)
    if layout.skip > start:
        first = next(line for line in text.splitlines()[start:] if line.strip()).strip()
        told.append(f"lines above the line of names are left out: {layout.skip - start}, such as {first[:60]!r}")
    if quote == "'":
        told.append("texts stand in single quotes (')")
    _refuse_names(path, layout)
    names, *rows = [cells for _, cells in layout.rows]
    marks = Marks.of(rows, whole and len(rows) < _ROWS)
    decimal, thousands, lines = marks.resolve(asked.decimal, asked.thousands, separator)
    told += [*lines, *of_digits(names, rows)]
    unmarked = asked.decimal is None and not marks.found
    return Dialect(separator, decimal, thousands, encoding, quote, asked.dates, layout.skip, unmarked), told


def encoding_of(head: bytes, whole: bool = False) -> str:
    """The encoding of a text by its first bytes; "" if it is not recognised."""
    for mark, name in _BOMS:
        if head.startswith(mark):
            return name
    if b"\0" in head:
        even, odd = head[::2].count(0), head[1::2].count(0)
        half = len(head) // 2
        if odd > 0.7 * half and even < 0.1 * half:
            return "utf-16-le"
        return "utf-16-be" if even > 0.7 * half and odd < 0.1 * half else ""
    for name in ("utf-8", "cp1252", "latin-1"):
        try:
            codecs.getincrementaldecoder(name)().decode(head, final=whole)
        except UnicodeDecodeError:
            continue
        return name
    return ""


def text_of(head: bytes) -> str | None:
    """The text that a file begins with; None if its first bytes are not those of a text."""
    encoding = encoding_of(head)
    if not encoding:
        return None
    text = codecs.getincrementaldecoder(encoding)("replace").decode(head).removeprefix("\ufeff")
    return None if re.search(r"[\x00-\x08\x0e-\x1f]", text) else text


def is_table(head: bytes, separator: str | None = None) -> bool:
    """Whether the first bytes are those of a text whose lines are split into columns, by `separator` if that is known."""
    text = text_of(head)
    if text is None:
        return False
    if separator is not None or _SEP_LINE.match(text):
        return True
    lines = [line.strip(" ") for line in text.splitlines() if line.strip()][: _PREAMBLE + 2]
    return any(each in line.strip()[:-1] for line in lines for each in SEPARATORS)


def _decoded(path: Path | str, head: bytes, whole: bool, encoding: str) -> str:
    if not encoding:
        raise UserError(f"{path}: not a text in UTF-8, UTF-16 or Latin-1; name its encoding (--encoding)")
    try:
        return codecs.getincrementaldecoder(encoding)().decode(head, final=whole)
    except UnicodeError as error:
        line = head[: getattr(error, "start", 0)].count(b"\n") + 1
        how = "name its encoding (--encoding), such as latin-1 or utf-16"
        raise UserError(f"{path}: line {line} is not {encoding}; {how}") from error


def _single_quotes(text: str) -> bool:
    line = next(iter(text.splitlines()), "")
    cells = re.split(r"[,;\t|]", line.strip())
    return '"' not in text and all(len(cell) > 1 and cell[0] == cell[-1] == "'" for cell in cells)


def _layout(text: str, whole: bool, separator: str, quote: str, start: int) -> _Layout:
    """The head split by `separator`, from line `start` on."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, quotechar=quote)
    rows: list[tuple[int, list[str]]] = []
    line = 1
    try:
        for cells in reader:
            if line > start and any(cell.strip() for cell in cells):
                rows.append((line, cells))
            line = reader.line_num + 1
            if len(rows) > _ROWS:
                break
        else:
            if not whole and len(rows) > 1:
                rows.pop()  # it may be cut
    except csv.Error:  # a quote that is never closed, which is refused when the file is read
        pass
    if not rows:
        return _Layout([], start, 0.0, False)
    counts = Counter(len(cells) for _, cells in rows)
    usual = max(counts, key=lambda count: (counts[count], count))
    first = next(index for index, (_, cells) in enumerate(rows) if len(cells) == usual)
    above = [cells for _, cells in rows[:first]]
    loose = all(cells[0].lstrip().startswith("#") or sum(cell.strip() != "" for cell in cells) == 1 for cells in above)
    rows = rows[first:] if loose and first <= _PREAMBLE else rows
    names = [cell.strip() for cell in rows[0][1]]
    share = sum(len(cells) == len(names) for _, cells in rows) / len(rows)
    return _Layout(rows, rows[0][0] - 1, share, not any(map(_NUMBER.fullmatch, names)) or _counted(names))


def _counted(names: list[str]) -> bool:
    """Whether names are the numbers of columns, as table libraries write them, perhaps after a column of row numbers."""
    numbers = names[1:] if names[0] == "" else names
    return any(numbers == [str(index + base) for index in range(len(numbers))] for base in (0, 1))


def _refuse_names(path: Path | str, layout: _Layout) -> None:
    """Refuses a first row that cannot be names, with the probable mistake."""
    (line, names), *others = layout.rows
    if not others:
        return
    if not layout.named and all(_NUMBER.fullmatch(name) for name in names if name.strip()):
        shown = ", ".join(names[:4])
        raise UserError(
            f"{path}: line {line} holds numbers ({shown}) where the names of the columns are needed; add a line of names"
        )
    if all(len(cells) == len(names) + 1 for _, cells in others):
        if all(cells[-1].strip() == "" for _, cells in others):
            raise UserError(
                f"{path}: every line but that of the names (line {line}) ends in a separator; end that with one too, or none"
            )
        raise UserError(
            f"{path}: line {line} has {len(names)} names, the rows have {len(names) + 1} cells; if the first are the names of "
            "rows, give that column a name too (in R: write.csv, or col.names=NA)"
        )


def _of_encoding(text: str, encoding: str) -> str:
    if encoding.startswith(("utf-16", "utf-32")):
        return f"the text is encoded in {encoding[:6].upper()} (--encoding)"
    word = next(iter(re.findall(r"\w*[^\x00-\x7f]\w*", text)), "")[:30]
    return f"the text is not UTF-8, and is read as Windows-1252 (Latin-1), such as {word!r} (--encoding)"


def _of_separator(separator: str, fitting: dict[str, _Layout]) -> list[str]:
    word = SEPARATORS.get(separator, repr(separator))
    taken = fitting[separator]
    rivals = [SEPARATORS[each] for each, layout in fitting.items() if each != separator and layout.rank[:4] == taken.rank[:4]]
    if rivals:
        return [f"columns are separated by {word}, but {' or '.join(rivals)} would split every line alike (--separator)"]
    return [] if separator == "," else [f"columns are separated by {word} (--separator)"]
