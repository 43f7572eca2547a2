"""Whether the log supports estimates by ratios of occupancies (`drl`) and by what follows each row.

They take rows with the same observation for the same state. Then the critics' errors r + discount V(s') - Q(s, a) have mean
zero given all that came before. Three kinds of errors that bias a gain are tested for: those that depend on the previous
action, or on how often an action was taken before, beyond the step of the episode, and those that depend on the step where
actions do so too, so that the step is a confounder. Errors that depend on the step alone, as where all episodes end at one,
bias both values alike.

Rows whose successor is not known are left out. That is a bias if their rewards differ from others of the same observation and
action, as those of episodes that ended without a terminal, or if an action makes such ends more frequent.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from deadreckon.data.told import action_names
from deadreckon.ope.basis import UNITS
from deadreckon.ope.case import OPEInput
from deadreckon.ope.features import Table
from deadreckon.ope.parts import ROWS, apart, frequent, means_of, parts_of
from deadreckon.ope.sequences import times
from deadreckon.stats.interval import p_in_words

LEVEL = 0.001  # error probability of all tests of one kind together (Bonferroni)
WEAK = 0.05  # correlation below which a dependence is too weak to matter, however many rows show it
TOO = 0.01  # error probability of the test that actions depend on the step, too, where errors do
EVENTS = 10  # least number of ends that are compared
USUAL = 0.2  # share of the ends at the last step from which on it is the length of a recording
OFTEN = 1.2  # how many times as many ends there are after an action as expected, at least
ACTIONS = 5  # most frequent actions that are looked at
INSTEAD = "with logged propensities, dr-linear (--estimators dr-linear) needs no such column"


class _Rows(NamedTuple):
    """What the tests look at: (rows,) each.

    Attributes:
        unit: cluster of the episode.
        step: of the episode.
        before: the previous action, -1 in the first row of an episode.
        cell: number of the observation among those of the log.
        taken: the action.
    """

    unit: np.ndarray
    step: np.ndarray
    before: np.ndarray
    cell: np.ndarray
    taken: np.ndarray

    @classmethod
    def of(cls, case: OPEInput) -> "_Rows | None":
        """None if observations take many values, actions are continuous, or all episodes have one step. Made once."""
        return case.once("rows of markov", lambda: cls._made(case))

    @classmethod
    def _made(cls, case: OPEInput) -> "_Rows | None":
        data, size = case.data, case.plain.spec.observation_size  # positions stand before observations
        table = Table.of(case.plain) if case.positions else case.table
        if table is None or data.lengths.max() == 1:
            return None
        taken = np.asarray(data.actions)
        before = np.append(-1, taken[:-1])
        before[data.starts] = -1
        return cls(case.cluster[data.episode_of], times(data.lengths), before, table.codes(data.observations[:, -size:]), taken)


def hidden_state(case: OPEInput, errors: np.ndarray) -> str | None:
    """Why observations do not hold all that matters, as a phrase; None if no test shows that.

    Args:
        case: log and policies.
        errors: (policies, rows) of the critics, out of fold; see `critics.OutOfFold`. Those of the behaviour policy are not
            looked at: they depend on what came before also where only its actions do.
    """
    rows = _Rows.of(case)
    if rows is None or int(case.cluster.max()) + 1 < UNITS or not np.isfinite(errors).all():
        return None
    tests = (
        (_after_action, "the previous action", "add the previous action as a column"),
        (_after_actions, "earlier actions", "add how often each action was taken before in the episode as columns"),
        (_at_step, "the step of the episode", "add the step as a column"),
    )
    for test, name, advice in tests:
        if (p_value := min(test(case, rows, errors[: len(case.policies)]), default=1.0)) < LEVEL:
            return (
                f"what follows an observation and an action depends on {name} ({p_in_words(p_value)}), so observations do not "
                f"hold all that matters: {advice}; {INSTEAD}"
            )
    return None


def _after_action(case: OPEInput, rows: _Rows, errors: np.ndarray) -> Iterator[float]:
    """p-values, corrected for their number, of each policy's errors that do not depend on the previous action, of all rows and
    of those with each action."""
    known = case.followed & (rows.before >= 0)
    groups = [known, *(known & (rows.taken == action) for action in frequent(rows.taken, ACTIONS, ROWS))]
    # Less their means at each step with the same observation and action, which are not zero where all episodes end at a step.
    place = _places(rows, known)
    for own in errors:
        beyond = np.zeros(len(own))
        beyond[known] = own[known] - means_of(place, own[known])
        for group in groups:
            yield len(errors) * len(groups) * _depends(beyond, rows.before, rows.unit, group)


def _after_actions(case: OPEInput, rows: _Rows, errors: np.ndarray) -> Iterator[float]:
    """p-values, corrected for their number, of each policy's errors that do not go with how often an action was taken earlier
    in the episode, beyond its mean at that step."""
    known = case.followed & (rows.before >= 0)
    actions = frequent(rows.taken, ACTIONS, ROWS)
    actions = actions[:1] if len(actions) == 2 else actions  # the other one is its opposite
    place = _places(rows, known)
    for action in actions:
        count = np.cumsum(rows.taken == action)
        earlier = count - (rows.taken == action)
        earlier = (earlier - np.repeat(earlier[case.data.starts], case.data.lengths))[known].astype(np.float64)
        earlier -= means_of(rows.step[known], earlier)
        for own in errors:
            p_value, strength = _correlated(own[known] - means_of(place, own[known]), earlier, rows.unit[known])
            yield len(errors) * len(actions) * p_value if abs(strength) >= WEAK else 1.0


def _places(rows: _Rows, known: np.ndarray) -> np.ndarray:
    """(known,) number of the step, observation and action of these rows, at which errors may have any mean."""
    place = (rows.cell * (int(rows.taken.max()) + 1) + rows.taken) * (int(rows.step.max()) + 1) + rows.step
    return np.unique(place[known], return_inverse=True)[1]


def _at_step(case: OPEInput, rows: _Rows, errors: np.ndarray) -> Iterator[float]:
    """p-values, corrected for their number, of each policy's errors that do not depend on the step, of all observations and in
    parts of them, where actions go with how errors depend on it."""
    actions = frequent(rows.taken, ACTIONS, ROWS)
    actions = actions[:1] if len(actions) == 2 else actions  # the other one is its opposite
    part = parts_of(rows.cell, int(rows.unit.max()) + 1)
    parts = [] if part is None else [case.followed & (part == each) for each in range(int(part.max()) + 1)]
    groups, chances = [case.followed, *parts], {action: means_of(rows.cell, rows.taken == action) for action in actions}
    for own, group in itertools.product(errors, groups):
        p_value = _depends(own, rows.step, rows.unit, group)
        if p_value >= LEVEL:
            continue
        means = _of_others(rows.step[group], own[group], rows.unit[group])
        for action in actions:
            taken = rows.taken == action
            chance = chances[action][group]
            # Where all of few rows lack a rare action, their scatter says nothing, and its frequency does.
            least = float((np.square(means) * chance * (1.0 - chance)).sum())
            p_too, _ = _correlated(means, taken[group] - chance, rows.unit[group], least)
            if p_too * len(groups) * len(actions) < TOO:
                yield len(errors) * len(groups) * p_value


def _of_others(part: np.ndarray, values: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(rows,) mean of the values in the part of each row, in the other half of the units: else a row's own would count."""
    out, even = np.zeros(len(values)), unit % 2 == 0
    for own, others in ((even, ~even), (~even, even)):
        count = np.bincount(part[others], minlength=int(part.max()) + 1)
        out[own] = (np.bincount(part[others], values[others], len(count)) / np.maximum(count, 1))[part[own]]
    return out


