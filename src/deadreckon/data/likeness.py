"""What a text looks like: a number, a date, or nothing at all; for columns of texts that are something else by mistake."""

from typing import Any, NamedTuple

import pyarrow as pa

from deadreckon.data.arrow import compute as _compute
from deadreckon.data.arrow import is_string
from deadreckon.errors import UserError

# Numbers with any marks, currencies and units of per cent; dates with any marks. RE2 knows no look-around.
_NUMBER = r"^[+\-−]?[$€£]?\s?[.,]?\d[\d.,'’ \x{a0}\x{202f}]*(?:[eE][+-]?\d+)?\s?[%€$£\-]?$"
_DATE = r"^(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4})(?:[ T].*)?$"
_MOSTLY = 0.9  # share of numbers among a column's cells from which a text is taken for a mistake
_FEW = 20  # distinct numbers up to which they may be levels, such as those of a storey or a grade


class Likeness(NamedTuple):
    """What the texts of a column look like.

    Attributes:
        cells: that are not missing.
        alike: of them look like numbers or dates.
        first: such a text.
        row: of the first that does not, or -1.
        odd: that text.
        distinct: texts that look like numbers or dates.
    """

    cells: int
    alike: int
    first: str
    row: int
    odd: str
    distinct: int

    @property
    def mistaken(self) -> bool:
        """Whether the texts that do not look like numbers seem to be mistakes among numbers."""
        return self.row >= 0 and self.alike >= _MOSTLY * self.cells and self.distinct > _FEW


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
        return Likeness(cells, 0, "", -1, "", 0)
    numbers = found.filter(_compute.fill_null(alike, False))
    odd = _compute.fill_null(_compute.and_(present, _compute.invert(alike)), False)
    row = _compute.index(odd, pa.scalar(True)).as_py()
    text = "" if row < 0 else values[row].as_py()
    return Likeness(cells, count, numbers[0].as_py(), row, text, len(_compute.unique(numbers)))


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
    if found.mistaken:
        raise UserError(
            f"{name}: column {column} holds a text in row {found.row}, {found.odd[:40]!r}, among {found.alike} numbers such as "
            f"{found.first!r}; mend that cell (an empty one is missing), or ignore the column"
        )
