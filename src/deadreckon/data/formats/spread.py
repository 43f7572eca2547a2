"""Conversion of a log to one table, and of a table to the columns of a log. Under our names a vector is spread over columns
`observation_0, observation_1, ...`, and `final_observation_*` is filled only in the last row of an episode."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import compute, decoded, flat, is_category, is_missing, log_probabilities, numbers
from deadreckon.data.asked import Asked
from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import arrays_of, last_rows
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.header import Header, damaged
from deadreckon.data.frame import ALONE, FrameColumns, table_columns
from deadreckon.data.roles import like, not_observed, numbered, ours, row_numbers
from deadreckon.data.scratch import Scratch
from deadreckon.errors import UserError, unknown

# Our name in a table for each column of a log.
_SINGULAR = {"observations": "observation", "actions": "action", "rewards": "reward", "terminals": "terminal",
             "timeouts": "timeout", "next_observations": "next_observation",
             "final_observations": "final_observation"}  # fmt: skip
_PLURAL = {value: key for key, value in _SINGULAR.items()}
_DONE = ("done", "dones")  # alone they are refused, as they do not say how an episode ended
# Any of these columns, or a time, indicates that rows follow each other.
_ORDERED = {"terminals", "timeouts", "next_observations", "final_observations", *_DONE}
_MAPPING = ("schema", *Asked._fields)
Groups = dict[str, list[str]]  # {column of the log: its columns in the table}
Shapes = dict[str, tuple[tuple[int, ...], np.dtype]]  # {column: (shape of a row, dtype)}


def to_table(log: Dataset) -> pa.Table:
    """`log` as a pyarrow table: `episode`, then every column, vectors spread over name_0, name_1, ...

    Raises:
        UserError: two columns would have the same name.
    """
    table: dict[str, Any] = {"episode": log.episode_of.astype(np.int64)}
    columns = arrays_of(log)
    known = columns.pop("final_known")
    final = columns.pop("final_observations")
    unknown = np.zeros(len(log), bool)
    unknown[log.ends[~known]] = True
    for key, column in columns.items():
        _spread(table, _SINGULAR.get(key, key), column, log.name, unknown if key == "next_observations" else None)
    if log.successors is None:
        rows = log.ends[known]
        elsewhere = np.ones(len(log), bool)
        elsewhere[rows] = False
        for index, values in enumerate(final.reshape(len(final), -1)[known].T):
            spread = np.zeros(len(log), final.dtype)
            spread[rows] = values
            table[f"final_observation_{index}"] = pa.array(spread, mask=elsewhere)
    return pa.table(table)


def _spread(table: dict[str, Any], name: str, column: np.ndarray, log: str, empty: np.ndarray | None) -> None:
    parts = {name: np.asarray(column)} if column.ndim == 1 else {
        f"{name}_{index}": np.ascontiguousarray(values)
        for index, values in enumerate(np.asarray(column).reshape(len(column), -1).T)
    }  # fmt: skip
    for key, values in parts.items():
        if key in table or key.startswith("final_observation"):
            raise UserError(f"{log}: column {name} would be the table's column {key}, which is another; write .npz or .hdf5")
        table[key] = values if empty is None else pa.array(values, mask=empty)


def shapes_of(log: Dataset) -> dict[str, Any]:
    """Shapes and types of the columns of `log`, which a table does not have, as JSON values for its header."""
    return {key: (list(column.shape[1:]), str(column.dtype)) for key, column in arrays_of(log).items()}


def told_shapes(path: Path | str, header: Header) -> Shapes:
    """The shapes that `shapes_of` has put into a header."""
    try:
        shapes = {key: (tuple(shape), np.dtype(dtype)) for key, (shape, dtype) in (header.columns or {}).items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise damaged(path, f"columns: {error}") from error
    for key, (shape, dtype) in shapes.items():
        if not all(type(size) is int and size >= 0 for size in shape) or dtype.kind not in "fiub":
            raise damaged(path, f"column {key} of shape {list(shape)}, {dtype}")
    return shapes


def from_anybody(
    path: Path | str, table: pa.Table, mapping: dict[str, Any], horizon: int | None, scratch: Scratch | None = None,
    dialect: Dialect | None = None,
) -> FrameColumns:  # fmt: skip
    """The columns of a log from a table that this package did not write, with notes for the provenance and warnings.

    Args:
        path: named in errors.
        table: (rows,) of each column.
        mapping: a schema, or the roles of columns, as for `frame_columns`, or None; without any of these, columns have our
            names, or others with roles, or both.
        horizon: steps after which episodes of columns with our names are cut off, or None.
        scratch: where columns are kept; None: in memory.
        dialect: how the file was read; None: nothing of it is noted for files of further rows.

    Raises:
        UserError: one line with file, column and row.
    """
    given = {key: value for key, value in mapping.items() if value is not None}
    for key in given:
        if key not in _MAPPING:
            raise unknown("option", key, _MAPPING)
    if not given and ours(table.column_names):
        groups = _groups(path, table.column_names, {})
        telling = [] if _written(groups) else [key for key in _with_roles(groups) if not like("cost", key) and key not in _DONE]
        if not telling:
            return _named_ours(path, table, horizon, scratch)
        for there, what in (("final_observation" in groups, "final_observation_*"), (horizon is not None, "a horizon")):
            if there:
                raise UserError(
                    f"{path}: {what} and a column {telling[0]}, whose name gives it a role, cannot both be; leave one out, or "
                    "call ends and episodes terminal, timeout and episode"
                )
        table = table.select([column for parts in groups.values() for column in parts])  # of vectors, in their order
        given = _beside(groups)
    if horizon is not None:
        raise UserError(f"{path}: where columns are named, --timeout names the one that marks time limits; no horizon")
    return table_columns(table, given.pop("schema", None), str(path), scratch, dialect=dialect, **given)


def _written(groups: Groups) -> bool:
    """Whether columns are in the order of `to_table`, so that all others are extras whatever their names are."""
    return list(groups)[:6] == ["episode", "observation", "action", "reward", "terminal", "timeout"]


def _with_roles(groups: Groups) -> list[str]:
    """Other columns than ours whose names give them a role; a time has one if there are episodes, whose rows it orders."""
    found = [key for key in groups if not_observed(key) and key not in _PLURAL and key not in ("episode", "propensity")]
    likely, episodes = {"propensity", LOG_PROBS} & groups.keys(), any(like("episode", key) for key in groups)
    return [key for key in found if not (likely and like("propensity", key)) and (episodes or not like("time", key))]


def _beside(groups: Groups) -> dict[str, Any]:
    """The mapping for a table with our names and others with roles, which are assigned by their names; the rest is kept."""
    rest = groups.keys() - _PLURAL.keys() - {"episode"} - set(_with_roles(groups)) - set(row_numbers([*groups]))
    asked = {"propensity": "propensity"} if "propensity" in groups and LOG_PROBS not in groups else {}
    kept = [column for key, parts in groups.items() if key in rest and key not in asked for column in parts]
    return {"action": "action", "reward": "reward", "keep": kept, **asked}


def _named_ours(path: Path | str, table: pa.Table, horizon: int | None, scratch: Scratch | None) -> FrameColumns:
    """The columns of a user's table with our names, by `from_arrays` names."""
    columns, warnings = from_table(path, table, scratch=scratch), []
    ordered = _ORDERED & columns.keys() or any(like(role, key) for role in ("episode", "time") for key in table.column_names)
    if horizon is None and not ordered:
        columns["terminals"] = np.ones(table.num_rows, bool)  # no sign of episodes: independent decisions
        warnings.append(ALONE)
    clock = [key for key in table.column_names if like("time", key) and "episode" not in table.column_names and key in columns]
    if clock and (falls := int((columns[clock[0]][1:] < columns[clock[0]][:-1]).sum())):
        text = f"rows are taken in the table's order, in which {clock[0]} falls {falls:,} times"
        warnings.append(f"{text}: --time {clock[0]} puts them in its order")
    if "propensity" in columns and LOG_PROBS not in columns:
        columns[LOG_PROBS] = log_probabilities(str(path), table, "propensity", columns["actions"])
        del columns["propensity"]
    return FrameColumns(columns, {}, warnings)


