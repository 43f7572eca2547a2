"""Whether the rows of episodes are in the order of time, and rewards in their own rows.

What an action changes comes after it. An action that was chosen by its observation goes, given this, with what later rows hold,
and not with what the row before held: 1{A = a} - p(a|x) has mean zero in all parts of it. In an episode whose newest row comes
first, or whose rows are mixed, the row before may be the next one; and a reward that stands one row early is in the row before.
What of the row before is known without the action is taken away first by least squares: what the row itself and the previous
action tell of observations, and the previous row, too, of rewards. Other dependences are weaker: where users have habits of
their own, earlier rows say something of them. So it is an objection only if the dependence is not much weaker than that on the
row after.
"""

from typing import NamedTuple

import numpy as np

from deadreckon.data.told import action_names, observation_names
from deadreckon.ope import balance
from deadreckon.ope.balance import ACTIONS, COLUMNS, standard
from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.carry_over import EXACT, Test, less, residual_tests
from deadreckon.ope.case import OPEInput
from deadreckon.ope.parts import ROWS, frequent, parts_of
from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words

LEVEL = balance.LEVEL / 2  # error probability of the tests of observations, and of rewards
MOST = 10_000  # rows that are looked at
PRODUCTS = 100  # of columns and previous actions, beyond which they are left out
WEAK = 0.05  # correlation below which a dependence does not count, however many rows show it
SHARE = 0.7  # of the strength of the dependence on the row after, from which on that on the row before counts


class _Found(NamedTuple):
    """A dependence of an action on a column of another row."""

    p_value: float
    strength: float
    column: int
    action: int


NOTHING = _Found(1.0, 0.0, 0, 0)


def out_of_order(case: OPEInput, model: BehaviorModel, folds: int = 5) -> str | None:
    """Why the rows of the episodes of a log may not be in the order of time, as a phrase; None if no test shows that. Computed
    once.

    Args:
        case: log and policies.
        model: settings of the behaviour model.
        folds: number of parts of the evaluated episodes.
    """
    if case.data.lengths.max() == 1 or case.data.successors is not None or case.degenerate.all():
        return None
    return case.once(("row order", model, folds), lambda: _out_of_order(case, model, folds))


def _out_of_order(case: OPEInput, model: BehaviorModel, folds: int) -> str | None:
    log, rng = case.data, generator(case.seed, "row order")
    if int(case.cluster.max()) + 1 < UNITS:
        return None
    first = np.zeros(len(log), bool)
    first[log.starts] = True
    # Rows with one before, and rows with one after.
    (rows, unit), (others, unit_of_others) = (_some(case, ~mask, rng) for mask in (first, log.is_end))
    if not len(rows):
        return None
    seen = _Seen(case)
    now, acted = standard(seen.at(rows)), _acted(case, rows - 1)
    known = np.column_stack([now, acted])
    if seen.count * acted.shape[1] <= PRODUCTS:
        known = np.column_stack([known, *(now[:, 1 : 1 + seen.count] * each[:, None] for each in acted.T)])
    after = standard(seen.at(others))
    tests = residual_tests(case, model, folds)
    # Continuous actions with autocorrelated noise go with earlier observations, which tell what of the last action was noise.
    earlier = _strongest(tests, rows, unit, seen.at(rows - 1), known) if log.spec.discrete else NOTHING
    later = _strongest(tests, others, unit_of_others, seen.at(others + 1), after)
    if earlier.p_value < LEVEL and earlier.strength >= SHARE * later.strength:
        name = observation_names(case.plain)[-seen.count :][earlier.column]
        return (
            f"action {action_names(log)[earlier.action]} goes with {name} of the row before ({p_in_words(earlier.p_value)}), "
            "beyond what its own row shows: rows may not be in the order of time (--time), or actions depend on earlier rows "
            "(--history 2) or on a column that is missing, such as the user"
        )
    rewards = np.asarray(log.rewards, np.float64)[:, None]
    earlier = _strongest(tests, rows, unit, rewards[rows - 1], np.column_stack([known, standard(seen.at(rows - 1))]))
    later = _strongest(tests, others, unit_of_others, rewards[others], after)
    if earlier.p_value < LEVEL and earlier.strength >= SHARE * later.strength:
        return (
            f"action {action_names(log)[earlier.action]} goes with the reward of the row before "
            f"({p_in_words(earlier.p_value)}), beyond what the rows show: rewards may stand one row early, rows may not be in "
            "the order of time (--time), or actions react to the last reward, which then must be a column"
        )
    return None


class _Seen:
    """The columns that are looked at, of some rows."""

    def __init__(self, case: OPEInput):
        self.observations = case.data.observations
        self.count = min(case.plain.spec.observation_size, COLUMNS)  # positions stand before them

    def at(self, rows: np.ndarray) -> np.ndarray:
        """(rows, count) numbers."""
        return np.asarray(self.observations[rows])[:, -self.count :].astype(np.float64)


def _some(case: OPEInput, wanted: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """At most `MOST` of the `wanted` rows (rows,), and the clusters of their episodes, 0, 1, ...."""
    rows = np.flatnonzero(wanted)
    if len(rows) > MOST:
        rows = np.sort(rng.choice(rows, MOST, replace=False))
    return rows, np.unique(case.cluster[case.data.episode_at(rows)], return_inverse=True)[1]


def _acted(case: OPEInput, rows: np.ndarray) -> np.ndarray:
    """(rows, n) indicators of the most frequent actions there, or numbers of continuous ones and their squares."""
    taken = np.asarray(case.data.actions[rows])
    if not case.data.spec.discrete:
        numbers = taken.reshape(len(rows), -1)[:, :ACTIONS].astype(np.float64)
        return np.column_stack([numbers, np.square(numbers)])
    return (taken[:, None] == frequent(taken, ACTIONS, ROWS)[1:]).astype(np.float64)


def _strongest(
    tests: dict[int, Test], rows: np.ndarray, unit: np.ndarray, values: np.ndarray, known: np.ndarray
) -> _Found:
    """The most significant dependence of an action in some rows on (rows, columns) values, less what `known` (rows, n) tells of
    them, corrected for their number."""
    units, found = int(unit.max()) + 1, [NOTHING]
    for column, (own, left) in enumerate(zip(values.T, less(values, known).T)):
        if left.std() <= EXACT * own.std():
            continue  # of a column that is known, as one that never changes in an episode, rounding is left
        part = parts_of(left, units)
        for action, test in tests.items():
            p_value, strength = test(rows, part, unit)
            if strength >= WEAK:
                found.append(_Found(p_value * values.shape[1] * len(tests), strength, column, action))
    return min(found, key=lambda each: (each.p_value, -each.strength))
