"""What columns must be to become a `Dataset`: checked once, block by block, with errors that name column and row."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.data.columns import COLUMNS, LOG_PROBS
from deadreckon.data.scratch import BLOCK
from deadreckon.data.spec import MOST_ACTIONS, Box, Discrete
from deadreckon.errors import UserError, naming

SLACK = 1e-6  # that a logarithm of a probability may lie above 0 by rounding
_LAST = ("final_observations", "final_known")  # have a row per episode


def checked_columns(log: str, columns: Mapping[str, Any], action_space: Box | Discrete | None) -> dict[str, Any]:
    """The fields of a `Dataset`.

    Args:
        log: its name, for errors.
        columns: by `Dataset.from_arrays` names, further ones among them; only those that are given.
        action_space: bounds of the actions; the range of the data if absent.

    Raises:
        UserError: one line that names the column and the row.
    """
    actions = np.asanyarray(columns["actions"])
    rows = len(actions) if actions.ndim else 0
    if rows == 0:
        raise UserError(f"{log}: the log has no rows")
    for key, value in columns.items():
        if key not in _LAST:
            value = np.asanyarray(value)
            if value.ndim == 0 or len(value) != rows:
                have = 0 if value.ndim == 0 else len(value)
                raise UserError(f"{log}: column {key} has {have} rows, actions have {rows}")
            _check_numbers(log, key, value)
    observations = _observation_column(log, "observations", columns["observations"])
    actions, space = _action_column(log, actions, action_space)
    extras = {key: np.asanyarray(value) for key, value in columns.items() if key not in COLUMNS}
    if isinstance(space, Discrete) and LOG_PROBS in extras:
        _check_log_probabilities(log, extras[LOG_PROBS])
    rewards = _flat(log, "rewards", columns["rewards"], np.float32)
    terminals = flags(log, "terminals", columns["terminals"]) if "terminals" in columns else np.zeros(rows, bool)
    following = columns.get("next_observations")
    if following is not None:
        following = _observation_column(log, "next_observations", following)
        if following.shape != observations.shape:
            raise UserError(f"{log}: next_observations have shape {following.shape}, observations {observations.shape}")
    if "timeouts" in columns:
        timeouts = flags(log, "timeouts", columns["timeouts"]).copy()
    elif following is not None:
        timeouts = np.append(breaks(observations, following), True) & ~terminals
    else:
        timeouts = np.zeros(rows, bool)
    timeouts[-1] |= not terminals[-1]
    final, known = _finals(log, columns, observations, following, np.flatnonzero(terminals | timeouts))
    return {
        "observations": observations, "actions": actions, "rewards": rewards, "terminals": terminals, "timeouts": timeouts,
        "final_observations": final, "final_known": known, "extras": extras, "action_space": space,
        "successors": None if following is None else if_needed(following, observations, terminals | timeouts),
    }  # fmt: skip


def _finals(
    log: str, columns: Mapping[str, Any], observations: np.ndarray, following: np.ndarray | None, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(episodes, *shape) what was seen after each episode's last row, and (episodes,) bool whether that is known."""
    if following is not None:
        return np.ascontiguousarray(following[last]), known_finals(log, columns, len(last))
    if "final_observations" not in columns:
        return np.ascontiguousarray(observations[last]), np.zeros(len(last), bool)
    _check_numbers(log, "final_observations", np.asanyarray(columns["final_observations"]))
    final = _observation_column(log, "final_observations", columns["final_observations"])
    if final.shape != (len(last), *observations.shape[1:]):
        want = (len(last), *observations.shape[1:])
        raise UserError(f"{log}: final_observations have shape {final.shape}, {want} is needed, one per episode")
    known = known_finals(log, columns, len(last))
    if not known.all():
        # A placeholder; nobody bootstraps from it, because these rows are dropped or terminal.
        final = np.where(known.reshape(-1, *[1] * (final.ndim - 1)), final, observations[last])
    return final, known


