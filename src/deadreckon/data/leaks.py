"""Suspected leaks: columns that hold the reward, the action or the next observation of their row, and rewards that come late.

Columns, and not dimensions, are looked at, in a sample of whole episodes. A suspicion is told where chance gives what was
found with probability `LEVEL` at most, over all columns together (Bonferroni). Honest tables can still have what is told: a
reward that is by definition a state, an action that a rule without chance takes from one column. The lines say so.
"""

import math
from dataclasses import dataclass

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.late import late_reward
from deadreckon.data.spec import Box
from deadreckon.data.told import Told, action_names, columns_of, schema_of

LEVEL = 1e-3  # probability of any false suspicion, where nothing depends on anything
ROWS = 10_000  # in the sample
COLUMNS = 200  # that are looked at
_EXACT, _CLOSE = 1e-5, 1e-3  # of a standard deviation: what float32 leaves of an exact linear relation, usually and at most
_FEW = 64  # rows compared first
_LEAST = 20  # rows below which nothing is said


@dataclass(frozen=True)
class _Sample:
    """Rows of a log: columns (rows,) by name, their actions by name, rewards, and which rows another one follows."""

    columns: dict[str, np.ndarray]
    actions: dict[str, np.ndarray]
    rewards: np.ndarray
    followed: np.ndarray


def leaks(log: Dataset) -> tuple[str, ...]:
    """What looks like a leak in `log`, one line each, with columns and numbers.

    Observations of more than one axis (images) are not looked at, and of many columns the first `COLUMNS`.
    """
    if len(log.spec.observation_shape) > 1 or len(log) < _LEAST:
        return ()
    part = _part(log)
    sample = _sample(part)
    out = [*_copies_of_reward(sample), *_copies_of_action(part, sample), *_leading(sample), *_unmoved(part, sample)]
    late = late_reward(part, LEVEL)
    return tuple([*out, late] if late else out)


def _part(log: Dataset) -> Dataset:
    """Episodes at regular distances with about `ROWS` rows; the log where it is shorter."""
    if len(log) <= ROWS:
        return log
    step = max(1, math.ceil(len(log) / ROWS))
    chosen = np.arange(0, log.episodes, step)
    fitting = chosen[: max(1, int(np.searchsorted(np.cumsum(log.lengths[chosen]), ROWS, side="right")))]
    if log.lengths[fitting].sum() > 10 * ROWS:  # one endless episode: its beginning
        first = {key: np.asarray(log.extras[key][:ROWS]) for key in (LOG_PROBS,) if key in log.extras}
        if log.successors is not None:
            first["next_observations"] = np.asarray(log.successors[:ROWS])
        return Dataset.from_arrays(
            observations=np.asarray(log.observations[:ROWS]), actions=np.asarray(log.actions[:ROWS]),
            rewards=np.asarray(log.rewards[:ROWS]), action_space=log.action_space, name=log.name, provenance=log.provenance,
            strict=False, **first,
        )  # fmt: skip
    return log.select(fitting)


def _sample(log: Dataset) -> _Sample:
    flat = np.asarray(log.observations).reshape(len(log), -1)
    observed = [each for each in columns_of(log) if each.role == "observation" and each.dimensions][:COLUMNS]
    columns = {each.name: _one(each, flat) for each in observed}
    names = action_names(log) if isinstance(log.action_space, Box) else [_action(log)]
    acted = np.asarray(log.actions).reshape(len(log), -1)
    followed = np.ones(len(log), bool)
    followed[log.ends] = False
    return _Sample(columns, {name: acted[:, i] for i, name in enumerate(names)}, np.asarray(log.rewards), followed)


def _action(log: Dataset) -> str:
    schema = schema_of(log)
    return (schema.named("action") or ["the action"])[0] if schema else "the action"


def _one(column: Told, flat: np.ndarray) -> np.ndarray:
    """(rows,) one number a row: of a category the code of its level."""
    if column.kind == "category":
        part = flat[:, list(column.dimensions)]
        return np.where(part.any(1), part.argmax(1), -1).astype(np.float32)
    return flat[:, column.dimensions[0]]


