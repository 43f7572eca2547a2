"""Whether propensities fit the log: given them, actions must not depend on any column of the observations.

A column by which the behaviour policy acted, and which also goes with rewards, is a confounder. Logged propensities account
for it, and so do learned ones if the model of the behaviour policy has learned how actions depend on it. With the right
propensities 1{A = a} - p(a|x), and 1{A = a} / p(a|x) - 1 where action a is possible, have mean zero in any part of the log that
observations define (the balancing property, Rosenbaum and Rubin 1983). The parts that are tested are levels or tenths of single
columns. Actions that depend on a column beyond logged propensities may also be its cause, if it was measured after them. A
number of a continuous action is replaced by its rank in the learned distribution, which has the same mean in any part; logged
densities are not tested.

Nor must episodes go together that follow each other in the log, as those of one user do who has always the same action and good
or bad outcomes: they are not independent, and intervals are too narrow.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.split import clusters as clusters_of
from deadreckon.data.told import action_names, observation_names
from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior import Behavior, out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.importance import learns
from deadreckon.ope.parts import ROWS, apart, frequent, parts_of, sums_of
from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words
from deadreckon.stats.ranks import sorted_by

LEVEL = 0.001  # error probability of all tests of a log together (Bonferroni)
# Below, a dependence is too weak to matter, however many rows show it: the share of an action's variance that the parts of a
# column tell beyond learned propensities, as a correlation, and by how much more often than logged ones say it is taken.
WEAK = 0.1
MOST = 40_000  # rows that are looked at
COLUMNS, ACTIONS = 200, 5  # columns that are looked at, and most frequent actions
UNIFORM = 1 / 12  # variance of ranks
LAGS, CLOSE = 3, 0.001  # episodes after each that it is compared with, and the error probability of that test


class Unbalanced(NamedTuple):
    """The column that actions depend on most beyond the propensities.

    Attributes:
        column: its name; None: logged propensities are wrong in all rows.
        action: the name of the action.
        p_value: of no dependence, for all columns and actions together.
        logged: whether the propensities are logged.
    """

    column: str | None
    action: str
    p_value: float
    logged: bool

    @property
    def words(self) -> str:
        """Why no policy is deployed, as a phrase."""
        p = p_in_words(self.p_value)
        if self.column is None:
            return f"action {self.action} is taken more often than the logged propensities say ({p}): they are wrong"
        if self.logged:
            return (
                f"given {self.column}, action {self.action} is taken more often than the logged propensities say ({p}): the "
                f"propensities are wrong, or {self.column} was measured after the action (leave it out, --ignore)"
            )
        return (
            f"actions depend on {self.column} in a way that the learned propensities do not show ({p}), so a gain may be an "
            f"effect of {self.column}: record propensities, or add columns in which the dependence is simpler, such as levels"
        )


def unbalanced(case: OPEInput, model: BehaviorModel, folds: int = 5) -> Unbalanced | None:
    """The column that actions depend on beyond the propensities, if there is one; not of logged densities. Computed once.

    Args:
        case: log and policies.
        model: settings of the behaviour model, whose propensities are tested if the log has none.
        folds: number of parts of the evaluated episodes.
    """
    if case.degenerate.all() or not (case.data.spec.discrete or learns(case, "auto")):
        return None
    return case.once(("balance", model, folds), lambda: _unbalanced(case, model, folds))


def dependent(case: OPEInput, model: BehaviorModel, folds: int = 5) -> str | None:
    """A warning that episodes of single steps that follow each other in the log are not independent; None if they are, or if
    clusters say which are not. Computed once.

    Args:
        case, model, folds: as for `unbalanced`; of discrete actions.
    """
    single = case.data.spec.discrete and case.data.lengths.max() == 1
    if not single or len(case.data) < UNITS * LAGS or case.clusters.max() < clusters_of(case.given).max():
        return None
    p_value = case.once(("neighbours", model, folds), lambda: _dependence(case, model, folds))
    if p_value >= CLOSE:
        return None
    return (
        f"episodes that follow each other in the log go together ({p_in_words(p_value)}), as those of one user or day, so that "
        "intervals are too narrow; name the column that tells which belong together (--cluster), unless the log is sorted"
    )


def _dependence(case: OPEInput, model: BehaviorModel, folds: int) -> float:
    """The p-value of no correlation of products of action and reward, both without what observations tell, with those of the
    next episodes; 1 if the correlation is weak, or if the log is in the order of its actions or rewards."""
    chances = out_of_fold(case, model, folds).chances
    assert chances is not None
    taken, rewards = np.asarray(case.data.actions[:MOST]), np.asarray(case.data.rewards[:MOST], np.float64)
    often = int(np.bincount(taken).argmax())
    if (np.diff(taken == often) != 0).sum() < len(taken) / 50 or sorted_by(rewards):
        return 1.0
    seen = standard(np.asarray(case.data.observations[: len(taken)], np.float64))
    rewards = rewards - seen @ np.linalg.lstsq(seen, rewards, rcond=None)[0]
    score = ((taken == often) - chances[: len(taken), often].astype(np.float64)) * rewards
    score -= score.mean()  # which is the effect of the action
    after = sum(np.append(score[lag:], np.zeros(lag)) for lag in range(1, LAGS + 1))
    product = score * after
    if product.sum() < WEAK * np.square(score).sum():
        return 1.0
    return float(stdtr(len(product) - 1, -product.sum() / np.sqrt(np.square(product).sum())))


def inverse(log_probs: np.ndarray) -> np.ndarray:
    """(rows,) inverse propensities, of which the largest are bounded, by their logarithms."""
    return np.exp(np.minimum(-np.asarray(log_probs, np.float64), 50.0))


def standard(seen: np.ndarray) -> np.ndarray:
    """(rows, n) columns for least squares: a constant, and the last standardised columns of (rows, columns) with their squares,
    a tenth as many as there are rows at most."""
    seen = seen[:, seen.shape[1] - min(seen.shape[1], COLUMNS, len(seen) // 20) :]
    seen = (seen - seen.mean(0)) / np.where(seen.std(0) > 0, seen.std(0), 1.0)
    return np.column_stack([np.ones(len(seen)), seen, np.square(seen)])


def _unbalanced(case: OPEInput, model: BehaviorModel, folds: int) -> Unbalanced | None:
    logged = not learns(case, "auto")
    # Logged propensities can be tested on all rows, learned ones on those that their models have not seen.
    log, cluster = (case.plain, case.clusters) if logged else (case.data, case.cluster)
    rows = np.arange(len(log))
    if len(log) > MOST:
        rows = np.sort(generator(case.seed, "balance").choice(len(log), MOST, replace=False))
    unit = np.unique(cluster[log.episode_at(rows)], return_inverse=True)[1]
    if unit.max() + 1 < UNITS:
        return None
    size = case.plain.spec.observation_size  # positions stand before them
    seen = np.asarray(log.observations[rows])[:, -min(size, COLUMNS) :]
    parts = [parts_of(column, int(unit.max()) + 1) for column in seen.T]
    taken = np.asarray(log.actions[rows])
    if log.spec.discrete:
        actions = frequent(taken, ACTIONS, ROWS)
    else:
        actions = list(range(min(log.spec.action_size, ACTIONS)))
    if not actions or not parts:
        return None
    if logged:
        weight = inverse(log.extras[LOG_PROBS][rows])
        parts = [np.zeros(len(rows), int), *parts]  # all rows together first
        test = lambda part, a: above(np.where(taken == a, weight, 0.0), part, unit)  # noqa: E731
    else:
        if log.spec.discrete and log.spec.action_size == 2:
            actions = actions[:1]
        learned = out_of_fold(case, model, folds, clipped=bool(case.clips.all()))
        left = beyond(learned, rows, taken, actions)
        test = lambda part, a: apart(*left[a], part, unit)  # noqa: E731
    found = np.array([[test(part, a) for a in actions] for part in parts])  # (columns, actions, 2): p-values and strengths
    p_values = np.where(found[..., 1] >= WEAK, found[..., 0], 1.0) * found[..., 0].size
    if logged and p_values[0].min() < LEVEL:
        return Unbalanced(None, action_names(log)[actions[int(np.argmin(p_values[0]))]], float(p_values[0].min()), True)
    # The strongest of those that are sure beyond what numbers can hold.
    best = np.lexsort((-found[..., 1].ravel(), p_values.ravel()))[0]
    (column, action), p_value = np.unravel_index(best, p_values.shape), min(float(p_values.ravel()[best]), 1.0)
    if p_value >= LEVEL:
        return None
    column += size - len(seen.T) - logged
    return Unbalanced(observation_names(case.plain)[int(column)], action_names(log)[actions[action]], p_value, logged)


def beyond(
    learned: Behavior, rows: np.ndarray, taken: np.ndarray, actions: list[int]
) -> dict[int, tuple[np.ndarray, np.ndarray, float]]:
    """What actions are beyond their learned propensities: for each (rows,) residuals, their variances by the propensities, and
    the variance of the action.

    Args:
        learned: propensities of all evaluated rows.
        rows: numbers of those that are tested.
        taken: (rows, ...) their actions.
        actions: discrete actions, or numbers of a continuous one.
    """
    out = {}
    for a in actions:
        if learned.chances is not None:
            chance, share = learned.chances[rows, a].astype(np.float64), (taken == a).mean()
            out[a] = (taken == a) - chance, chance * (1.0 - chance), share * (1.0 - share)
        else:
            assert learned.ranks is not None
            rank = learned.ranks[rows, a]
            out[a] = rank - rank.mean(), np.full(len(rows), UNIFORM), UNIFORM  # another shape is no dependence
    return out


def above(weight: np.ndarray, part: np.ndarray | None, unit: np.ndarray) -> tuple[float, float]:
    """The p-value of means of an action's weights (rows,), 0 in rows without it, that are not above one in any part, and by how
    much they are.

    Means below one are no evidence: an action may be impossible for some rows, and then no propensity is known.
    """
    if part is None:
        return 1.0, 0.0
    p_values, means = [], []
    for each in (part, (part > part.max() / 2).astype(int)):
        sums = sums_of(weight - 1.0, each, unit)
        count = len(sums)
        # The variance of 1{A = a} / p is w - 1, of which w 1{A = a} (w - 1) is an unbiased estimate.
        known = np.bincount(each, weight * (weight - 1.0))
        error = np.sqrt(np.maximum(count * sums.var(0, ddof=1), known))
        t = np.divide(sums.sum(0), error, out=np.zeros(sums.shape[1]), where=error > 0)
        mean = sums.sum(0) / np.bincount(each)
        p_values += np.where(mean >= WEAK, stdtr(count - 1, -t), 1.0).tolist()
        means += mean.tolist()
    best = int(np.argmin(p_values))
    return min(p_values[best] * len(p_values), 1.0), means[best]
