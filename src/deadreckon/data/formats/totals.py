"""Detection of a last row of totals, as in spreadsheets and reports, which is not a row of data."""

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
_ROWS = 10  # least number of rows above; with fewer, such a sum may occur by chance
_COLUMNS = 2  # least number of columns with sums or means


def of_totals(table: pa.Table) -> list[str]:
    """A message, in a list, if the last row looks like a total; else an empty list.

    It does if it has a text such as total or average that is in no other row of the column, or if at least two columns of
    numbers, and half of all, have the sums or the means of the rows above. A sum must be larger than all its terms, and a mean
    must be none of the values above, because flags and counts have such a last value by chance.

    Args:
        table: as it was read.
    """
    above = table.num_rows - 1
    if above < 1:
        return []
    numbers, sums = 0, []
    for name, values in zip(table.column_names, table.columns, strict=True):
        if not values[above].is_valid:
            continue
        if is_string(values.type):
            last = values[above].as_py()
            if _WORDS.fullmatch(last.strip()) and _compute.sum(_compute.equal(values, last)).as_py() == 1:
                return [_line(above, f"column {name} has {last!r}")]
        elif above >= _ROWS and (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
            numbers += 1
            sums += [name] if _summed(values.slice(0, above), float(values[above].as_py())) else []
    if len(sums) < _COLUMNS or 2 * len(sums) < numbers:
        return []
    return [_line(above, f"columns {', '.join(sums[:4])} have the sums or the means of the rows above")]


def _line(row: int, why: str) -> str:
    return f"the last row, {row}, looks like a total ({why}); take it out of the table if it is no row of data"


def _summed(values: Any, last: float) -> bool:
    """Whether `last` is the sum or the mean of `values`, and not likely to be so by chance."""
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
