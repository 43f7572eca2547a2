"""Whether actions change what later rows hold, although each row is read as an episode of its own.

The value of a policy in single steps is the mean reward of its actions in the observations of the log. It is the policy's value
in use only if its actions change neither later observations nor later rewards. Then, given the observation, an action must not
go with anything in the rows that follow: 1{A = a} - p(a|x) has mean zero in all parts of what the next rows hold, however these
depend on x. What of the next rows is known without the action is taken away first by least squares, so that slow effects show:
what the row itself tells of observations, and the next observation and action of rewards.
"""

from collections.abc import Iterator

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.neighbours import origin
from deadreckon.data.told import action_names, observation_names
from deadreckon.ope.balance import ACTIONS, COLUMNS, LEVEL, MOST, WEAK, beyond, standard
from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.parts import ROWS, apart, frequent, parts_of
from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words
from deadreckon.stats.ranks import one_way, sorted_by

LAGS = 3  # later rows that are looked at: rows of a few machines may take turns
SWITCHES = 0.02  # share of rows with another action than the row before; below, a log is in the order of its actions
EXACT = 1e-4  # of a column's standard deviation: below, a column of the next row is known from the row itself


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
    log = case.given
    if int(case.cluster.max()) + 1 < UNITS:
        return None
    learned = out_of_fold(case, model, folds, clipped=bool(not log.spec.discrete and case.clips.all()))
    taken = np.asarray(log.actions)
    if log.spec.discrete:
        actions = frequent(taken[case.held], ACTIONS, ROWS)
        actions = actions[:1] if log.spec.action_size == 2 else actions  # the other one is its opposite
    else:
        actions = list(range(min(log.spec.action_size, ACTIONS)))
    tests, found = 0, []
    for order, group in _orders(case, taken):
        for lag in range(1, LAGS + 1):
            place, after = _pairs(case, order, group, lag)
            if len(place) < UNITS * 2:
                continue
            rows, unit = case.held[place], np.unique(case.cluster[place], return_inverse=True)[1]
            left = beyond(learned, place, taken[rows], actions)
            for name, values in _later(log, rows, after, taken):
                part = parts_of(values, int(unit.max()) + 1)
                for action in actions:
                    p_value, strength = apart(*left[action], part, unit)
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
        f"action {action_names(log)[action]} goes with {name} of {row} ({p_in_words(p_value)}), so rows that follow each other "
        "are not decisions of their own: read them as steps of episodes (--episode)"
    )


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


def _later(log: Dataset, rows: np.ndarray, after: np.ndarray, taken: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The reward and the columns of later rows, each with a name and (rows,) values less what is known without the action.

    Args:
        log: of single steps.
        rows: numbers of some rows.
        after: numbers of those that follow them.
        taken: (rows of the log, ...) all actions.
    """
    own, next_ = _observations(log, rows), _observations(log, after)
    then = taken[after]
    acted = np.eye(int(taken.max()) + 1)[then] if then.ndim == 1 else then
    yield "the reward", _less(np.asarray(log.rewards)[after], np.column_stack([standard(next_), acted, np.square(acted)]))
    names = observation_names(log)
    for name, values, left in zip(names[len(names) - own.shape[1] :], next_.T, _less(next_, standard(own)).T):
        if left.std() > EXACT * values.std():
            yield f"column {name}", left


def _observations(log: Dataset, rows: np.ndarray) -> np.ndarray:
    """(rows, columns) of flat observations, of the last `COLUMNS`; without columns for images."""
    if len(log.spec.observation_shape) != 1:
        return np.zeros((len(rows), 0))
    return np.asarray(log.observations[rows], np.float64)[:, -COLUMNS:]


def _less(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(rows, ...) residuals of least squares on (rows, n) columns."""
    return values - known @ np.linalg.lstsq(known, values, rcond=None)[0]
