"""A draft of the schema of a table of experiments, to be checked and edited by the user."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import flat, is_category, is_missing, is_number
from deadreckon.data.kinds import check_column
from deadreckon.data.roles import row_numbers
from deadreckon.errors import UserError
from deadreckon.mbo.design_schema import DesignColumn, DesignSchema
from deadreckon.mbo.design_table import by_scored, name_of, numbers_of, read_designs, scored, trimmed
from deadreckon.mbo.doubts import of_inputs, of_outcomes, of_target, spans_decades, sum_of, unsaid_sums
from deadreckon.mbo.rules import Rules
from deadreckon.mbo.variables import Mend, Variable, name_of_rows, texts_told, variable_of


def describe(path: Path | str, target: str | None = None, **ways: Any) -> tuple[DesignSchema, list[str]]:
    """Drafts a schema for a table: the target, and for all other columns the kind, the range or the levels.

    Args:
        path: of the file.
        target: its column of scores; None: the last column of numbers.
        ways: options of the reader of tables.

    Returns:
        The schema, and one line for each choice that should be checked.

    Raises:
        UserError: the file cannot be read, or has no column of numbers.
    """
    table, dialect, told, converts = read_designs(path, ways, numbers=() if target is None else (target,))
    table, name, names = trimmed(table, table.column_names), name_of(path), table.column_names
    left = row_numbers(names)
    if target is not None:
        check_column(table, target, name)
    else:
        target = _last_of_numbers(name, table, [column for column in names if column not in left])
        told.append(f"the last column of numbers, {target}, is taken as the target (--target)")
    if converts:
        table, told = by_scored(table, dialect, told, [target])
    rows, planned = scored(name, table, [target])
    told += [planned] if planned else []
    columns: dict[str, DesignColumn] = {}
    inputs: dict[str, tuple[Variable, np.ndarray]] = {}
    y = None
    for column in names:
        if column == target:
            try:  # not `variable_of`, as a score may have more digits than an input
                y = numbers_of(name, table, column, rows)
            except UserError as error:
                columns[column] = DesignColumn("target", about=str(error).removeprefix(f"{name}: "))
                told.append(columns[column].about)
                continue
            columns[column] = DesignColumn("target", about=_counted(y))
            told += of_target(column, y, rows)
            continue
        if column in left:
            columns[column] = DesignColumn("ignore", about="looks like a row number")
            continue
        try:
            values, v = variable_of(name, table, column, None, None, None, rows, converts)
        except Mend as error:  # drafted as an input that is refused, as leaving it out could go unnoticed
            columns[column] = DesignColumn("input", about=str(error).removeprefix(f"{name}: "))
            told.append(f"{columns[column].about}; it is drafted as an input, and refused until then")
            continue
        except UserError as error:
            columns[column] = DesignColumn("ignore", about=str(error).removeprefix(f"{name}: "))
            told.append(f"{columns[column].about}: ignored so far")
            continue
        if v.leveled:
            numbers = all(isinstance(level, int | float) or is_number(str(level)) for level in v.levels)
            more = "" if numbers else "; if they are in order, make it ordinal"
            columns[column] = DesignColumn("input", v.kind, levels=v.levels, about=f"{len(v.levels)} levels{more}")
        else:
            columns[column] = DesignColumn("input", v.kind, v.low, v.high, log=spans_decades(values), about=_counted(values))
        inputs[column] = v, values
    while names := _names_of_rows(inputs, rows):
        for column, why in names.items():
            columns[column] = DesignColumn("ignore", about=why)
            told.append(f"{why}: ignored so far")
            del inputs[column]
    variables, x = [v for v, _ in inputs.values()], _stacked(inputs, rows)
    told += texts_told(table, variables)
    sums = [sum_of([variables[i].name for i in group], whole) for group, whole in unsaid_sums(variables, x)]
    told += [f"{each} in every row, and the draft has it as a constraint of proposals" for each in sums]
    told += of_inputs(variables, x, rows, rules=Rules.of(variables, constraints=sums, name=name))
    told += [] if y is None else of_outcomes(variables, x, target, y)
    ways = ({} if dialect is None else dialect.options) | ways
    return DesignSchema(columns, constraints=tuple(sums), table=ways), told


def _counted(values: np.ndarray) -> str:
    return f"{len(set(values.tolist())):,} different values"


def _stacked(inputs: Mapping[str, tuple[Variable, np.ndarray]], rows: np.ndarray) -> np.ndarray:
    """(rows, inputs) values; there may be no inputs."""
    return np.reshape([values for _, values in inputs.values()], (len(inputs), len(rows))).T


def _names_of_rows(inputs: Mapping[str, tuple[Variable, np.ndarray]], rows: np.ndarray) -> dict[str, str]:
    """The first column that identifies rows, and the reason. At most one: without it there may be fewer different designs."""
    designs = len(np.unique(_stacked(inputs, rows), axis=0))
    for column, (v, values) in inputs.items():
        if why := name_of_rows(v, values, designs):
            return {column: why}
    return {}


def _last_of_numbers(name: str, table: pa.Table, names: Sequence[str]) -> str:
    """The last column that holds numbers, and these in at least half of the rows."""
    for column in reversed(names):
        values = flat(table, column, ignored=True)
        rows = np.flatnonzero(~is_missing(values))
        if 2 * len(rows) < max(table.num_rows, 1) or is_category(values.type):
            continue
        with contextlib.suppress(UserError):
            numbers_of(name, table, column, rows)
            return column
    raise UserError(f"{name}: no column holds numbers that could be the target")
