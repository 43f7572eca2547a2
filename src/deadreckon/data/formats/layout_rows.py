"""Ordering of the rows of other libraries' buffers: ring buffers, parallel environments, rows that are only observations."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deadreckon.data.formats.flatten import one_hot
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError


@dataclass
class Parts:
    """The columns of a log while they are put into order.

    Attributes:
        arrays: {name: (rows, ...)} numbers, and arrays of other lengths.
        other: other values: single numbers, texts, dicts of fields.
        told: messages, one line each.
        space: of the actions, if the source has it.
        names: of the observation's dimensions, if they are made here.
        last: (pieces, ...) what was observed after the last row of each piece, in columns without next observations.
    """

    arrays: dict[str, np.ndarray]
    other: dict[str, Any] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)
    space: Box | Discrete | None = None
    names: list[str] | None = None
    last: np.ndarray | None = None

    def under(self, name: str) -> list[str]:
        """The columns called `name`, or those in the dict `name`."""
        return [key for key in self.arrays if key == name or key.startswith(f"{name}/")]

    def number(self, *names: str) -> int | None:
        """The whole number under the first of `names` with a single value, or None; other single values are refused."""
        for name in names:
            value = self.other.get(name)
            if value is not None and np.ndim(value) == 0:
                if np.asarray(value).dtype.kind not in "iubf" or not float(value).is_integer():
                    raise UserError(f"{name} must be a whole number, got {value!r}")
                return int(value)
        return None

    def take(self, index: Any, rows: int) -> None:
        """Keeps only the rows `index`, in that order, of the columns with `rows` rows; other columns are removed."""
        self.arrays = {key: column[index] for key, column in self.arrays.items() if column.ndim and len(column) == rows}


def has(names: Iterable[str], name: str) -> bool:
    """Whether there is a column `name`, or a dict of columns of that name."""
    return name in names or any(key.startswith(f"{name}/") for key in names)


def d3rlpy_episodes(parts: Parts) -> None:
    """Joins `observations_0`, `actions_0`, `terminated_0`, ... of all episodes."""
    count = parts.number("num_episodes") or 0
    columns: dict[str, list[np.ndarray]] = {}
    for episode in range(count):
        for key in ("observations", "actions", "rewards"):
            names = [name for name in (f"{key}_{episode}",) if name in parts.arrays]
            while not names or names[-1] != f"{key}_{episode}":  # or arrays of its parts, counted from 0
                following = f"{key}_{episode}_{len(names)}"
                if following not in parts.arrays:
                    break
                names.append(following)
            if not names:
                raise UserError(f"no column {key}_{episode}, but num_episodes is {count}")
            for number, name in enumerate(names):
                place = key if len(names) == 1 else f"{key}/{number}"
                columns.setdefault(place, []).append(parts.arrays[name])
        ended = parts.other.get(f"terminated_{episode}")
        if ended is None:
            raise UserError(f"no column terminated_{episode}: it is not known whether episode {episode} ended by termination")
        steps = len(columns["actions"][-1])
        last = np.arange(steps) == steps - 1
        columns.setdefault("done", []).append(last)
        columns.setdefault("terminated", []).append(last & bool(ended))
    for key, values in columns.items():
        if len(values) != count or len({value.shape[1:] for value in values}) > 1:
            raise UserError(f"{key} have different shapes in different episodes")
    parts.arrays = {key: np.concatenate(values) for key, values in columns.items()}


def sb3(parts: Parts) -> None:
    """Unstacks parallel environments: (steps, environments, ...) becomes one environment's rows after the other's."""
    for key in [key for key in parts.arrays if key.startswith(("observation_space", "action_space"))]:
        parts.other[key] = parts.arrays.pop(key)
    parts.space = _space(parts.other)
    count, start = parts.number("observation_space/n"), parts.number("observation_space/start") or 0
    rewards = parts.arrays["rewards"]
    if rewards.ndim == 1:
        rewards = rewards[:, None]
        parts.arrays = {key: column[:, None] for key, column in parts.arrays.items() if column.ndim}
    steps, environments = rewards.shape[:2]
    position, full = parts.number("pos"), parts.number("full")
    if position is None and _empty(parts, steps):
        raise UserError(
            "the last rows are all zeros, as rows that a replay buffer has not filled yet are: "
            "give `pos` and `full` of the buffer beside its columns, or cut those rows off"
        )
    order = np.arange(steps)
    if position is not None:
        order = np.roll(order, -position) if full else order[:position]
    if not len(order):
        raise UserError("the replay buffer is empty (pos is 0 and full is not set)")
    if position is not None and "observations" in parts.arrays and not parts.under("next_observations"):
        order = _without_overwritten(parts, order, position, full=bool(full))
    stacked = {key: column for key, column in parts.arrays.items() if column.shape[:2] == (steps, environments)}
    for key in ("observations", "next_observations", "actions", "dones", "timeouts"):
        if key in parts.arrays and key not in stacked:
            raise UserError(
                f"column {key} has shape {parts.arrays[key].shape}, rewards have {rewards.shape}; both are (steps, "
                f"environments, ...) in a replay buffer; rewards of shape ({steps},) leave the environments out"
            )
    parts.arrays = {
        key: np.swapaxes(column[order], 0, 1).reshape(environments * len(order), *column.shape[2:])
        for key, column in stacked.items()
    }
    for key in ("observations", "next_observations"):
        if count is not None and key in parts.arrays:
            parts.arrays[key], parts.names = one_hot(parts.arrays[key].reshape(-1), count, start, "observation")
    if count is not None and parts.last is not None:
        parts.last = one_hot(parts.last.reshape(-1), count, start, "observation")[0]
    parts.arrays["cut"] = np.arange(environments * len(order)) % len(order) == len(order) - 1
    if environments > 1:
        parts.told.append(f"rows of {environments} parallel environments are put one environment after the other")
    if parts.arrays["dones"].any() and not parts.arrays["timeouts"].any():
        parts.told.append(
            "no row is a timeout: if the buffer was made with handle_timeout_termination=False, time limits are read as "
            "terminations"
        )


def _without_overwritten(parts: Parts, order: np.ndarray, position: int, full: bool) -> np.ndarray:
    """`order` without the oldest row of a full buffer of `optimize_memory_usage`, which keeps no next observations.

    Such a buffer writes what follows the newest row where the next row will begin, in a full one over the observation of the
    oldest row, whose action and reward stay. `parts.last` becomes that observation if the buffer itself says how it was made.
    """
    steps = len(parts.arrays["observations"])
    if parts.number("optimize_memory_usage") and (full or position < steps):
        parts.last = parts.arrays["observations"][position % steps]
    if not full or parts.number("optimize_memory_usage") == 0:
        return order
    parts.told.append("the oldest step is left out: without next observations, the newest one is written over its observation")
    return order[1:]


def tianshou(parts: Parts) -> None:
    """Puts the ring buffers into the order of time, without the rows that are not filled."""
    masks(parts, "obs", "obs_next")
    rows = len(parts.arrays["rew"])
    size, index = parts.number("_size"), parts.number("_insertion_idx", "_index")
    offsets, lengths, last = (parts.arrays.get(key) for key in ("_offset", "_lengths", "last_index"))
    if offsets is not None and lengths is not None and last is not None:  # a buffer of several environments
        stops = np.append(offsets[1:], rows)
        rings = [
            _ring(int(start), int(length), int(stop - start), int(at) + 1 - int(start))
            for start, stop, length, at in zip(offsets, stops, lengths, last)
        ]
    elif size is not None and index is not None:
        rings = [_ring(0, size, rows, index)]
    else:
        rings = [np.arange(rows)]
    order = np.concatenate(rings)
    if not len(order):
        raise UserError("the buffer is empty")
    for key in [key for key in parts.arrays if key.startswith("_") or key in ("last_index", "buffers")]:
        del parts.arrays[key]  # a property of the buffer, not of its rows
    parts.take(order, rows)
    parts.arrays["cut"] = np.zeros(len(order), bool)
    parts.arrays["cut"][np.cumsum([len(ring) for ring in rings if len(ring)]) - 1] = True


def _ring(start: int, length: int, size: int, following: int) -> np.ndarray:
    """The filled rows of a ring buffer of `size` rows from row `start` on, oldest first; `following` is written next."""
    return start + (np.arange(length) + (following if length == size else 0)) % size


def masks(parts: Parts, now: str, after: str) -> None:
    """Moves the masks of legal actions out of the observations `now` and the next observations `after`."""
    for where, role in ((now, "legal"), (after, "next_legal")):
        for key in (f"{where}/mask", f"{where}/action_mask"):
            if key in parts.arrays:
                parts.arrays[role] = parts.arrays.pop(key)


def torchrl(parts: Parts) -> None:
    """Flattens batches (batch, time, ...) without their padding; recognises one-hot actions, and zeros for observations."""
    rewards = parts.arrays["next/reward"]
    batched = rewards.ndim > 2 or (rewards.ndim == 2 and rewards.shape[1] != 1)
    if batched:
        size, steps = rewards.shape[:2]
        kept = parts.arrays.pop("collector/mask", parts.arrays.pop("mask", np.ones((size, steps), bool)))
        kept = kept.astype(bool).reshape(size, steps)
        last = np.zeros((size, steps), bool)
        filled = kept.any(1)
        last[filled, (steps - 1 - kept[:, ::-1].argmax(1))[filled]] = True
        together = {key: column for key, column in parts.arrays.items() if column.shape[:2] == (size, steps)}
        parts.arrays = {key: column[kept] for key, column in together.items()}
        parts.arrays["cut"] = last[kept]
    for key in ("done", "terminated", "truncated"):
        parts.arrays.pop(key, None)  # of the state before the step
    action = parts.arrays["action"]
    whole = action.ndim == 2 and action.shape[1] > 1 and action.dtype.kind in "iub"
    if whole and (np.isin(action, (0, 1)).all(1) & (action.sum(1) == 1)).all():
        parts.arrays["action"] = action.argmax(1)
        parts.space = Discrete(action.shape[1])
        parts.told.append(f"actions are one-hot, and are read as {action.shape[1]} discrete actions")
    following = next((parts.arrays[key] for key in ("next/observation", "next/pixels") if key in parts.arrays), None)
    ends = _any(parts, "next/done", "next/truncated", "next/terminated")
    if following is not None and ends is not None and ends.any() and not following[ends].any():
        parts.arrays["unknown"] = ends
        parts.told.append("next observations of last rows are all zeros, as in TorchRL's data sets, and count as unknown")


def _any(parts: Parts, *names: str) -> np.ndarray | None:
    there = [parts.arrays[name].reshape(-1) != 0 for name in names if name in parts.arrays]
    return np.logical_or.reduce(there) if there else None


def ogbench(parts: Parts) -> None:
    """Leaves out rows that are only a next observation (`valids` 0); checks that `masks` are no end flags."""
    rows = len(parts.arrays["actions"])
    ends = parts.arrays["terminals"].reshape(-1) != 0
    if "masks" not in parts.arrays:
        raise UserError(
            "no column masks: OGBench's terminals end trajectories and do not say whether the task ended; masks do, 1 while "
            "it has not (all 1 where it never ends)"
        )
    masks = parts.arrays["masks"].reshape(-1) != 0
    if ends.any() and not ends.all() and (masks == ends).all():
        raise UserError(
            "masks and terminals contradict each other: masks are 1 exactly where trajectories end, and should be 1 while the "
            "task has not ended"
        )
    if "valids" in parts.arrays:
        valid = parts.arrays.pop("valids").reshape(-1) != 0
        # Terminals are 1 in the last two rows of a trajectory, of which the second is not valid.
        wrong = np.where(valid, np.append(ends[:-1] == valid[1:], True), ~ends)
        if wrong.any():
            raise UserError(
                f"valids and terminals contradict each other in row {int(np.argmax(wrong))}: the last row of each trajectory, "
                "and no other, should have valids 0, and it and the row before it terminals 1"
            )
        _follow(parts, "observations", "next_observations", rows)
        parts.take(valid, rows)
    elif not parts.under("next_observations"):
        parts.told.append("neither valids nor next_observations: next observations of last rows are not known")


def steps(parts: Parts) -> None:
    """Leaves out the last row of each episode, which is only the last observation."""
    rows = len(parts.arrays["action"])
    kinds = parts.arrays.get("step_type")
    last = _flags(parts, "is_last") if kinds is None else kinds.reshape(-1) == 2
    first = parts.arrays.get("is_first") if kinds is None else kinds.reshape(-1) == 0
    if first is not None:
        wrong = (np.asarray(first).reshape(-1) != 0)[1:] != last[:-1]
        if wrong.any():
            row = int(np.argmax(wrong)) + 1
            raise UserError(f"row {row} contradicts the row before it: after a last step, and nowhere else, comes a first one")
    open_end = not last[-1]
    last[-1] = True
    if kinds is None and "is_terminal" in parts.arrays:
        ended = _flags(parts, "is_terminal")
        if (ended & ~last).any():
            raise UserError(f"is_terminal in row {int(np.argmax(ended & ~last))}, which is not a last step (is_last)")
        parts.arrays["terminated"] = np.append(ended[1:], False)
        parts.arrays.pop("discount", None)  # redundant, or 1 throughout
    elif "discount" not in parts.arrays:
        raise UserError("neither is_terminal nor discount: it is not known whether the task ended")
    parts.arrays["cut"] = np.append(last[1:], False)
    _follow(parts, "observation", "next_observation", rows)
    for key in ("is_last", "is_first", "is_terminal", "step_type"):
        parts.arrays.pop(key, None)
    if last.all():
        raise UserError("all rows are last steps, so none holds an action")
    parts.take(~last, rows)
    if open_end:
        parts.told.append("the last row of all is no last step; it is read as the last observation of a recording cut short")


def _flags(parts: Parts, name: str) -> np.ndarray:
    return parts.arrays[name].reshape(-1) != 0


def _follow(parts: Parts, name: str, following: str, rows: int) -> None:
    """Adds next observations, from the rows below; that of the last row is its own observation."""
    if parts.under(following):
        return
    below = np.minimum(np.arange(rows) + 1, rows - 1)
    for key in parts.under(name):
        parts.arrays[following + key.removeprefix(name)] = parts.arrays[key][below]


def rounds(parts: Parts) -> None:
    """Each round is one terminal step."""
    actions = parts.number("n_actions")
    parts.space = None if actions is None else Discrete(actions)
    parts.arrays["terminated"] = np.ones(len(parts.arrays["action"]), bool)
    if "position" in parts.arrays:
        parts.told.append("position is kept as an extra and is no observation")


def _empty(parts: Parts, steps: int) -> bool:
    """Whether the last row is all zeros in every column, and some row is not."""
    columns = [column for column in parts.arrays.values() if column.ndim > 1 and len(column) == steps]
    return any(column.any() for column in columns) and not any(column[-1].any() for column in columns)


def _space(fields: dict[str, Any]) -> Box | Discrete | None:
    """The action space of a pickled buffer."""
    low, high, n = (fields.get(f"action_space/{key}") for key in ("low", "high", "n"))
    if low is not None and high is not None and np.isfinite(low).all() and np.isfinite(high).all():
        return Box(tuple(np.ravel(low).tolist()), tuple(np.ravel(high).tolist()))
    return Discrete(int(n)) if n is not None and np.ndim(n) == 0 and not fields.get("action_space/start") else None
