"""Conversion of texts to timestamps: 03.04.2024, 03/04/2024 14:30, 4/13/2024 2:30:00 PM, 2024/04/03 and ISO 8601."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from deadreckon.data.arrow import all_match
from deadreckon.data.arrow import compute as _compute

_TIME = (
    r"(?:(?:,? +|T)(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<fraction>\d{1,6}))?)?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?)?"
)
_LAST = rf"^(?P<first>\d{{1,2}})(?P<mark>[./-])(?P<second_>\d{{1,2}})[./-](?P<year>\d{{4}}){_TIME}$"
_FIRST = rf"^(?P<year>\d{{4}})(?P<mark>[./-])(?P<first>\d{{1,2}})[./-](?P<second_>\d{{1,2}}){_TIME}$"
_ZONED = r"^\d{4}-\d{2}-\d{2}[ T]\d{2}:\d{2}(?::\d{2}(?:\.\d{1,6})?)?(?:Z|[+-]\d{2}:?\d{2})$"
_ORDERS = {"day-first": "day{0}month{0}year", "month-first": "month{0}day{0}year"}


@dataclass
class _Dates:
    """A column of dates whose order is to be determined; `parts` is {part: (rows,) texts}."""

    parts: dict[str, Any]
    example: str
    mark: str
    order: str | None  # None if no part is above 12 in any row, or both are
    broken: bool  # both parts are above 12, each in some row


def dates_of(columns: Mapping[str, Any], asked: str | None, european: bool) -> tuple[dict[str, Any], str | None, list[str]]:
    """Converts the columns whose texts are all dates to timestamps.

    The day in 03/04/2024 is the part that `asked` names; else the part that is above 12 in some row of the column; else that of
    the other columns; else the first if the parts are separated by points; else, with a message that this is not certain, the
    first in European files and the second in others.

    Args:
        columns: {name: (rows,) texts}.
        asked: `iso`, `day-first` or `month-first`, or None.
        european: columns are separated by semicolons, or decimals by commas.

    Returns:
        {name: (rows,) timestamps}, the order that was used (None: none was, or columns differ), and messages.
    """
    done: dict[str, Any] = {}
    found: dict[str, _Dates] = {}
    told: list[str] = []
    for name, texts in columns.items():
        if all_match(texts, _ZONED):
            zoned = _cast(texts, pa.timestamp("us", "UTC"))
            done |= {} if zoned is None else {name: zoned}
        elif all_match(texts, _FIRST):
            parts = _parts(texts, _FIRST)
            moments = _moments(parts, "first", "second_")
            if moments is not None:
                done[name] = moments
                if (mark := parts["mark"].drop_null()[0].as_py()) != "-":
                    text = f"{texts.drop_null()[0].as_py()!r} are read as year{mark}month{mark}day"
                    told.append(f"dates such as {text}: column {name}")
        elif asked != "iso" and all_match(texts, _LAST):
            found[name] = _looked(texts)
    evident = {each.order for each in found.values() if each.order}
    common = evident.pop() if len(evident) == 1 else None
    taken: dict[tuple[str, str, bool], list[str]] = {}
    for name, each in found.items():
        order = asked or each.order or common or ("day-first" if each.mark == "." or european else "month-first")
        if each.broken and asked is None:
            order = "day-first" if european or each.mark == "." else "month-first"
        day, month = ("first", "second_") if order == "day-first" else ("second_", "first")
        moments = _moments(each.parts, month, day)
        if moments is None:
            row = _first_wrong(each.parts, month, day)
            text = f"{columns[name][row].as_py()!r} in row {row}, which is no date read as {_words(order, each.mark)} (--dates)"
            told.append(f"column {name} has {text}")
            continue
        done[name] = moments
        unsure = asked is None and each.order is None and common is None and each.mark != "."
        taken.setdefault((order, each.mark, unsure), []).append(name)
    for (order, mark, unsure), names in taken.items():
        example, other = found[names[0]].example, next(each for each in _ORDERS if each != order)
        text = f"dates such as {example!r} are read as {_words(order, mark)}"
        text += f", and no cell shows whether that is right (--dates {other})" if unsure else f" (--dates {other})"
        told += [f"{text}: {_listed(names)}"] if asked is None else []
    orders = {order for order, *_ in taken}
    # Further rows are read in one order; if columns differ there is none, and it is determined from their cells again.
    return done, asked or (orders.pop() if len(orders) == 1 else None), told


def _words(order: str, mark: str) -> str:
    return _ORDERS[order].format(mark)


def _listed(names: list[str]) -> str:
    return f"column{'s' if len(names) > 1 else ''} {', '.join(names)}"


def _parts(texts: Any, pattern: str) -> dict[str, Any]:
    found = _compute.extract_regex(texts, pattern)
    flat = found.combine_chunks() if isinstance(found, pa.ChunkedArray) else found
    # A chunked array of one chunk, or of none, may come back chunked.
    flat = pa.concat_arrays(flat.chunks) if isinstance(flat, pa.ChunkedArray) else flat
    return {field.name: _compute.struct_field(flat, field.name) for field in flat.type}


def _looked(texts: Any) -> _Dates:
    parts = _parts(texts, _LAST)
    above = [_compute.max(_compute.cast(parts[key], pa.int32())).as_py() > 12 for key in ("first", "second_")]
    order = None if above[0] == above[1] else "day-first" if above[0] else "month-first"
    return _Dates(parts, texts.drop_null()[0].as_py(), parts["mark"].drop_null()[0].as_py(), order, all(above))


def _moments(parts: dict[str, Any], month: str, day: str) -> Any:
    """(rows,) timestamps of the parts; None if one is no date, such as the 31st of February."""
    two = {key: _compute.utf8_lpad(parts[key], 2, "0") for key in (month, day)}
    hour = _compute.utf8_lpad(_or(parts["hour"], "0"), 2, "0")
    half = _compute.utf8_lower(_or(parts["half"], ""))
    if _compute.any(_compute.not_equal(half, "")).as_py():
        number = _compute.cast(hour, pa.int32())
        if (_compute.max(number).as_py() or 0) > 12:
            return None
        turned = _compute.if_else(_compute.equal(number, 12), 0, number)
        turned = _compute.add(turned, _compute.if_else(_compute.equal(half, "p"), 12, 0))
        hour = _compute.if_else(_compute.equal(half, ""), hour, _compute.utf8_lpad(_compute.cast(turned, pa.string()), 2, "0"))
    date = _compute.binary_join_element_wise(parts["year"], two[month], two[day], "-")
    clock = _compute.binary_join_element_wise(hour, _or(parts["minute"], "00"), _or(parts["second"], "00"), ":")
    fraction = _compute.utf8_rpad(_or(parts["fraction"], "0"), 6, "0")
    exact = _compute.any(_compute.not_equal(fraction, "000000")).as_py()
    clock = _compute.binary_join_element_wise(clock, fraction, ".") if exact else clock
    return _cast(_compute.binary_join_element_wise(date, clock, " "), pa.timestamp("us" if exact else "s"))


def _first_wrong(parts: dict[str, Any], month: str, day: str) -> int:
    """The first row that is not a date."""
    low, high = 0, len(parts["year"])
    while high - low > 1:  # bisection
        middle = (low + high) // 2
        some = {key: values[low:middle] for key, values in parts.items()}
        low, high = (low, middle) if _moments(some, month, day) is None else (middle, high)
    return low


def _or(values: Any, text: str) -> Any:
    """The values, with empty texts, which are missing parts, replaced by `text`."""
    return _compute.if_else(_compute.equal(values, ""), text, values)


def _cast(texts: Any, kind: pa.DataType) -> Any:
    try:
        return _compute.cast(texts, kind)
    except pa.ArrowInvalid:
        return None