def known_finals(log: str, columns: Mapping[str, Any], episodes: int) -> np.ndarray:
    """(episodes,) bool of the column `final_known`; all true without one.

    Raises:
        UserError: it does not hold a truth value for each episode.
    """
    return flags(log, "final_known", columns["final_known"], episodes) if "final_known" in columns else np.ones(episodes, bool)


def _blocks(column: np.ndarray) -> range:
    return range(0, len(column), BLOCK)


def _check_numbers(log: str, key: str, column: np.ndarray) -> None:
    if column.dtype.kind not in "fiub":
        raise UserError(f"{log}: column {key} holds {column.dtype}, numbers are needed")
    if column.dtype.kind != "f":
        return
    for start in _blocks(column):
        bad = ~np.isfinite(column[start : start + BLOCK])
        if bad.any():
            where = np.argwhere(bad)[0]
            value = column[start + where[0]][tuple(where[1:])]
            never = ", as if the logged action had had no probability" if key == LOG_PROBS and value == -np.inf else ""
            raise UserError(f"{log}: column {key} has {value} in row {start + where[0]}{never}")


def _check_log_probabilities(log: str, column: np.ndarray) -> None:
    """Refuses probabilities given as their logarithms: every weight made of them would be wrong, and none would show it."""
    row, value, low, high = -1, 0.0, np.inf, -np.inf
    for start in _blocks(column):
        part = column[start : start + BLOCK]
        low, high = min(low, float(part.min())), max(high, float(part.max()))
        if row < 0 and high > SLACK:
            first = np.argwhere(part > SLACK)[0]
            row, value = start + int(first[0]), float(part[tuple(first)])
    if row < 0:
        return
    like = "; all values lie in 0 .. 1 and look like probabilities, give their logarithms" if low >= 0 and high <= 1 else ""
    found = f"column {LOG_PROBS} has {value:g} in row {row}"
    raise UserError(f"{log}: {found}, a log-probability of a discrete action is <= 0{like}")


def _observation_column(log: str, key: str, column: np.ndarray) -> np.ndarray:
    column = np.asanyarray(column)
    if column.ndim == 1:
        column = column[:, None]
    if column.dtype == np.uint8 and column.ndim >= 3:
        return column
    return _float32(log, key, column)


def _flat(log: str, key: str, column: np.ndarray, dtype: Any) -> np.ndarray:
    column = np.asanyarray(column)
    if not column.ndim or column.size != len(column):
        raise UserError(f"{log}: column {key} has shape {column.shape}, one value per row is needed")
    column = column.reshape(len(column))
    if dtype == np.float32:
        return _float32(log, key, column)
    return column if dtype is None or column.dtype == dtype else column.astype(dtype)


def _float32(log: str, key: str, column: np.ndarray) -> np.ndarray:
    if column.dtype == np.float32:
        return column
    with np.errstate(over="ignore"):
        small = column.astype(np.float32)
    if column.dtype.itemsize > 4 and np.isinf(small).any():
        row = int(np.argwhere(np.isinf(small))[0][0])
        raise UserError(f"{log}: column {key} has a number in row {row} that float32 cannot hold; rescale it")
    return small


def flags(log: str, key: str, column: np.ndarray, rows: int | None = None) -> np.ndarray:
    """(rows,) bool of a column of truth values; not a copy of one that has them already.

    Args:
        log: its name, for errors.
        key: of the column, likewise.
        column: with one value per row, true or false or 1 or 0.
        rows: number of values that it must have; None: any.

    Raises:
        UserError: a value is not one of these, or there are more or fewer than `rows`.
    """
    column = _flat(log, key, column, None)
    if rows is not None and len(column) != rows:
        one = ", one per episode" if key in _LAST else ""
        raise UserError(f"{log}: column {key} has {len(column)} values, {rows} are needed{one}")
    if column.dtype != bool:
        wrong = ~np.isin(column, (0, 1))
        if wrong.any():
            row = np.argwhere(wrong)[0][0]
            raise UserError(f"{log}: column {key} has {column[row]} in row {row}, 0 or 1 is needed")
    return _flat(log, key, column, bool)