def _copies_of_reward(sample: _Sample) -> list[str]:
    out = []
    for name, values in sample.columns.items():
        how = same(values, sample.rewards, len(sample.columns), ordered=True)
        if how:
            text = f"column {name} may be the reward by another name: {how} in all {len(values):,} rows looked at"
            out.append(f"{text}; unless it is known before the action, leave it out (--ignore)")
    return out


def _copies_of_action(log: Dataset, sample: _Sample) -> list[str]:
    """Columns that are the action. Where the log has the probabilities of its actions, they say how likely chance is."""
    probabilities = log.extras.get(LOG_PROBS)
    out = []
    for name, values in sample.columns.items():
        for action, taken in sample.actions.items():
            how = same(values, taken, len(sample.columns) * len(sample.actions), ordered=isinstance(log.action_space, Box))
            if not how:
                continue
            text = f"column {name} may come after the action: it tells {action}, {how} in all {len(values):,} rows looked at"
            if probabilities is not None and not isinstance(log.action_space, Box):
                chance = float(np.asarray(probabilities, np.float64).sum()) / math.log(10)
                if chance > math.log10(LEVEL / len(sample.columns)):
                    continue  # the policy left nothing to chance: what it acts by may be told by a column
                text += f", which has probability 1e{chance:.0f} by the propensities if it is known before"
                out.append(f"{text}; leave it out (--ignore)")
            else:
                out.append(f"{text}; unless a rule without chance took actions by it, leave it out (--ignore)")
    return out


def same(values: np.ndarray, other: np.ndarray, tests: int, ordered: bool) -> str:
    """How two columns are the same but for names and units, or an empty text.

    They are if an exact line leads from one to the other, or each value of one stands beside one value of the other (for
    `ordered`, rising or falling together), and a random order of rows gives this with probability `LEVEL / tests` at most.

    Args:
        values: (rows,) of a column.
        other: (rows,) to be told by it.
        tests: number of comparisons that are made.
        ordered: whether the order of the values counts.
    """
    few = np.linspace(0, len(values) - 1, min(_FEW, len(values))).astype(int)
    if not _paired(values[few], other[few], ordered):  # spares the sorting of all rows, of nearly all pairs of columns
        return ""
    kinds, counts = np.unique(other, return_counts=True)
    if len(kinds) < 2:
        return ""
    # Of all orders of the rows, n! / prod(counts!) differ, and these give the relation: both directions, or all labellings.
    ways = math.log(2) if ordered else math.lgamma(min(len(kinds), 170) + 1)
    sizes, times = np.unique(counts, return_counts=True)
    within = sum(many * math.lgamma(size + 1) for size, many in zip(sizes.tolist(), times.tolist()))
    arrangements = math.lgamma(len(other) + 1) - within
    if ways - arrangements > math.log(LEVEL / tests):
        return ""
    x, y = values.astype(np.float64), other.astype(np.float64)
    if ordered and x.std() > 0 and y.std() > 0:
        slope = float(((x - x.mean()) * (y - y.mean())).mean() / x.var())
        shift = float(y.mean() - slope * x.mean())
        # Columns are float32: a large offset or a small slope leaves less of an exact relation than numbers around 0 do.
        rounded = float(np.finfo(np.float32).eps) * (abs(slope) * np.abs(x).max() + np.abs(y).max())
        close = min(_EXACT * y.std() + rounded, _CLOSE * y.std())
        if np.abs(y - slope * x - shift).max() <= close:
            if abs(slope - 1) < _EXACT and abs(shift) <= close:
                return "equal to it"
            return f"{slope:.4g} times it" + ("" if abs(shift) <= close else f" {'-' if shift < 0 else '+'} {abs(shift):.4g}")
    return f"one value for each of its {len(kinds):,} values" if _paired(values, other, ordered) else ""


