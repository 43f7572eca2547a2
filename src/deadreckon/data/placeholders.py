"""Numbers that may stand for missing values: -999 and the like, far from all other values of their column."""

from typing import Any

import pyarrow as pa

from deadreckon.data.arrow import compute

_USUAL = {sign * number for number in (99, 999, 9_999, 99_999, 999_999) for sign in (-1, 1)}


def placeholder(values: Any, remedy: str = "empty such cells") -> str:
    """What to say of a column whose least or greatest value is a usual placeholder; nothing where it holds none.

    Its rows must be two or more, and it must lie further from the other values than these lie apart.

    Args:
        values: (rows,) of any type; those that are no numbers hold none.
        remedy: what to do with it.
    """
    if not (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
        return ""
    for end in compute.min_max(values).as_py().values():
        if end not in _USUAL:
            continue
        same = compute.fill_null(compute.equal(values, end), False)
        rest = compute.min_max(values.filter(compute.invert(same))).as_py()
        count, (low, high) = compute.sum(same).as_py(), rest.values()
        if count > 1 and low is not None and 0 < high - low < max(low - end, end - high):
            found = f"has {end:g} in {count:,} rows, far from its other values, {low:g} .. {high:g}"
            return f"{found}, and is read as it is; {remedy} if they mean that the value is missing"
    return ""
