"""Whether the log supports estimates by ratios of occupancies (`drl`) and by what follows each row.

They take rows with the same observation for the same state. Then the critics' errors r + discount V(s') - Q(s, a) have mean
zero given all that came before. Two ways in which they do not, and which bias a gain, are tested: errors that depend on the
previous action, beyond the step of the episode, and errors that depend on the step where actions do so too, so that the step is
a confounder. Errors that depend on the step alone, as where all episodes end at one, bias both values alike.

Rows whose successor is not known are left out. That is a bias if their rewards differ from others of the same observation and
action, as those of episodes that ended without a terminal, or if an action makes such ends more frequent.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from deadreckon.data.told import action_names
from deadreckon.ope.basis import UNITS
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimates import LOGGED
from deadreckon.ope.features import Table
from deadreckon.ope.parts import ROWS, apart, means_of, parts_of
from deadreckon.ope.sequences import times
from deadreckon.stats.interval import p_in_words

LEVEL = 0.001  # error probability of all tests of one kind together (Bonferroni)
WEAK = 0.05  # correlation below which a dependence is too weak to matter, however many rows show it
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
        """None if observations take many values, or all episodes have one step."""
        data, size = case.data, case.plain.spec.observation_size  # positions stand before observations
        table = Table.of(case.plain) if case.positions else case.table
        if table is None or data.lengths.max() == 1:
            return None
        taken = np.asarray(data.actions)
        before = np.append(-1, taken[:-1])
        before[data.starts] = -1
        return cls(case.cluster[data.episode_of], times(data.lengths), before, table.codes(data.observations[:, -size:]), taken)

    @property
    def frequent(self) -> list[int]:
        """The most frequent actions."""
        counts = np.bincount(self.taken)
        return [a for a in np.argsort(-counts, kind="stable")[:ACTIONS].tolist() if counts[a] >= ROWS]


def hidden_state(case: OPEInput, errors: np.ndarray) -> str | None:
    """Why observations do not hold all that matters, as a phrase; None if no test shows that.

    Args:
        case: log and policies.
        errors: (policies, rows) of the critics, out of fold; see `critics.OutOfFold`.
    """
    rows = _Rows.of(case)
    if rows is None or int(case.cluster.max()) + 1 < UNITS:
        return None
    for column, name, advice in (
        (rows.before, "the previous action", "add the previous action as a column"),
        (rows.step, "the step of the episode", "add the step as a column"),
    ):
        if (p_value := min(_hidden(case, rows, errors, column), default=1.0)) < LEVEL:
            return (
                f"what follows an observation and an action depends on {name} ({p_in_words(p_value)}), so observations do not "
                f"hold all that matters: {advice}; {INSTEAD}"
            )
    return None


def _hidden(case: OPEInput, rows: _Rows, errors: np.ndarray, column: np.ndarray) -> Iterator[float]:
    """p-values, corrected for their number, of critics' errors of mean zero in all parts of a column that confounds."""
    by_step, data = column is rows.step, case.data
    tests = len(errors) * (len(rows.frequent) if by_step else 1)
    for name, own in zip(case.names, errors):
        known = case.followed & (case.shown | np.asarray(data.terminals)) if name == LOGGED else case.followed
        known = known & (by_step | (rows.before >= 0))
        error, unit = own[known], np.unique(rows.unit[known], return_inverse=True)[1]
        if not by_step:
            error = error - means_of(rows.step[known], error)
        part = parts_of(column[known], int(unit.max()) + 1) if known.any() else None
        p_value, strength = apart(error, np.zeros(len(error)), error.var(), part, unit)
        if part is None or strength < WEAK or p_value * tests >= LEVEL:
            continue
        if not by_step:
            yield p_value * tests
            continue
        means = means_of(part, error)
        for action in rows.frequent:
            above = (rows.taken == action) - means_of(rows.cell, rows.taken == action)
            yield tests * max(_correlated(means, above[known], unit), p_value)


def _correlated(a: np.ndarray, b: np.ndarray, unit: np.ndarray) -> float:
    """The two-sided p-value of (rows,) lists whose product has mean zero; independent units."""
    sums = np.bincount(unit, a * b)
    error = sums.std(ddof=1) * np.sqrt(len(sums))
    return float(2 * stdtr(len(sums) - 1, -abs(sums.sum()) / error)) if error > 0 else 1.0


def left_out(case: OPEInput) -> str | None:
    """Why rows without a known successor must not be left out, as a phrase; None if no test shows that."""
    lost = ~case.followed
    if case.estimand.horizon is not None or not ROWS <= lost.sum() <= len(lost) - ROWS:
        return None
    rows, rewards = _Rows.of(case), np.asarray(case.data.rewards, np.float64)
    if rows is None:
        return None
    remedy = "if episodes end there, name the column that says so (--terminal), or give a horizon (--horizon)"
    pair = rows.cell * (int(rows.taken.max()) + 1) + rows.taken
    count = np.bincount(pair[~lost], minlength=int(pair.max()) + 1)
    expected = (np.bincount(pair[~lost], rewards[~lost], len(count)) / np.maximum(count, 1))[pair]
    both = count[pair] > 0  # where all rows are lost there is nothing to compare with
    unit = np.unique(rows.unit[both], return_inverse=True)[1]
    residual = np.where(lost, rewards - expected, 0.0)[both]
    p_value, strength = apart(residual, np.zeros(len(residual)), float(rewards.var()), lost[both].astype(int), unit)
    if p_value < LEVEL and strength >= WEAK:
        other, usual = rewards[both & lost].mean(), expected[both & lost].mean()
        return (
            f"the last rows of {lost.sum():,} episodes, whose next observations are not known, are left out, and their rewards "
            f"differ from those of other rows with the same observation and action (mean {other:.4g}, others {usual:.4g}; "
            f"{p_in_words(p_value)}): {remedy}"
        )
    residual = lost - means_of(rows.cell, lost)
    for action in rows.frequent:
        taken = rows.taken == action
        p_value, strength = apart(residual, np.zeros(len(lost)), float(lost.var()), taken.astype(int), rows.unit)
        if p_value * len(rows.frequent) < LEVEL and strength >= WEAK:
            share, rest = lost[taken].mean(), lost[~taken].mean()
            return (
                f"recordings end without a terminal after {share:.1%} of the rows with action "
                f"{action_names(case.data)[action]} and after {rest:.1%} of the others ({p_in_words(p_value)}), as if the "
                f"action ended episodes: {remedy}"
            )
    return None
