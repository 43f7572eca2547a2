"""What a table holds, column by column, as it was when it was read: kept with the log, whose numbers no longer show it."""

from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import compute, flat, is_missing, some_numbers
from deadreckon.data.schema import Schema

HELD = "held"  # the entry of `Provenance.extra`


def held(table: pa.Table, schema: Schema) -> dict[str, dict[str, Any]]:
    """By column: `missing` cells, `low` and `high` of numbers, `mean` of observed ones, and `reason` where it was left out.

    JSON values.

    Args:
        table: all its columns are counted, those that the schema does not have as well.
        schema: says why columns were left out.
    """
    by = {column.name: column for column in schema.columns}
    out: dict[str, dict[str, Any]] = {}
    for name in table.column_names:
        column = by.get(name)
        values = flat(table, name, ignored=column is None or column.role == "ignore")
        told: dict[str, Any] = {"missing": int(is_missing(values).sum())}
        if pa.types.is_integer(values.type) or pa.types.is_floating(values.type):
            told |= _range(values)
        if column is not None and column.role == "observation" and column.kind != "category":
            told |= _observed(name, values)
        if column is None:
            told["reason"] = "not in the schema"
        elif column.role == "ignore" and column.reason:
            told["reason"] = column.reason
        out[name] = told
    return out


def _observed(name: str, values: Any) -> dict[str, float]:
    """The mean of a column that is observed as a number, and its range where it holds numbers as texts."""
    number, missing = some_numbers("held", name, values)
    known = number[~missing] if missing.any() else number  # a copy less of a long column
    if not len(known) or not np.isfinite(known).all():
        return {}
    ends = {} if pa.types.is_boolean(values.type) else {"low": float(known.min()), "high": float(known.max())}
    return {**ends, "mean": float(known.mean())}


def _range(values: Any) -> dict[str, float]:
    """Least and greatest finite number, or nothing where there is none."""
    ends = compute.min_max(values).as_py()
    if None not in ends.values() and not np.isfinite(list(ends.values())).all():  # what is no number is seldom there
        ends = compute.min_max(values.filter(compute.is_finite(values))).as_py()
    found = {"low": ends["min"], "high": ends["max"]}
    return {} if found["low"] is None else {key: float(value) for key, value in found.items() if np.isfinite(float(value))}
