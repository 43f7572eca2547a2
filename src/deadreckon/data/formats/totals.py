"""A last row that sums the rows above up, as spreadsheets and reports have it: it is no step, and is told."""

import re
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import compute as _compute
from deadreckon.data.arrow import is_string

_WORDS = re.compile(
    r"((grand|sub|over)?[\s-]*totals?|sums?|means?|averages?|avg|(gesamt)?summe|gesamt|insgesamt|mittelwert|durchschnitt|somme|"
    r"moyenne|totale?)\s*:?",
    re.IGNORECASE,
)
_ROWS = 10  # above; fewer rows have such a sum by chance
_COLUMNS = 2  # that are sums or means


def of_totals(table: pa.Table) -> list[str]:
    """The line that says that the last row looks like a total, or nothing.

    It does where a text such as total or average stands in it and in no other row of its column, or where two columns of
    numbers or more, and half of all, are the sums of the rows above or their means. A sum must be larger than all that it sums,
    and a mean must be none of the values above, because flags and counts have such a last value by chance.

    Args:
        table: as it was read.
    """
    above = table.num_rows - 1
    if above < 1:
        return []
    numbers, sums = 0, []
    for name, values in zip(table.column_names, table.columns, strict=True):
        last = values[above].as_py()
        if last is None:
            continue
        if is_string(values.type):
            if _WORDS.fullmatch(last.strip()) and _compute.sum(_compute.equal(values, last)).as_py() == 1:
                return [_line(above, f"column {name} has {last!r}")]
        elif above >= _ROWS and (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
            numbers += 1
            sums += [name] if _summed(values.slice(0, above), float(last)) else []
    if len(sums) < _COLUMNS or 2 * len(sums) < numbers:
        return []
    return [_line(above, f"columns {', '.join(sums[:4])} have the sums or the means of the rows above")]


def _line(row: int, why: str) -> str:
    return f"the last row, {row}, looks like a total ({why}); take it out of the table if it is no row of data"


def _summed(values: Any, last: float) -> bool:
    """Whether a number is the sum or the mean of others, and none that could stand there by chance."""
    values = _compute.cast(values, pa.float64(), safe=False)  # large integers are rounded
    ends = _compute.min_max(values).as_py()
    if ends["min"] is None or ends["min"] == ends["max"]:
        return False
    total = float(_compute.sum(values).as_py())
    count = len(values) - values.null_count
    outside = abs(last) > max(abs(ends["min"]), abs(ends["max"]))
    if outside and np.isclose(last, total, rtol=1e-9, atol=0):
        return True
    return bool(np.isclose(last, total / count, rtol=1e-9, atol=0)) and not _compute.any(_compute.equal(values, last)).as_py()
