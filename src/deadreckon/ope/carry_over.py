"""Whether actions change what later rows hold, although each row is read as an episode of its own.

The value of a policy in single steps is the mean reward of its actions in the observations of the log. It is the policy's value
in use only if its actions change neither later observations nor later rewards. Then, given the observation, an action must not
go with anything in the rows that follow: 1{A = a} - p(a|x) has mean zero in all parts of what the next rows hold, however these
depend on x. What of the next rows is known without the action is taken away first by least squares, so that slow effects show:
what the row itself tells of observations, and the next observation and action of rewards. The spread of rewards may differ by
action, too, so they are tested only where actions do not follow each other.
"""

from collections.abc import Callable, Iterator

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.neighbours import origin
from deadreckon.data.told import action_names, observation_names
from deadreckon.ope.balance import ACTIONS, COLUMNS, LEVEL, MOST, WEAK, above, beyond, inverse, standard
from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.importance import learns
from deadreckon.ope.parts import PARTS, ROWS, apart, frequent, means_of, parts_of
from deadreckon.randomness import generator
from deadreckon.stats.interval import ALPHA, p_in_words
from deadreckon.stats.ranks import one_way, sorted_by

LAGS = 3  # later rows that are looked at: rows of a few machines may take turns
SWITCHES = 0.02  # share of rows with another action than the row before; below, a log is in the order of its actions
FOLLOW = 0.05  # correlation of an action with the later row's from which on that row's reward is not tested
EXACT = 1e-4  # of a column's standard deviation: below, a column of the next row is known from the row itself

Test = Callable[[np.ndarray, np.ndarray | None, np.ndarray], tuple[float, float]]  # of rows, their parts and units


def carried_over(case: OPEInput, model: BehaviorModel, folds: int = 5) -> str | None:
    """Why the rows of a log of single steps are not decisions of their own, as a phrase; None if no test shows that. Computed
    once.

    Args:
        case: log and policies.
        model: settings of the behaviour model.
        folds: number of parts of the evaluated episodes.
    """
    if case.given.lengths.max() > 1 or case.degenerate.all():
        return None
    return case.once(("later rows", model, folds), lambda: _carried_over(case, model, folds))


def _carried_over(case: OPEInput, model: BehaviorModel, folds: int) -> str | None:
    log, taken = case.given, np.asarray(case.given.actions)
    if int(case.cluster.max()) + 1 < UNITS:
        return None
    tested = residual_tests(case, model, folds)
    tests, found = 0, []
    for order, group in _orders(case, taken):
        for lag in range(1, LAGS + 1):
            place, after = _pairs(case, order, group, lag)
            if len(place) < UNITS * 2:
                continue
            rows, unit = case.held[place], np.unique(case.cluster[place], return_inverse=True)[1]
            units, then = int(unit.max()) + 1, _acted(log, taken[after])
            later = [(name, parts_of(values, units)) for name, values in _later(log, rows, after, then)]
            acts = [parts_of(column, units) for column in (then.T if then.ndim > 1 else [then])]
            for action, test in tested.items():
                # Where actions follow each other, what goes with the reward may be the effect of the later action.
                follows = any(p < ALPHA and strength >= FOLLOW for p, strength in (test(place, part, unit) for part in acts))
                for name, part in later[follows:]:
                    p_value, strength = test(place, part, unit)
                    tests += 1
                    if strength >= WEAK:
                        found.append((p_value, -strength, name, action, lag))
    if not found:
        return None
    p_value, _, name, action, lag = min(found)
    if (p_value := p_value * tests) >= LEVEL:
        return None
    row = "the next row" if lag == 1 else f"the row {lag} rows later"
    return (
        f"action {action_names(log)[action]} goes with {name} of {row} ({p_in_words(p_value)}), beyond what the row shows: "
        "rows may be steps of episodes (--episode), rewards may belong to other rows, or a column may be missing that actions "
        "depend on, such as the user; a table must begin with its oldest rows"
    )


def residual_tests(case: OPEInput, model: BehaviorModel, folds: int) -> dict[int, Test]:
    """For frequent actions, tests of whether they are beyond their propensities in no part of some evaluated rows.

    Learned propensities are those of `balance.beyond`. Of two actions with logged ones, that of the other is known, too; of
    more it is not, and the test is that of `balance.unbalanced`.
    """
    log, taken = case.data, np.asarray(case.data.actions)
    discrete, learned = log.spec.discrete, not log.spec.discrete or learns(case, "auto")
    actions = frequent(taken, ACTIONS, ROWS) if discrete else list(range(min(log.spec.action_size, ACTIONS)))
    two = discrete and log.spec.action_size == 2
    actions = actions[:1] if two else actions  # the other one is its opposite
    if not learned and not two:
        weight = inverse(log.extras[LOG_PROBS])
        return {a: lambda rows, part, unit, a=a: above(np.where(taken == a, weight, 0.0)[rows], part, unit) for a in actions}
    if learned:
        clipped = bool(not discrete and case.clips.all())
        left = beyond(out_of_fold(case, model, folds, clipped=clipped), np.arange(len(log)), taken, actions)
    else:
        own, left = np.exp(np.asarray(log.extras[LOG_PROBS], np.float64)), {}
        for a in actions:
            chance, share = np.where(taken == a, own, 1.0 - own), float((taken == a).mean())
            left[a] = (taken == a) - chance, chance * (1.0 - chance), share * (1.0 - share)
    return {
        a: lambda rows, part, unit, own=own: apart(own[0][rows], own[1][rows], own[2], part, unit) for a, own in left.items()
    }