def _paired(values: np.ndarray, other: np.ndarray, ordered: bool) -> bool:
    """Whether each value of one column stands beside one value of the other, rising or falling together if `ordered`."""
    kinds, codes = np.unique(other, return_inverse=True)
    of, own = np.unique(values, return_inverse=True)
    if len(of) != len(kinds):
        return False
    pairs = np.zeros(len(of), int)
    pairs[own] = codes
    if (pairs[own] != codes).any() or len(np.unique(pairs)) != len(kinds):
        return False
    return not ordered or bool((np.diff(pairs) > 0).all() or (np.diff(pairs) < 0).all())


def _leading(sample: _Sample) -> list[str]:
    """Columns that hold the next row's value of another one. A column of earlier values is told apart by the first rows."""
    now = np.flatnonzero(sample.followed)
    first = np.append(True, ~sample.followed[:-1])
    out = []
    if len(now) < _LEAST:
        return out
    names = list(sample.columns)
    # Columns that agree on a few rows are compared on all, so that many columns take little time.
    few = now[np.linspace(0, len(now) - 1, min(_FEW, len(now))).astype(int)]
    table = np.stack([sample.columns[name] for name in names], 1)
    pairs = np.argwhere((table[few][:, :, None] == table[few + 1][:, None, :]).all(0))
    for i, j in pairs.tolist():
        ahead, behind = table[:, i], table[:, j]
        if i == j or (ahead[now] != behind[now + 1]).any():
            continue
        changes = now[behind[now + 1] != behind[now]]  # a value that stays says nothing of time
        shares = np.unique(behind[changes + 1], return_counts=True)[1] / max(len(changes), 1)
        if len(changes) * math.log(max(float((shares**2).sum()), 1e-300)) > math.log(LEVEL / len(names) ** 2):
            continue
        start = behind[first]
        if len(np.unique(start)) < 2 or (start == ahead[first]).all():
            continue  # `behind` is filled up at first rows: it holds earlier values of `ahead`, which is no leak
        text = f"column {names[i]} equals the next row's {names[j]} in all {len(now):,} rows that another one follows"
        out.append(f"{text}; unless {names[j]} is the earlier value of {names[i]}, leave {names[i]} out (--ignore)")
    return out


def _unmoved(log: Dataset, sample: _Sample) -> list[str]:
    """Next observations that are copies of the observations, in transitions that should move."""
    schema = schema_of(log)
    by = {column.of: column.name for column in schema.having("next_observation")} if schema else {}
    if not by and log.successors is None:
        return []
    rows = np.flatnonzero(log.usable & ~np.asarray(log.terminals))
    if len(rows) < _LEAST:
        return []
    here = np.asarray(log.observations)[rows].reshape(len(rows), -1)
    there = log.next_observations_at(rows).reshape(len(rows), -1)
    moving = (here != here[0]).any(0)
    share = float((here == there).all(1).mean())
    # So many rows would all stand still with probability LEVEL at most if one in twenty moved.
    if not moving.any() or share < 1 or len(rows) * math.log(0.95) > math.log(LEVEL):
        return _unmoved_columns(log, sample, by)
    text = f"the next observation equals the observation in all {len(rows):,} rows looked at"
    which = f" ({', '.join(list(by.values())[:8])})" if by else ""
    return [f"{text}{which}: transitions never move, as if the same columns had been stored twice"]


def _unmoved_columns(log: Dataset, sample: _Sample, by: dict[str | None, str]) -> list[str]:
    """Single next observations that repeat their observation although the following row has another value."""
    rows = np.flatnonzero(sample.followed & log.usable)
    if len(rows) < _LEAST:
        return []
    flat = np.asarray(log.observations).reshape(len(log), -1)
    there = log.next_observations_at(rows).reshape(len(rows), -1)
    out = []
    for each in columns_of(log):
        if each.role != "observation" or not each.dimensions:
            continue
        at = list(each.dimensions)
        moves = (flat[rows][:, at] != flat[rows + 1][:, at]).any(1)
        if moves.sum() * math.log(0.95) < math.log(LEVEL) and (there[:, at] == flat[rows][:, at])[moves].all():
            name = by.get(each.name, f"the next {each.name}")
            text = f"{name} equals {each.name} of its own row in all {int(moves.sum()):,} rows whose following row differs"
            out.append(f"{text}: the column seems to be a copy, and not the next value")
    return out
