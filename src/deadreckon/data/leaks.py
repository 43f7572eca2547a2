"""Suspected leaks: columns that hold the reward, the action or the next observation of their row, and late rewards.

Columns are checked where they are known, in a sample of whole episodes. A suspicion is reported if chance explains the finding
with a probability of at most `LEVEL`, over all columns together (Bonferroni). Correct tables can still have such findings: a
reward that is by definition a state, or an action that a deterministic rule takes from one column. The lines say so.
"""

import math
from dataclasses import dataclass

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.late import late_reward, rewards_to_come
from deadreckon.data.relations import FEW, LEAST, relation
from deadreckon.data.spec import Box
from deadreckon.data.told import Told, action_names, columns_of, schema_of

LEVEL = 1e-3  # probability of any false suspicion, where nothing depends on anything
ROWS = 10_000  # in the sample
COLUMNS = 200  # that are looked at
EPISODES = 50  # least number of those whose outcomes are looked at
# Least share of the last rewards that an outcome explains, and how much of that share it may explain of the rewards before.
OUTCOME, EARLIER = 0.5, 0.2
ALONE = 0.9  # least share where there are no earlier rewards to tell an outcome from what was known at the start
_FILLS = (-1.0, 0.0)  # what stands for the earlier value where there is none


@dataclass(frozen=True)
class _Sample:
    """Rows of a log: columns by name and where they are known, actions by name, rewards, and which rows another one follows."""

    columns: dict[str, np.ndarray]
    known: dict[str, np.ndarray]
    actions: dict[str, np.ndarray]
    rewards: np.ndarray
    followed: np.ndarray


def leaks(log: Dataset) -> tuple[str, ...]:
    """Possible leaks in `log`, one line each, with columns and numbers.

    Observations with more than one axis (images) are not checked, and of many columns only the first `COLUMNS`.
    """
    if len(log.spec.observation_shape) > 1 or len(log) < LEAST:
        return ()
    part = _part(log)
    sample = _sample(part)
    out = [*_copies_of_reward(sample), *_copies_of_action(part, sample), *_leading(sample), *_unmoved(part, sample)]
    out += _outcomes(part, sample)
    return tuple([*out, *filter(None, (late_reward(part, LEVEL), rewards_to_come(log, LEVEL)))])


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
    known = {each.name: _known(each, flat) for each in observed}
    names = action_names(log) if isinstance(log.action_space, Box) else [_action(log)]
    acted = np.asarray(log.actions).reshape(len(log), -1)
    followed = np.ones(len(log), bool)
    followed[log.ends] = False
    return _Sample(columns, known, {name: acted[:, i] for i, name in enumerate(names)}, np.asarray(log.rewards), followed)


def _action(log: Dataset) -> str:
    schema = schema_of(log)
    return (schema.named("action") or ["the action"])[0] if schema else "the action"


def _one(column: Told, flat: np.ndarray) -> np.ndarray:
    """(rows,) one number a row: of a category the code of its level."""
    if column.kind == "category":
        part = flat[:, list(column.dimensions)]
        return np.where(part.any(1), part.argmax(1), -1).astype(np.float32)
    return flat[:, column.dimensions[0]]


def _known(column: Told, flat: np.ndarray) -> np.ndarray:
    """(rows,) bool, where the column has a value of its own."""
    return flat[:, column.dimensions[-1]] == 0 if column.marked else np.ones(len(flat), bool)


def _copies_of_reward(sample: _Sample) -> list[str]:
    out = []
    for name, values in sample.columns.items():
        known = sample.known[name]
        how = relation(values[known], sample.rewards[known], LEVEL / len(sample.columns), ordered=True)
        if how:
            text = f"column {name} may be the reward by another name: {how} in all {_rows(known)}"
            out.append(f"{text}; unless it is known before the action, leave it out (--ignore)")
    return out


