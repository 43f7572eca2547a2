"""What tables of results that come from elsewhere must be, before anything looks into their rows."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from deadreckon.errors import UserError
from deadreckon.foreign.shapes import checked, wrong
from deadreckon.foreign.text import parse_json

# Columns that every row has a value in; parts of earlier versions may lack others.
NEEDED = {
    "results": (
        "cell", "suite", "kind", "method", "agent", "settings", "on", "asked", "seed", "score", "failure", "seconds", "steps",
        "versions", "finished", "job",
    ),
    "curves": ("cell", "step"),
}  # fmt: skip
OBJECTS = ("settings", "asked", "more", "revisions", "versions")  # JSON


def check_part(path: Path | str, kind: str, schema: pa.Schema, found: pa.Table) -> pa.Table:
    """A part of a table of results, if it is one. A null score, as earlier versions wrote where there was none, is NaN.

    Args:
        path: of its file, for errors.
        kind: `results` or `curves`.
        schema: of all columns that it may have.
        found: the part.

    Raises:
        UserError: a column is of another type, lacks a value that every row has, or holds no JSON.
    """
    names = found.column_names
    for field in schema:
        if field.name not in names:
            continue
        got = found.schema.field(field.name).type  # a column without any value may have the type of nulls
        if not (got.equals(field.type) or pa.types.is_null(got)):
            raise UserError(f"{path}: column {field.name} of its {kind} must be of type {field.type}, got {got}")
    if kind == "results" and "score" in names and found["score"].null_count:
        scores = found["score"].cast(pa.float64()).fill_null(math.nan)
        found = found.set_column(names.index("score"), "score", scores)
    for name in NEEDED[kind]:
        if name not in names:
            raise UserError(f"{path}: its {kind} lack the column {name}")
        if found[name].null_count:
            raise UserError(f"{path}: column {name} of its {kind} must have a value in every row, got null")
    for name in set(OBJECTS) & set(names) & set(schema.names):
        for text in found[name].unique().to_pylist():  # few different ones
            if text is not None:
                checked(parse_json(f"{path}: column {name}", text), dict, f"{path}: column {name}")
    return found


def names_of(rows: Iterable[Mapping[str, Any]]) -> set[str]:
    """Columns and further numbers of the rows that have not failed; empty where there are none."""
    return {name for row in rows if not row["failure"] for name in (*row, *json.loads(row["more"] or "{}"))}


def number(row: Mapping[str, Any], column: str) -> float:
    """What a row of results has under a name, in a column or in its `more`; NaN where it has nothing.

    Raises:
        UserError: it is no number.
    """
    found = row[column] if column in row else json.loads(row["more"] or "{}").get(column)
    if found is None:
        return math.nan
    if type(found) is float or (type(found) is int and abs(found) < 1e300):
        return float(found)
    raise wrong(f"{row['method']} on {row['on']}, seed {row['seed']} (cell {row['cell']})", column, "a number", found)
