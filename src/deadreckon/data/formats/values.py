"""Conversion of columns of Python values, from spreadsheets and SQLite, to pyarrow arrays."""

import datetime
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import pyarrow as pa

from deadreckon.data.formats.cells import DASH, MISSING
from deadreckon.data.likeness import MOSTLY
from deadreckon.errors import UserError

_LARGEST = 2**53  # up to which a float holds every integer


def column_of(
    path: Any, called: str, values: Sequence[Any], where: Callable[[int], str], decimal: bool = False
) -> tuple[Any, list[str]]:
    """A column as a pyarrow array of numbers, truth values, timestamps, durations, times of day or texts; and messages.

    Cells that are empty or None are missing, and so are words such as NA among cells that are not texts. A column of several
    kinds becomes text, with a message, unless nearly all cells are of one kind.

    Args:
        path: named in errors.
        called: what the column is called, in errors.
        values: (rows,) its cells.
        where: what the cell of a row is called, in errors.
        decimal: whether whole floats stay floats; those of spreadsheets, which have no integers, become integers.

    Raises:
        UserError: nearly all cells are of one kind, and one is not; or a cell holds bytes.
    """
    kinds = Counter(_kind(value) for value in values)
    missing = kinds.pop("", 0)
    if not kinds:
        return pa.nulls(len(values)), []
    for row in (row for row, value in enumerate(values) if "bytes" in kinds and isinstance(value, bytes)):
        raise UserError(f"{path}: {called} holds binary data ({where(row)}), which agents cannot use; leave it out")
    texts = {value.strip() for value in values if isinstance(value, str)} if len(kinds) > 1 else set()
    if texts and texts <= {*MISSING, DASH}:
        values = [None if isinstance(value, str) else value for value in values]
        del kinds["text"]
    usual, count = kinds.most_common(1)[0]
    if len(kinds) == 1:
        cells = [None if _kind(value) == "" else value for value in values]
        if usual == "number":
            return _numbers(cells, decimal), _inexact(called, cells, where)
        return _array(cells, usual), []
    row = next(row for row, value in enumerate(values) if _kind(value) not in ("", usual))
    odd = f"{where(row)} holds {str(values[row])[:40]!r}, and most cells hold {_WORDS[usual]}"
    if count >= MOSTLY * (len(values) - missing) and usual != "text":
        raise UserError(f"{path}: {called}: {odd}; correct that cell (an empty one is missing), or make all of them texts")
    return _array([None if _kind(value) == "" else as_text(value) for value in values], "text"), [
        f"{called} has cells of several types: {odd}"
    ]


_WORDS = {"number": "numbers", "flag": "true or false", "moment": "dates", "text": "texts", "time": "times of day",
          "duration": "durations"}  # fmt: skip


def _kind(value: Any) -> str:
    if value is None or (isinstance(value, str) and not value.strip()):
        return ""
    for kinds, word in (
        (bool, "flag"), ((int, float), "number"), (str, "text"), (datetime.date, "moment"), (datetime.time, "time"),
        (datetime.timedelta, "duration"), (bytes, "bytes"),
    ):  # fmt: skip
        if isinstance(value, kinds):
            return word
    raise TypeError(f"a cell of type {type(value).__name__}")


def as_text(value: Any) -> str:
    """A cell as a text: a whole number has no point, as in a spreadsheet."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _numbers(values: list[Any], decimal: bool) -> Any:
    """Integers where all are, exactly; floats otherwise."""
    if all(value is None or isinstance(value, int) for value in values):
        return pa.array(values, pa.int64())
    if not decimal and all(value is None or (abs(value) < _LARGEST and float(value).is_integer()) for value in values):
        return pa.array([None if value is None else int(value) for value in values], pa.int64())
    return pa.array([None if value is None else float(value) for value in values], pa.float64())


def _inexact(called: str, values: list[Any], where: Callable[[int], str]) -> list[str]:
    """Messages on integers that are not exact as floats, in a column that also has decimals."""
    if all(value is None or isinstance(value, int) for value in values):
        return []
    rows = [row for row, value in enumerate(values) if isinstance(value, int) and abs(value) > _LARGEST]
    if not rows:
        return []
    return [f"{called} holds integers and decimals, and {where(rows[0])} has {values[rows[0]]}, which is rounded"]


def _array(values: list[Any], kind: str) -> Any:
    if kind == "moment":
        full = [
            datetime.datetime.combine(value, datetime.time()) if type(value) is datetime.date else value for value in values
        ]
        return pa.array(full, pa.timestamp("us"))
    return pa.array(
        values, {"flag": pa.bool_(), "text": pa.string(), "time": pa.time64("us"), "duration": pa.duration("us")}[kind]
    )
