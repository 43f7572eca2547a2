"""Detection of the separators of decimals and thousands in the numbers of a text file."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

# 1,234 and 1.234.567 and 12'345.67: groups of three behind one to three digits, and perhaps decimals.
_GROUPED = re.compile(
    r"[+-]?[1-9]\d{0,2}(?P<mark>[.,'’ \u00a0\u202f])\d{3}(?P<more>(?:(?P=mark)\d{3})*)(?:(?P<decimal>[.,])\d+)?-?"
)
_DECIMAL = re.compile(r"[+-]?\d*(?P<decimal>[.,])\d+(?:[eE][+-]?\d+)?-?")
LARGEST = 2**63  # least number that is not a 64-bit integer
_MOST = 400_000  # largest number of cells that are examined
_SAME = {"’": "'", "\u00a0": " ", "\u202f": " "}
WORDS = {".": "points", ",": "commas", " ": "spaces", "'": "apostrophes"}


@dataclass
class Marks:
    """The cells of a file that show its separators; each {separator: {column: a cell}}.

    Attributes:
        decimals: cells with a decimal separator (1,5 and 0,123 and 1234,567).
        thousands: cells with a thousands separator (1.234,56 and 1.234.567 and 1 234).
        open: ambiguous cells, whose separator may be either: 1,234 and 1.234.
        rows: number of rows that were examined, if the file has more; else 0.
    """

    decimals: dict[str, dict[int, str]] = field(default_factory=lambda: {".": {}, ",": {}})
    thousands: dict[str, dict[int, str]] = field(default_factory=dict)
    open: dict[str, dict[int, str]] = field(default_factory=lambda: {".": {}, ",": {}})
    rows: int = 0

    @classmethod
    def of(cls, rows: Sequence[Sequence[str]], whole: bool = True) -> "Marks":
        """Those of some rows, each a sequence of texts; `whole`: the file has no more."""
        marks, seen = cls(rows=0 if whole else len(rows)), 0
        for index, row in enumerate(rows):
            seen += len(row)
            if seen > _MOST:
                marks.rows = index
                break
            for column, cell in enumerate(row):
                if cell and not cell.isalnum():
                    marks._look(column, cell.strip())
        return marks

    def _look(self, column: int, cell: str) -> None:
        if match := _GROUPED.fullmatch(cell):
            mark = _SAME.get(match["mark"], match["mark"])
            if match["decimal"] == mark:
                return
            if match["decimal"]:
                self.decimals[match["decimal"]].setdefault(column, cell)
            if match["decimal"] or match["more"] or mark not in ".,":
                self.thousands.setdefault(mark, {}).setdefault(column, cell)
            else:
                self.open[mark].setdefault(column, cell)
        elif match := _DECIMAL.fullmatch(cell):
            self.decimals[match["decimal"]].setdefault(column, cell)

    @property
    def found(self) -> bool:
        """Whether any cell shows a separator."""
        return any((*self.decimals.values(), *self.thousands.values(), *self.open.values()))

    def resolve(self, decimal: str | None, thousands: str | None, separator: str) -> tuple[str, str, list[str]]:
        """The separators of decimals and thousands, and messages.

        Rules: the decimal separator is the one that more columns show (1,5 and 1.234,56 show a comma; 1.234.567 excludes a
        point). If none shows any, and there are only ambiguous cells such as 1,234, the comma is the decimal separator if
        semicolons separate columns, and else the thousands separator, with a message that this is open. The thousands
        separator is one that cells show or else, if it is not the decimal separator, that of ambiguous cells.

        Args:
            decimal: the given one, or None.
            thousands: the given one, or None.
            separator: of columns.
        """
        told: list[str] = []
        asked = decimal, thousands
        votes = Counter({mark: len(columns) for mark, columns in self.decimals.items()})
        for mark, other in ((".", ","), (",", ".")):
            votes[other] += len(self.thousands.get(mark, {}).keys() - self.decimals[other].keys())
        if decimal is None and thousands in (".", ","):
            decimal = "," if thousands == "." else "."
        evident = decimal is not None or votes["."] + votes[","] > 0
        if decimal is None:
            tie = votes[","] == votes["."] and separator == ";" and (evident or self.open[","])
            decimal = "," if votes[","] > votes["."] or tie else "."
        other = "," if decimal == "." else "."
        if thousands is None:
            shown = Counter({mark: len(columns) for mark, columns in self.thousands.items() if mark != decimal})
            thousands = max(shown, key=lambda mark: shown[mark]) if shown else other if self.open[other] else ""
        if asked[0] is None:
            told += self._of_decimals(decimal, evident, separator)
        if asked[1] is None and thousands:
            told += self._of_thousands(decimal, thousands, evident)
        if asked == (None, None) and self.decimals[other]:
            cell = _any(self.decimals[other])
            told.append(f"most numbers have decimal {WORDS[decimal]}, but {cell!r} has another mark (--decimal)")
        return decimal, thousands, told

    @property
    def _none(self) -> str:
        return f"no other cell{f' of the first {self.rows:,} rows' if self.rows else ''} tells"

    def _of_decimals(self, decimal: str, evident: bool, separator: str) -> list[str]:
        cells = self.decimals[decimal] or self.open[decimal]
        if not cells:
            return []
        cell = _any(cells)
        value = _value(cell, decimal)
        if not evident and decimal == ",":
            whole = cell.replace(",", "")
            return [
                f"{cell!r} is read as {value}, not as {whole}: beside semicolons a comma is taken for decimals, "
                f"and {self._none} (--thousands comma)"
            ]
        if not evident and separator != ",":
            return [f"{cell!r} is read as {value}, not as {cell.replace('.', '')}, and {self._none} (--thousands point)"]
        return [f"decimal commas: {cell!r} is read as {value} (--decimal)"] if decimal == "," else []

    def _of_thousands(self, decimal: str, thousands: str, evident: bool) -> list[str]:
        shown = self.thousands.get(thousands)
        cell = _any(shown or self.open[thousands])
        value = _value(cell, decimal)
        text = f"thousands are separated by {WORDS[thousands]}: {cell!r} is read as {value}"
        if shown or evident:
            return [f"{text} (--thousands)"]
        return [f"{text}, not as {_value(cell, thousands)}, and {self._none} (--decimal comma)"]


def of_digits(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Messages on columns of digits that are rounded as numbers, because they exceed 64-bit integers.

    Args:
        names: of the columns.
        rows: their cells.
    """
    told = []
    for name, cells in zip(names, zip(*(row for row in rows if len(row) == len(names)), strict=True)):
        found = [cell for cell in map(str.strip, cells) if cell]
        if not all(cell.isdecimal() for cell in found):
            continue
        if large := [cell for cell in found if int(cell) >= LARGEST]:
            told.append(f"column {name}: {of_large(large[0])}")
    return told


def of_large(cell: str) -> str:
    """The message on a column with a cell of digits that exceeds 64-bit integers, because of which all its cells are floats."""
    return f"{cell[:40]!r} is rounded, as no integer is so large; put a letter before codes"


def _any(cells: dict[int, str]) -> str:
    return next(iter(cells.values()))


def _value(cell: str, decimal: str) -> str:
    """The number in a cell, written with a decimal point."""
    whole, _, fraction = cell.rstrip("-").partition(decimal)
    whole = re.sub(r"[^\d+-]", "", whole)
    sign = "-" if cell.endswith("-") else ""
    return f"{sign}{whole}.{fraction}" if fraction else f"{sign}{whole}"
