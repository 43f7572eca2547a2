"""The times of a table's rows as numbers in their order: numbers as they are, dates, times of day and durations as seconds.

With `table_rows` it needs numpy alone, and can be copied with it beside `portable.py`. Texts of dates are read as
`data.formats.dates` reads those of a log, whose schema says whether the day or the month comes first.
"""

import datetime
import re
from typing import Any

import numpy as np

if __package__:
    from deadreckon.policies.table_rows import RowsError, is_missing, numbers_of, shown
else:  # copied beside `portable.py`
    from table_rows import RowsError, is_missing, numbers_of, shown  # pyrefly: ignore[missing-import]

_LAST = re.compile(r"(\d{1,2})([./-])(\d{1,2})[./-](\d{4})(?!\d)")  # the year is last, so the day or the month comes first
_FIRST = re.compile(r"(\d{4})[./-](\d{1,2})[./-](\d{1,2})(?!\d)")
_CLOCK = re.compile(
    r"(?:(?:,? +|T)(\d{1,2})(?::(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?)?(?: ?([AaPp])\.?[Mm]\.?)?)?(Z|[+-]\d{2}(?::?\d{2})?)?",
    re.ASCII,
)
# A time of day, or a duration as pandas writes it: 08:30, 8:30:15.5, 0 days 00:00:30, -1 days +23:59:30.
_SPAN = re.compile(r"(?:(-?\d+) days?,? \+?)?(\d+):(\d{2})(?::(\d{2}(?:[.,]\d{1,9})?))?", re.ASCII)
_ORDERS = ("day-first", "month-first")
_DATE, _TIME, _NUMBER = "a date", "a time", "a number"


def times_of(column: str, values: np.ndarray, name: str, *, dates: bool, order: str | None = None) -> np.ndarray:
    """(rows,) float64 that grow with time, NaN where it is missing.

    Numbers are as they are, dates seconds since 1970 without a zone or in UTC, and times of day and durations their seconds.

    Args:
        column: its name, for errors.
        values: (rows,) numbers, dates, times or texts of them.
        name: of the rows, for errors.
        dates: whether the log holds dates or times there; else numbers.
        order: `day-first` or `month-first`, as the log's dates were read; None: what the texts themselves tell, or else the
            day first where points stand between the parts, and the month where other signs do.

    Raises:
        RowsError: a value is no number, date or time, or they are of several kinds.
    """
    if values.dtype.kind in "mM":  # durations order rows too
        return np.where(np.isnat(values), np.nan, values.astype(f"{values.dtype.kind}8[us]").astype(np.int64) / 1e6)
    cells = [None if is_missing(cell) or (isinstance(cell, str) and not cell.strip()) else cell for cell in values.tolist()]
    if not dates:
        return numbers_of(column, values if None not in cells else np.asarray(cells, object), name)
    taken = order if order in _ORDERS else _order(cells)
    out = np.full(len(cells), np.nan)
    before = None  # kind of the last value
    for row, cell in enumerate(cells):
        if cell is None:
            continue
        try:
            kind, out[row] = _seconds(cell, taken)
        except (TypeError, ValueError, OverflowError):
            how = "" if taken is None else f" with the {taken.removesuffix('-first')} first"
            text = f"column {column} has {shown(cell)} in row {row}, a date{how} or a time is needed"
            raise RowsError(f"{name}: {text}") from None
        if before not in (None, kind):
            raise RowsError(f"{name}: column {column} has {shown(cell)} in row {row}, {kind}, after {before}; give all alike")
        before = kind
    return out


def _order(cells: list[Any]) -> str | None:
    """Whether the day or the month comes first in texts; None where the year does in all."""
    found = [match for cell in cells if isinstance(cell, str) and (match := _LAST.match(cell.strip()))]
    if not found:
        return None
    for part, order in zip((1, 3), _ORDERS):
        if any(int(match[part]) > 12 for match in found):
            return order
    return "day-first" if found[0][2] == "." else "month-first"


def _seconds(cell: Any, order: str | None) -> tuple[str, float]:
    """What a value is and its seconds, or the number that it is; raises TypeError or ValueError where it is none of them."""
    if isinstance(cell, np.datetime64 | np.timedelta64):
        cell = cell.astype(f"{cell.dtype.kind}8[us]").item()
    if isinstance(cell, datetime.timedelta):
        return _TIME, cell.total_seconds()
    if isinstance(cell, datetime.time):
        return _TIME, cell.hour * 3600 + cell.minute * 60 + cell.second + cell.microsecond / 1e6
    if isinstance(cell, int | float | np.number) and not isinstance(cell, bool):  # such as milliseconds since 1970 in JSON
        return _NUMBER, float(cell)
    if isinstance(cell, str):
        if span := _SPAN.fullmatch(cell.strip()):
            days, hours, minutes, seconds = span.groups()
            whole = (int(days or 0) * 24 + int(hours)) * 3600 + int(minutes) * 60
            return _TIME, whole + float((seconds or "0").replace(",", "."))
        moment = _read(cell.strip(), order)
    elif isinstance(cell, datetime.datetime):
        moment = cell
    elif isinstance(cell, datetime.date):
        moment = datetime.datetime(cell.year, cell.month, cell.day)
    else:
        raise TypeError
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return _DATE, moment.timestamp()


def _read(text: str, order: str | None) -> datetime.datetime:
    if match := _FIRST.match(text):
        year, month, day = match.groups()
    elif match := _LAST.match(text):
        first, _, second, year = match.groups()
        day, month = (first, second) if order == "day-first" else (second, first)
    else:
        raise ValueError
    if (clock := _CLOCK.fullmatch(text, match.end())) is None:
        raise ValueError
    hour, minute, second, fraction, half, zone = clock.groups()
    hours = int(hour or 0)
    if half:
        if hours > 12:
            raise ValueError
        hours = hours % 12 + 12 * (half in "pP")
    micro = int((fraction or "0").ljust(6, "0")[:6])
    moment = datetime.datetime(int(year), int(month), int(day), hours, int(minute or 0), int(second or 0), micro)
    if zone is None:
        return moment
    if zone == "Z":
        return moment.replace(tzinfo=datetime.UTC)
    sign, digits = zone[0], zone[1:].replace(":", "")
    away = datetime.timedelta(hours=int(digits[:2]), minutes=int(digits[2:] or 0))
    return moment.replace(tzinfo=datetime.timezone(-away if sign == "-" else away))