def _depends(errors: np.ndarray, column: np.ndarray, unit: np.ndarray, group: np.ndarray) -> float:
    """The p-value of errors of mean zero in all parts of a column, of a group (rows,) of rows; 1 if they hardly depend."""
    if not group.any():
        return 1.0
    own, unit = errors[group], np.unique(unit[group], return_inverse=True)[1]
    part = parts_of(column[group], int(unit.max()) + 1)
    p_value, strength = apart(own, np.zeros(len(own)), own.var(), part, unit)
    return p_value if strength >= WEAK else 1.0


def _correlated(a: np.ndarray, b: np.ndarray, unit: np.ndarray, least: float = 0.0) -> tuple[float, float]:
    """The two-sided p-value of (rows,) lists whose product has mean zero, with independent units; and their correlation. The
    sum of the products has the variance `least` or more."""
    sums = np.bincount(np.unique(unit, return_inverse=True)[1], a * b)
    if len(sums) < 2:
        return 1.0, 0.0
    error = np.sqrt(max(float(sums.var(ddof=1)) * len(sums), least))
    size = np.sqrt(np.square(a).sum() * np.square(b).sum())
    if not (error > 0 and size > 0):
        return 1.0, 0.0
    return float(2 * stdtr(len(sums) - 1, -abs(sums.sum()) / error)), float(sums.sum() / size)