def from_table(
    path: Path | str, table: pa.Table, shapes: Shapes | None = None, scratch: Scratch | None = None
) -> dict[str, np.ndarray]:
    """The columns of a table that has our names, by `from_arrays` names.

    Args:
        path: named in errors.
        table: (rows,) of each column.
        shapes: of rows of columns, by `told_shapes`; None: numbers and vectors.
        scratch: where columns are kept; None: in memory.

    Raises:
        UserError: one line with file, column and row.
    """
    if not table.num_rows:
        raise UserError(f"{path}: the log has no rows")
    shapes, scratch = shapes or {}, scratch or Scratch()
    columns: dict[str, np.ndarray] = {}
    groups = _groups(path, table.column_names, shapes)
    table, unknown = _filled(table, groups)
    for name, parts in groups.items():
        key = _PLURAL.get(name, name)
        if name in ("episode", "final_observation"):
            continue
        values = [_values(path, table, part) for part in parts]
        column = values[0] if parts == [name] else scratch.stacked(values)
        if key == "actions" and parts != [name]:
            column = column.astype(np.float32)  # a lone action_0 is a vector of one number, even with cells 1, 0, 1
        if key in shapes:
            shape, dtype = shapes[key]
            if column[:1].size != math.prod(shape):
                raise damaged(path, f"column {key} of shape {list(shape)} has {column[:1].size} numbers per row")
            column = column.reshape(len(column), *shape).astype(dtype, copy=False)
        columns[key] = column
    if "episode" in table.column_names:
        _cut_at_episodes(path, table, columns)
    if unknown.any():
        columns["final_known"] = _known_finals(path, columns, unknown, groups["next_observation"][0])
    finals = groups.get("final_observation")
    if finals and "next_observations" not in columns:
        columns |= _finals(path, table, finals, columns)
    return columns


