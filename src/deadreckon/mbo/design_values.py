"""The types of a schema of designs in TOML, against which `DesignSchema.load` checks a file."""

import datetime
from typing import NotRequired, TypedDict

Value = str | bool | int | float | datetime.date | datetime.datetime | datetime.time


class ColumnValues(TypedDict):
    """The types of a column's entries in TOML."""

    role: str
    kind: NotRequired[str]
    low: NotRequired[float]
    high: NotRequired[float]
    levels: NotRequired[list[Value]]
    step: NotRequired[float]
    log: NotRequired[bool]
    fix: NotRequired[Value]
    weight: NotRequired[float]
    unit: NotRequired[str]


class DesignValues(TypedDict):
    """The types of a schema's entries in TOML."""

    columns: dict[str, ColumnValues]
    minimise: NotRequired[bool]
    constraints: NotRequired[list[str]]
    mixtures: NotRequired[list[list[str]]]
    forbidden: NotRequired[list[str]]
    max_distance: NotRequired[float]
    apart: NotRequired[float]
    table: NotRequired[dict[str, str | int]]