def left_out(case: OPEInput) -> str | None:
    """Why rows without a known successor must not be left out, as a phrase; None if no test shows that."""
    lost, rows = ~case.followed, _Rows.of(case)
    if rows is None or not EVENTS <= lost.sum() <= len(lost) - ROWS:
        return None
    remedy = "if episodes end there, name the column that says so (--terminal)"
    remedy += ", or give a horizon (--horizon)" if case.estimand.horizon is None else ""
    rewards = np.asarray(case.data.rewards, np.float64)
    # Both less their means in rows with the same observation and action, so that errors of these means cancel.
    pair = rows.cell * (int(rows.taken.max()) + 1) + rows.taken
    share = means_of(pair, lost)
    p_value, strength = _correlated(rewards - means_of(pair, rewards), lost - share, rows.unit)
    if case.estimand.horizon is None and lost.sum() >= ROWS and p_value < LEVEL and abs(strength) >= WEAK:
        both = (share > 0) & (share < 1)
        kept = np.bincount(pair, rewards * ~lost) / np.maximum(np.bincount(pair, ~lost), 1)
        return (
            f"the last rows of {lost.sum():,} episodes, whose next observations are not known, are left out, and their rewards "
            f"differ from those of other rows with the same observation and action (mean {rewards[both & lost].mean():.4g}, "
            f"others {kept[pair[both & lost]].mean():.4g}; {p_in_words(p_value)}): {remedy}"
        )
    # Ends of the longest episodes, if these are many, are at the length of a recording, and say nothing of actions.
    longest = int(rows.step[lost].max())
    open_ = rows.step < longest if (rows.step[lost] == longest).mean() > USUAL else np.ones(len(lost), bool)
    early, unit, taken = lost[open_], rows.unit[open_], rows.taken[open_]
    if early.sum() < EVENTS:
        return None
    # At the same step with the same observation, as recordings of one length end at one step.
    place = np.unique(rows.cell[open_] * (longest + 1) + rows.step[open_], return_inverse=True)[1]
    beyond, actions = early - means_of(place, early), frequent(rows.taken, ACTIONS, ROWS)
    size = np.bincount(place)[place]  # of two rows of a place one is what the other is not
    for action in actions:
        chance = means_of(place, taken == action)
        least = float((np.square(beyond) * chance * (1.0 - chance) * size / np.maximum(size - 1, 1)).sum())
        p_value, strength = _correlated(beyond, (taken == action) - chance, unit, least)
        seen, expected = int(early[taken == action].sum()), float(chance[early].sum())
        if p_value * len(actions) < LEVEL and strength > 0 and seen >= OFTEN * expected:
            return (
                f"{seen:,} of {early.sum():,} recordings that end without a terminal do so after action "
                f"{action_names(case.data)[action]}, where {expected:.0f} would if ends did not depend on it "
                f"({p_in_words(p_value * len(actions))}): {remedy}"
            )
    return None