def _orders(case: OPEInput, taken: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Orders in which rows may follow each other: that of the log, and that of the rows of each cluster.

    Each is given as the numbers of rows, without copies, and their clusters, between which no row follows another. An order by
    actions or rewards is left out.
    """
    rows = np.unique(origin(case.given))
    cluster = case.clusters[rows]
    orders = [(rows, np.zeros(len(rows), int))]
    if len(np.unique(cluster)) < len(rows):
        own = np.argsort(cluster, kind="stable")
        orders.append((rows[own], cluster[own]))
    for order, group in orders:
        if not _sorted(case.given, order, taken):
            yield order, group


def _sorted(log: Dataset, order: np.ndarray, taken: np.ndarray) -> bool:
    """Whether the first rows of an order are sorted by rewards or actions, or by columns and, where these are equal, by
    actions."""
    order = order[:MOST]
    codes = taken[order] if taken.ndim == 1 else taken[order, 0]
    if sorted_by(np.asarray(log.rewards)[order]) or (np.diff(codes) != 0).mean() < SWITCHES:
        return True
    columns, equal = list(_observations(log, order).T), np.ones(len(order) - 1, bool)
    while equal.sum() >= UNITS:
        if one_way(np.diff(codes)[equal]):
            return True
        key = next((i for i, column in enumerate(columns) if one_way(np.diff(column)[equal])), None)
        if key is None:
            return False
        equal &= np.diff(columns.pop(key)) == 0
    return False


def _pairs(case: OPEInput, order: np.ndarray, group: np.ndarray, lag: int) -> tuple[np.ndarray, np.ndarray]:
    """Evaluated rows, as their places in `case.held`, and the rows that follow them after `lag` rows of an order; at most
    `MOST` of them."""
    before, after = order[:-lag], order[lag:]
    place = np.full(case.given.episodes, -1)
    place[case.held] = np.arange(len(case.held))
    known = (group[:-lag] == group[lag:]) & (place[before] >= 0)
    before, after = place[before[known]], after[known]
    if len(before) > MOST:
        chosen = np.sort(generator(case.seed, "later rows").choice(len(before), MOST, replace=False))
        before, after = before[chosen], after[chosen]
    return before, after


def _acted(log: Dataset, actions: np.ndarray) -> np.ndarray:
    """(rows,) discrete actions, those that are rare as one, or (rows, n) numbers of continuous ones."""
    if not log.spec.discrete:
        return actions.reshape(len(actions), -1)[:, :ACTIONS]
    often = np.array(frequent(actions, PARTS, ROWS), int)
    return np.where(np.isin(actions, often), actions, -1)


def _later(log: Dataset, rows: np.ndarray, after: np.ndarray, then: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The reward and the columns of later rows, each with a name and (rows,) values less what is known without the action.

    Args:
        log: of single steps.
        rows: numbers of some rows.
        after: numbers of those that follow them.
        then: (rows, ...) actions of those.
    """
    own, next_ = _observations(log, rows), _observations(log, after)
    rewards = np.asarray(log.rewards[after], np.float64)
    if then.ndim == 1:
        rewards = rewards - means_of(np.unique(then, return_inverse=True)[1], rewards)
    yield "the reward", less(rewards, standard(next_))
    names = observation_names(log)
    for name, values, left in zip(names[len(names) - own.shape[1] :], next_.T, less(next_, standard(own)).T):
        if left.std() > EXACT * values.std():
            yield f"column {name}", left


def _observations(log: Dataset, rows: np.ndarray) -> np.ndarray:
    """(rows, columns) of flat observations, of the last `COLUMNS`; without columns for images."""
    if len(log.spec.observation_shape) != 1:
        return np.zeros((len(rows), 0))
    return np.asarray(log.observations[rows])[:, -COLUMNS:].astype(np.float64)


def less(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(rows, ...) residuals of least squares on (rows, n) columns."""
    return values - known @ np.linalg.lstsq(known, values, rcond=None)[0]
