"""A table as it would be read, described column by column: a schema for the user to check and edit."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import as_dates, compute, distinct, flat, is_missing, ordered_moments, to_arrow
from deadreckon.data.asked import Asked
from deadreckon.data.dataset import Dataset
from deadreckon.data.draft import Drafted, draft
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.frame import FrameColumns, table_columns
from deadreckon.data.leaks import leaks
from deadreckon.data.provenance import Provenance
from deadreckon.data.schema import Column, Schema
from deadreckon.data.text_columns import with_dates
from deadreckon.errors import UserError


def describe_table(source: Any, **asked: Any) -> Drafted:
    """Drafts the schema of a table, with levels, ranges and the replacements of missing values.

    Args:
        source: the path of a file that holds a table, or a table as `frame_columns` takes it.
        **asked: the known roles of columns; see `data.frame.frame_columns`.

    Returns:
        The schema, and messages on what to check.

    Raises:
        UserError: no such file or table, or a given column does not exist.
    """
    file = Path(source) if isinstance(source, str | Path) else None
    name = str(file) if file else "frame"  # for errors
    ways: dict[str, Any] = {}
    lines: list[str] = []  # of the file's reader
    if file is None:
        table, _, lines = with_dates(to_arrow(source, name), Dialect.asked(dates=asked.pop("dates", None)).dates)
    else:
        from deadreckon.data.formats.any_table import table_of_kind
        from deadreckon.data.formats.kind import READING, sniff
        from deadreckon.data.formats.words import levels_in

        ways = {key: asked.pop(key) for key in READING if key in asked}
        table, dialect, lines = table_of_kind(file, sniff(file, ways.get("separator")), ways, levels_in(asked))
        ways = ({} if dialect is None else dialect.options) | ways
    schema, told = draft(table, Asked(**asked), name, needed=False)
    for role in ("action", "reward"):
        if not schema.having(role):
            told.insert(0, f'no column is the {role} by its name: give one the role "{role}"')
    found = [replace(column, reason=_about(column, table)) for column in schema.columns]
    if all(schema.having(role) for role in ("action", "reward", "observation")):
        try:
            read = table_columns(table, schema, name)
        except UserError as error:  # what must be mended in the table, or in the schema
            told.insert(0, str(error).removeprefix(f"{name}: "))
        else:
            told += [line for line in read.warnings if line not in told]
            told += _leaks(read, name)
            resolved = {column.name: column for column in Schema.from_json(read.extra["schema"]).columns}
            found = [replace(resolved[column.name], reason=column.reason, doubt=column.doubt) for column in found]
    where: Mapping[str, Any] = {"path": file.name, **ways} if file else {}
    return Drafted(Schema(tuple(found), where), [*lines, *told])


def _leaks(read: FrameColumns, name: str) -> tuple[str, ...]:
    """What looks like a leak in the log that the drafted schema makes, or nothing where it makes none yet."""
    try:
        log = Dataset.from_arrays(
            **read.columns, action_space=read.action_space, name=name, provenance=Provenance(extra=read.extra)
        )
    except UserError as error:
        return (str(error).removeprefix(f"{name}: "),)
    return leaks(log)


def _period(dates: Any) -> list[str]:
    """The first and the last of dates or durations, in a list; empty if there are none."""
    if not len(dates):
        return []
    order = ordered_moments(dates)
    ends = (dates[int(order.argmin())], dates[int(order.argmax())])
    if pa.types.is_duration(dates.type):
        ends = tuple(end.cast(pa.duration("us"), safe=False) for end in ends)
    elif getattr(dates.type, "unit", "") == "ns":  # whose objects in Python need another package
        return [" .. ".join(str(end.cast(pa.string()).as_py()) for end in ends)]
    return [" .. ".join(str(end.as_py()) for end in ends)]


def _about(column: Column, table: pa.Table) -> str:
    """Why a column has its role and kind, and what it holds."""
    values = flat(table, column.name, ignored=column.role == "ignore")
    absent = int(is_missing(values).sum())
    holds = []
    dates = as_dates(values) if column.kind == "date" else None
    if dates is not None:
        holds += _period(dates.drop_null())
    elif column.kind in ("number", "integer") and (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
        known = values.filter(compute.is_valid(values)).to_numpy(zero_copy_only=False)
        known = known[np.isfinite(known)]
        holds += [f"{known.min():g} .. {known.max():g}"] if len(known) else []
    if column.kind in ("integer", "category") and not pa.types.is_nested(values.type):
        holds.append(f"{distinct(values):,} different values")
    if absent:
        holds.append(f"{absent:,} missing")
    return "; ".join(filter(None, (column.reason, ", ".join(holds))))
