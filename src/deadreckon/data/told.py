"""The use of every column of a log: role, kind, levels or range, missing cells, and its dimensions in the log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.held import HELD
from deadreckon.data.schema import Column, Schema
from deadreckon.data.spec import Box
from deadreckon.text_table import table

LEVELS = 6  # levels that are named
SHOWN = 40  # rows of a table on a terminal
_WIDTH = 60  # letters of a cell


@dataclass(frozen=True)
class Told:
    """One column, or one dimension of a log that has no columns.

    Attributes:
        name: of the column, or of the dimension.
        role: as in a schema, or "not in the schema".
        kind: as in a schema.
        holds: levels or range, with the unit.
        missing: cells without a value in the table, or None if they were not counted.
        becomes: its form in the log.
        dimensions: its indices in the (flattened) observation, or in the action; empty for other roles.
        marked: whether the last of these says where cells are missing.
    """

    name: str
    role: str
    kind: str
    holds: str
    missing: int | None
    becomes: str
    dimensions: tuple[int, ...] = ()
    marked: bool = False


def observation_names(log: Dataset) -> list[str]:
    """The name of each dimension of the flattened observation, `observation 3` where nobody gave one."""
    size = int(np.prod(log.spec.observation_shape))
    known = log.provenance.extra.get("observation_names")
    if isinstance(known, Sequence) and len(known) == size:
        return list(map(str, known))
    return [f"observation {i}" for i in range(size)]


def action_names(log: Dataset) -> list[str]:
    """The name of each action where they are discrete, and of each dimension where they are continuous."""
    space, schema = log.action_space, schema_of(log)
    columns = schema.named("action") if schema else []
    if isinstance(space, Box):
        return columns if len(columns) == space.size else [f"action {i}" for i in range(space.size)]
    levels = log.provenance.extra.get("action_levels")
    if not isinstance(levels, Sequence):
        return [str(i) for i in range(space.n)]
    return [str(levels[i]) if i < len(levels) else str(i) for i in range(space.n)]


def schema_of(log: Dataset) -> Schema | None:
    """The resolved schema of a log that was read from a table."""
    found = log.provenance.extra.get("schema")
    return None if found is None else Schema.from_json(found, log.name)


def weights_of(log: Dataset) -> str | None:
    """The column of weights of a log that was read from a table; None if there is none, or if all weights are the same."""
    schema = schema_of(log)
    found = None if schema is None else schema.one("weight")
    if found is None or found.name not in log.extras:
        return None
    return found.name if np.ptp(np.asarray(log.extras[found.name])) > 0 else None


def columns_of(log: Dataset) -> tuple[Told, ...]:
    """Every column of the table that the log was read from; its dimensions and extras where it was no table."""
    schema = schema_of(log)
    if schema is None:
        return _dimensions(log)
    held: dict[str, dict[str, Any]] = dict(log.provenance.extra.get(HELD) or {})
    names = {name: i for i, name in enumerate(observation_names(log))}
    acted, out = 0, []
    for column in schema.columns:
        seen = held.get(column.name, {})
        at: tuple[int, ...] = ()
        if column.role == "observation":
            at = _places(column, names)
        elif column.role == "action":
            at, acted = (acted,), acted + 1
        holds, missing, becomes = _holds(column, seen), seen.get("missing"), _becomes(log, column, seen, at)
        marked = bool(column.marked and column.role == "observation")
        out.append(Told(column.name, column.role, column.kind, holds, missing, becomes, at, marked))
    known = {column.name for column in schema.columns}
    for name, seen in held.items():
        if name not in known:
            out.append(Told(name, "not in the schema", "", _range(seen), seen.get("missing"), "left out: not in the schema"))
    return tuple(out)


def text_of_columns(columns: Sequence[Told]) -> str:
    """Plain text, a line a column; of more than `SHOWN` the first and the last ones."""
    cells = [[c.name, c.role, c.kind, c.holds, "?" if c.missing is None else f"{c.missing:,}", c.becomes] for c in columns]
    heads = ["column", "role", "kind", "levels or range", "missing", "becomes"]
    if len(cells) > SHOWN:
        gap = ["...", f"{len(cells) - SHOWN + 1:,} more", "", "", "", ""]
        cells = [*cells[: SHOWN - SHOWN // 4 - 1], gap, *cells[-(SHOWN // 4) :]]
    if all(c.missing is None for c in columns):
        heads, cells = heads[:4] + heads[5:], [row[:4] + row[5:] for row in cells]
    rows = [heads, *([" ".join(_cut(cell).split()) for cell in row] for row in cells)]
    return table(rows, rule=False)


def _dimensions(log: Dataset) -> tuple[Told, ...]:
    """Dimensions of the observation and the action, the reward and the extras."""
    observation, space, spec = log.spec.observation, log.action_space, log.spec
    if len(spec.observation_shape) > 1:
        shape = "x".join(map(str, spec.observation_shape))
        ends = f"{observation.min.min():.4g} .. {observation.max.max():.4g}"
        out = [Told("observations", "observation", spec.observation_dtype, ends, None, f"an image or array of {shape} numbers")]
    else:
        low, high = observation.min.ravel(), observation.max.ravel()
        out = [
            Told(name, "observation", "number", f"{low[i]:.4g} .. {high[i]:.4g}", None, f"observation {i}", (i,))
            for i, name in enumerate(observation_names(log))
        ]
    if isinstance(space, Box):
        for i, name in enumerate(action_names(log)):
            seen = f"{float(log.actions[:, i].min()):.4g} .. {float(log.actions[:, i].max()):.4g}"
            became = f"action {i}, bounds {space.low[i]:.4g} .. {space.high[i]:.4g}"
            out.append(Told(name, "action", "number", seen, None, became, (i,)))
    else:
        ends = f"{int(log.actions.min())} .. {int(log.actions.max())}"
        out.append(Told("actions", "action", "integer", ends, None, _coded(action_names(log)), (0,)))
    rewards = np.asarray(log.rewards)
    out.append(Told("rewards", "reward", "number", f"{rewards.min():.4g} .. {rewards.max():.4g}", None, "the reward"))
    for name, values in sorted(log.extras.items()):
        shape = "x".join(map(str, values.shape[1:])) or "1"
        kind = "propensity" if name == LOG_PROBS else "keep"
        out.append(Told(name, kind, str(values.dtype), "", None, f"stored with the log ({shape} per row)"))
    return tuple(out)


def _places(column: Column, names: dict[str, int]) -> tuple[int, ...]:
    """The dimensions that an observation became, that of its missing values the last."""
    keys = [f"{column.name}={level}" for level in column.levels or ()] if column.kind == "category" else [column.name]
    keys += [f"{column.name}_missing"] if column.marked else []  # else a column of its own may be called so
    return tuple(names[key] for key in keys if key in names)


def _holds(column: Column, seen: dict[str, Any]) -> str:
    if column.levels is not None:
        shown = ", ".join(map(str, column.levels[:LEVELS]))
        return shown + (f", ... ({len(column.levels)} levels)" if len(column.levels) > LEVELS else "")
    return " ".join(filter(None, (_range(seen), column.unit)))


def _range(seen: dict[str, Any]) -> str:
    return f"{seen['low']:.6g} .. {seen['high']:.6g}" if "low" in seen and "high" in seen else ""


def _becomes(log: Dataset, column: Column, seen: dict[str, Any], at: tuple[int, ...]) -> str:
    """What the log makes of a column, in words."""
    if column.role == "observation" and at:
        span = f"observation {at[0]}" + (f"-{at[-1]}" if len(at) > 1 else "")
        how = ["one 0/1 number per level"] if column.kind == "category" else []
        if column.marked:
            filled = "no level" if column.fill is None else f"{column.fill:.4g}"
            how.append(f"missing cells: {filled}, marked by 1 in the last")
        return span + (f" ({'; '.join(how)})" if how else "") + _kept(column)
    if column.role == "action":
        if isinstance(log.action_space, Box):
            low, high = log.action_space.low[at[0]], log.action_space.high[at[0]]
            return f"action {at[0]}, bounds {low:.4g} .. {high:.4g}"
        return _coded(action_names(log))
    if column.role == "ignore":
        return f"left out: {seen.get('reason') or 'by request'}"
    words = {
        "reward": "the reward", "next_observation": f"the next {column.of}", "episode": "identifies episodes",
        "time": "orders the steps", "terminal": "marks terminals", "timeout": "marks timeouts",
        "propensity": f"its logarithm is kept as {LOG_PROBS}", "group": "kept; its episodes are held out together",
        "cost": "a cost, kept", "legal": f"legal actions, the last {log.spec.mask_size} numbers of the observation",
        "next_legal": "legal actions of the next observation",
    }  # fmt: skip
    return words.get(column.role, "stored with the log") + (_kept(column) if column.role in words else "")


def _kept(column: Column) -> str:
    return ", and kept" if column.keep else ""


def _coded(names: Sequence[str]) -> str:
    """Codes of discrete actions and their names."""
    codes = list(map(str, range(len(names))))
    if codes == list(names):
        return f"actions 0 .. {len(names) - 1}"
    more = ", ..." if len(names) > LEVELS else ""
    return f"actions {', '.join(codes[:LEVELS])}{more} = {', '.join(names[:LEVELS])}{more}"


def _cut(cell: str) -> str:
    return cell if len(cell) <= _WIDTH else f"{cell[: _WIDTH - 3]}..."