def _copies_of_action(log: Dataset, sample: _Sample) -> list[str]:
    """Columns that are the action. Where the log has the probabilities of its actions, they say how likely chance is."""
    probabilities = log.extras.get(LOG_PROBS)
    out = []
    for name, values in sample.columns.items():
        for action, taken in sample.actions.items():
            level, known = LEVEL / (len(sample.columns) * len(sample.actions)), sample.known[name]
            how = relation(values[known], taken[known], level, ordered=isinstance(log.action_space, Box))
            if not how:
                continue
            text = f"column {name} may come after the action: it tells {action}, {how} in all {_rows(known)}"
            if probabilities is not None and not isinstance(log.action_space, Box):
                chance = float(np.asarray(probabilities, np.float64)[known].sum()) / math.log(10)
                if chance > math.log10(LEVEL / len(sample.columns)):
                    continue  # the policy left nothing to chance: what it acts by may be told by a column
                text += f", which has probability 1e{chance:.0f} by the propensities if it is known before"
                out.append(f"{text}; leave it out (--ignore)")
            else:
                out.append(f"{text}; unless a deterministic rule chose the actions by it, leave it out (--ignore)")
    return out


def _outcomes(log: Dataset, sample: _Sample) -> list[str]:
    """Columns with one value in all rows of each episode that tell its last reward, and none of the earlier ones."""
    starts, ends = log.starts[log.lengths > 1], log.ends[log.lengths > 1]
    if len(starts) < EPISODES:
        return []
    last, before = sample.rewards[ends].astype(np.float64), log.returns(1.0)[log.lengths > 1] - sample.rewards[ends]
    out = []
    for name, values in sample.columns.items():
        same = np.maximum.reduceat(values, log.starts) == np.minimum.reduceat(values, log.starts)
        if not same.all():
            continue
        part = _levels(values[starts])
        least = OUTCOME if np.ptp(before) > 0 else ALONE
        if part.max() == 0 or (told := _explained(part, last)) < least or _explained(part, before) > told * EARLIER:
            continue
        text = f"column {name} may be the outcome of its episode: it is the same in all rows, and explains {told:.0%} of the "
        out.append(f"{text}last reward and hardly any before; unless it is known at the start, leave it out (--ignore)")
    return out


def _levels(values: np.ndarray) -> np.ndarray:
    """(n,) the level of each value, or its quarter where there are more than four."""
    levels, part = np.unique(values, return_inverse=True)
    if len(levels) > 4:
        part = np.searchsorted(np.quantile(values, [0.25, 0.5, 0.75]), values, side="right")
    return np.unique(part, return_inverse=True)[1]


def _explained(part: np.ndarray, target: np.ndarray) -> float:
    """Adjusted R2 of the means of the parts."""
    count, parts = len(target), int(part.max()) + 1
    means = np.bincount(part, target) / np.bincount(part)
    total, left = np.square(target - target.mean()).sum(), np.square(target - means[part]).sum()
    return 0.0 if not total > 0 else float(1.0 - (left / max(count - parts, 1)) / (total / (count - 1)))


def _rows(known: np.ndarray) -> str:
    """The rows that were compared, in words."""
    return f"{int(known.sum()):,} rows looked at" + ("" if known.all() else " where it is known")


def _leading(sample: _Sample) -> list[str]:
    """Columns that hold the next row's value of another one. A column of earlier values is told apart by the first rows."""
    now = np.flatnonzero(sample.followed)
    first = np.append(True, ~sample.followed[:-1])
    out = []
    if len(now) < LEAST:
        return out
    names = list(sample.columns)
    # Columns that agree on a few rows are compared on all, so that many columns take little time.
    few = now[np.linspace(0, len(now) - 1, min(FEW, len(now))).astype(int)]
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
        start = behind[first & sample.known[names[j]]]
        filled = len(start) == 0 or (len(np.unique(start)) < 2 and start[0] in _FILLS)
        # A column of later values, and no column of earlier ones, is empty in last rows and nowhere else.
        ends_empty = (sample.known[names[i]] == sample.followed).all() and not sample.followed.all()
        if (filled and not ends_empty) or (behind[first] == ahead[first]).all():
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
    if len(rows) < LEAST:
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
    if len(rows) < LEAST:
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