def _cut_at_episodes(path: Path | str, table: pa.Table, columns: dict[str, np.ndarray]) -> None:
    """Sets `timeouts` of the last rows of the episodes that the column `episode` tells apart, unless they are terminals."""
    names, rows = flat(table, "episode"), table.num_rows
    if is_category(names.type):  # texts
        if (gone := is_missing(names)).any():
            raise UserError(f"{path}: column episode is empty in row {int(np.argmax(gone))}")
        episode = decoded(names).dictionary_encode().indices.to_numpy().astype(np.float64)
    else:
        episode = numbers(str(path), table, "episode")
    if np.abs(episode).max() >= 2**53:
        raise UserError(f"{path}: column episode has numbers from 2^53 on, where they are rounded; number the episodes")
    change = np.append(episode[1:] != episode[:-1], True)
    if int(change.sum()) != len(np.unique(episode)):
        row = _returns(episode, change)
        raise UserError(
            f"{path}: the rows of episode {names[row].as_py()} are not together (row {row}); "
            "name all columns (--episode, --time, --action, --reward) to have them sorted"
        )
    terminals = np.asarray(columns.get("terminals", np.zeros(rows, bool)))
    given = np.asarray(columns.get("timeouts", np.zeros(rows, bool)))
    if given.dtype.kind in "biuf" and given.shape == (rows,):  # others are refused later
        columns["timeouts"] = np.where(change & (terminals == 0) & (given == 0), given.dtype.type(1), given)