def _action_column(log: str, column: np.ndarray, space: Box | Discrete | None) -> tuple[np.ndarray, Box | Discrete]:
    integers = column.dtype.kind in "iub" and column.size == len(column)
    if isinstance(space, Discrete) or (space is None and integers):
        broken = column != np.floor(column) if column.dtype.kind == "f" else np.zeros(1, bool)
        if broken.any():
            row = int(np.argwhere(broken)[0][0])
            raise UserError(f"{log}: column actions has {column[row]} in row {row}, an integer is needed")
        column = _flat(log, "actions", column, None)
        n = space.n if space else int(column.max()) + 1
        wrong = (column < 0) | (column >= n)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise UserError(f"{log}: column actions has {int(column[row])} in row {row}, 0 .. {n - 1} is needed")
        if n > MOST_ACTIONS:
            text = f"column actions holds numbers up to {n - 1}, at most {MOST_ACTIONS:,} discrete actions are taken"
            raise UserError(f"{log}: {text}; number those that occur 0, 1, 2, ...")
        return column.astype(np.int32, copy=False), space or Discrete(max(n, 2))
    column = _float32(log, "actions", column.reshape(len(column), -1))
    if space is None:
        low, high = column.min(0).astype(float), column.max(0).astype(float)
        # A dimension that never moves still needs a width, which float32 holds.
        width = (low == high) * np.maximum(1.0, 1e-6 * np.abs(low))
        with naming(log, log):
            space = Box(tuple((low - width).tolist()), tuple((high + width).tolist()))
    if column.shape[1] != space.size:
        raise UserError(f"{log}: actions have {column.shape[1]} dimensions, the bounds have {space.size}")
    return column, space


def bounds_warnings(log: str, actions: np.ndarray, space: Box | Discrete, strict: bool, extra: Mapping[str, Any]) -> list[str]:
    """What to say of actions out of bounds, which are an error where `strict`; `extra` of the provenance names columns."""
    if isinstance(space, Discrete):
        return []
    low, high = np.asarray(space.low, np.float32), np.asarray(space.high, np.float32)
    count, first = 0, -1
    each = np.zeros(space.size, int)
    for start in _blocks(actions):
        part = actions[start : start + BLOCK]
        beyond = (part < low) | (part > high)
        each += beyond.sum(0)
        outside = beyond.any(1)
        if first < 0 and outside.any():
            first = start + int(np.argmax(outside))
        count += int(outside.sum())
    if not count:
        return []
    share = f"{count} of {len(actions)} rows ({100 * count / len(actions):.0f} %)"
    columns = (extra.get("schema") or {}).get("columns", {})
    names = [name for name, column in columns.items() if column["role"] == "action"]
    which = [f"{name} {count:,}" for name, count in zip(names, each.tolist()) if count] if len(names) == space.size else []
    text = f"{share} have actions out of bounds, first row {first}" + (f" ({', '.join(which)})" if which else "")
    if strict:
        raise UserError(f"{log}: {text}; without --strict they are clipped")
    return [f"{text}; methods see them clipped"]


def if_needed(following: np.ndarray, observations: np.ndarray, ends: np.ndarray) -> np.ndarray | None:
    """`following`, or None where the next row says the same: one log has one form, and one fingerprint."""
    return following if (breaks(observations, following) & ~ends[:-1]).any() else None


def breaks(observations: np.ndarray, following: np.ndarray) -> np.ndarray:
    """(rows - 1,) bool: the next row's observation is not this row's next observation."""
    out = np.empty(len(observations) - 1, bool)
    for start in range(0, len(out), BLOCK):
        stop = min(start + BLOCK, len(out))
        differs = observations[start + 1 : stop + 1] != following[start:stop]
        out[start:stop] = differs.reshape(stop - start, -1).any(1)
    return out
