"""What a text looks like: a number, a date, or nothing at all; for columns of texts that are something else by mistake."""

from typing import Any, NamedTuple

import pyarrow as pa

from deadreckon.data.arrow import all_match, is_string, says_numbers
from deadreckon.data.arrow import compute as _compute
from deadreckon.errors import UserError

# Numbers with any marks, currencies and units of per cent; dates with any marks. RE2 knows no look-around.
_NUMBER = r"^\(?[+\-−]?[$€£]?\s?[.,]?\d[\d.,'’ \x{a0}\x{202f}]*(?:[eE][+-]?\d+)?\s?[kM]?\s?[%€$£\-]?\)?$"
# One number, and no list, version or address: groups of thousands of one mark, and one mark of decimals.
_ONE = (
    r"^\(?[+\-−]?[$€£]?\s?"
    r"(?:\d*(?:[.,]\d*)?|[1-9]\d{0,2}(?:(?:\.\d{3})+|(?:,\d{3})+|(?:['’ \x{a0}\x{202f}]\d{3})+)(?:[.,]\d*)?)"
    r"(?:[eE][+-]?\d+)?\s?[kM]?\s?[%€$£\-]?\)?$"
)
# In which a column may be written.
_FORMS = tuple(rf"^[+\-−]?(?:\d+{mark}?\d*|{mark}\d+)(?:[eE][+-]?\d+)?$" for mark in ("[.]", ","))
_MARKS = ("%", "$", "€", "£")
_DATE = r"^(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4})(?:[ T].*)?$"
MOSTLY = 0.9  # share of numbers among a column's cells from which a text is taken for a mistake
FEW = 20  # different numbers up to which they may be levels, such as those of a storey or a grade, and actions discrete


class Likeness(NamedTuple):
    """What the texts of a column look like.

    Attributes:
        cells: that are not missing.
        alike: of them look like numbers or dates.
        first: such a text.
        row: of the first that does not or, where all do and are numbers, of the first that has another form than most; or -1.
        odd: that text.
        distinct: texts that look like numbers or dates.
        numbers: whether all are numbers, although they cannot be read as such.
    """

    cells: int
    alike: int
    first: str
    row: int
    odd: str
    distinct: int
    numbers: bool

    @property
    def mistaken(self) -> bool:
        """Whether the texts seem to be numbers that are written in several ways, or among which some are no numbers."""
        many = self.distinct > FEW
        return many and (self.numbers or (self.row >= 0 and MOSTLY * self.cells <= self.alike < self.cells))


def likeness(values: Any) -> Likeness:
    """What the texts of a pyarrow array or chunked array look like; a missing one like nothing.

    Args:
        values: (rows,) texts.
    """
    found = _compute.utf8_trim_whitespace(values)
    present = _compute.and_kleene(_compute.is_valid(found), _compute.not_equal(found, ""))
    alike = _compute.or_(_compute.match_substring_regex(found, _NUMBER), _compute.match_substring_regex(found, _DATE))
    cells, count = (_compute.sum(_compute.fill_null(each, False)).as_py() or 0 for each in (present, alike))
    if not count:
        return Likeness(cells, 0, "", -1, "", 0, False)
    numbers = found.filter(_compute.fill_null(alike, False))
    odd = _compute.fill_null(_compute.and_(present, _compute.invert(alike)), False)
    row = _compute.index(odd, pa.scalar(True)).as_py()
    different = _compute.unique(numbers)
    one = row < 0 and all_match(numbers, _ONE) and not says_numbers(different)
    if one:
        row = _other_form(found)
    text = "" if row < 0 else values[row].as_py()
    return Likeness(cells, count, numbers[0].as_py(), row, text, len(different), one)


def _other_form(texts: Any) -> int:
    """The first row whose number is not written as most are, with decimal points or with decimal commas."""
    matches = [_compute.match_substring_regex(texts, form) for form in _FORMS]
    usual = max(matches, key=lambda match: _compute.sum(match).as_py() or 0)
    other = _compute.index(_compute.fill_null(_compute.invert(usual), False), pa.scalar(True)).as_py()
    if other < 0:  # all are written alike, in a way that the file's other columns are not
        plain = matches[1] if usual is matches[0] else matches[0]
        other = _compute.index(_compute.fill_null(_compute.invert(plain), False), pa.scalar(True)).as_py()
    return max(other, _compute.index(_compute.is_valid(texts), pa.scalar(True)).as_py())


def refuse_mistaken(name: str, column: str, values: Any) -> None:
    """Refuses texts of which nearly all are numbers: as levels of a category they would make no sense.

    Args:
        name: of the log, used in errors.
        column: its name, used in errors.
        values: (rows,) of any type; those that are no texts are not refused.

    Raises:
        UserError: naming the row of the first that is no number.
    """
    if not is_string(values.type):
        return
    found = likeness(values)
    if found.mistaken and found.numbers:
        beside = f", beside {found.first!r}" if found.first != found.odd.strip() else ""
        mark = next((mark for mark in _MARKS if mark in found.odd), "")
        how = f"write its cells as plain numbers without {mark}" if mark else "write all cells as plain numbers"
        raise UserError(
            f"{name}: column {column} holds texts that look like numbers and cannot be read as such: {found.odd[:40]!r} in row "
            f"{found.row}{beside}; {how}, give their levels in a schema, or ignore the column (--ignore {column})"
        )
    if found.mistaken:
        raise UserError(
            f"{name}: column {column} holds a text in row {found.row}, {found.odd[:40]!r}, among {found.alike} numbers such as "
            f"{found.first!r}; correct that cell (an empty one is missing), or ignore the column (--ignore {column})"
        )