def _known_finals(path: Path | str, columns: dict[str, np.ndarray], unknown: np.ndarray, called: str) -> np.ndarray:
    """(episodes,) bool: the next observation of the episode's last row is known.

    Args:
        path: named in errors.
        columns: with the flags of ends.
        unknown: (rows,) bool, where the next observation is missing.
        called: the first column of next observations, for errors.
    """
    inside = unknown.copy()
    inside[last := last_rows(columns, len(unknown))] = False
    if inside.any() or "timeouts" not in columns:  # without flags, next observations show the ends
        row = int(np.argmax(inside if inside.any() else unknown))
        raise UserError(f"{path}: column {called} is empty in row {row}")
    return ~unknown[last]


def _filled(table: pa.Table, groups: Groups) -> tuple[pa.Table, np.ndarray]:
    """The table with unknown next observations replaced by the row's observation, and (rows,) bool: which are unknown."""
    following, own = groups.get("next_observation", []), groups.get("observation", [])
    unknown = np.full(table.num_rows, bool(following) and len(following) == len(own))
    for column in following:
        unknown &= is_missing(table.column(column).combine_chunks())
    if unknown.any():
        for column, observed in zip(following, own, strict=True):
            values = compute.if_else(pa.array(unknown), table.column(observed), table.column(column))
            table = table.set_column(table.column_names.index(column), column, values)
    return table, unknown


def _finals(path: Path | str, table: pa.Table, parts: list[str], columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rows = last_rows(columns, table.num_rows)
    known = ~np.all([is_missing(table.column(part).combine_chunks())[rows] for part in parts], 0)
    last = table.select(parts).take(rows).filter(pa.array(known))
    shape = columns["observations"].shape[1:]
    final = np.zeros((len(rows), *shape), columns["observations"].dtype)
    values = np.stack([_values(path, last, part) for part in parts], 1)
    if values.shape[1] != int(np.prod(shape)):
        raise UserError(f"{path}: {len(parts)} columns final_observation_*, {int(np.prod(shape))} are needed")
    final[known] = values.reshape(-1, *shape)
    return {"final_observations": final, "final_known": known}


def _groups(path: Path | str, names: list[str], shapes: Shapes) -> Groups:
    """The columns of a log: name_0, name_1, ... belong together if all are there and `name` is not."""
    scalars = {key for key, (shape, _) in shapes.items() if not shape}
    groups: dict[str, list[str]] = {}
    for column in names:
        prefix, _, number = column.rpartition("_")
        together = number.isdecimal() and prefix and column not in scalars
        if together and prefix in names:  # a separate column; ambiguous if the prefix is a main column
            if prefix in _PLURAL:
                raise UserError(
                    f"{path}: there are columns {prefix} and {column}; rename one, or name all columns (--action, --reward)"
                )
            together = False
        groups.setdefault(prefix if together else column, []).append(column)
    return {key: parts if parts == [key] else numbered(parts, key) for key, parts in groups.items()}


def _values(path: Path | str, table: pa.Table, column: str) -> np.ndarray:
    """A column as it is stored; missing values and texts are refused."""
    values = table.column(column)
    if not len(values):
        return np.zeros(0, np.float32)
    if pa.types.is_null(values.type) or values.null_count:
        row = int(np.argmax(values.is_null().to_numpy()))
        raise UserError(f"{path}: column {column} is empty in row {row}")
    if not (pa.types.is_boolean(values.type) or pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
        raise UserError(
            f"{path}: column {column} holds {values.type}, numbers are needed; name your columns "
            "(--action, --reward, --observations) to have it encoded or left out"
        )
    return values.to_numpy()


def _returns(episode: np.ndarray, change: np.ndarray) -> int:
    """The first row where an episode continues after rows of another one."""
    starts = np.append(0, np.flatnonzero(change)[:-1] + 1)
    _, first = np.unique(episode[starts], return_index=True)
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]])
