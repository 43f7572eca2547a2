"""Whether the behaviour policy changed while the log was recorded, and how estimates are adjusted if it did.

If outcomes changed too, for reasons other than the recorded observations, an action that was taken more often in good times
looks good: time is a confounder, as in a campaign that was stepped up before the holidays. Logged propensities are those of
their time, but learned ones, and critics, are averages over time unless they see it. The position of an episode in the log
stands for its time, so models of the behaviour policy and of values then see it (`ope.positions`), and estimates compare
actions of about the same time. So does its position among the episodes of its cluster, such as the number of a user's visit:
where users are contacted until they answer, an action of first contacts looks good, because the users of later ones are others.
Whether outcomes changed is not asked: a change too small to be found can bias a gain by more
than its error, if the behaviour policy changed much.

The test correlates slow waves of the positions with the actions, given observations, after linear regression of both sides on
these (Frisch and Waugh, 1933); errors are by clusters of episodes.
"""

from typing import NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.ope.basis import UNITS
from deadreckon.ope.case import OPEInput
from deadreckon.ope.features import FAR, PRODUCTS, Table
from deadreckon.ope.positions import places, waves
from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words
from deadreckon.stats.products import p_of_products

LEVEL = 0.1  # error probability of the test: missing a change costs more than seeing one that is not there
MOST, NUMBERS = 40_000, 40_000_000  # most rows that are tested, and most numbers in their observations
CLEARLY = 1e-3  # how much smaller than a significant p-value along the log that along clusters must be to be told instead
COLUMNS = 50  # most columns of actions
WIDE = 100  # most numbers of an observation that are regressed on; of more, as many random projections are
ROWS = 10  # least rows for each regressor, and for each observation of a table
RIDGE = 1e-6  # of the regressions, relative to the variances of the columns


class Change(NamedTuple):
    """The test of a log.

    Attributes:
        p_value: of no change of the actions, given observations, both along the log and within its clusters.
        within: whether it is by the position in the cluster that actions differ most significantly; clusters of other sizes may
            also have other habits.
    """

    p_value: float
    within: bool

    @property
    def found(self) -> bool:
        """Whether the behaviour policy changed."""
        return self.p_value < LEVEL

    @property
    def words(self) -> str:
        """What it means for a decision, as a line."""
        return (
            f"the behaviour policy {changed(self.within)} ({p_in_words(self.p_value)}), and outcomes may have changed "
            f"too: estimates compare actions of about the same position {'in their cluster' if self.within else 'in the log'}; "
            "use --stationary if the system never changes, or if the order of rows says nothing of time"
        )


def changed(within: bool) -> str:
    """What the behaviour policy did, in words."""
    return "differs between first and later episodes of clusters" if within else "changed along the log"


def adjusted(case: OPEInput, stationary: bool = False) -> OPEInput:
    """The case with models that see the positions of episodes, if the behaviour policy changed along the log or within its
    clusters, else the case.

    Args:
        case: log and policies.
        stationary: whether outcomes are known not to change, or the order of episodes is not that of time.
    """
    if stationary or case.positions:
        return case
    change = change_of(case)
    if change is None or not change.found:
        return case
    found = case.with_positions()
    found.once("change", lambda: change)
    return found


def change_of(case: OPEInput) -> Change | None:
    """The test on all episodes of a case's log; made once. None if there are fewer than `UNITS` clusters."""
    return case.once("change", lambda: _change(case))


def _change(case: OPEInput) -> Change | None:
    log = case.plain
    if len(np.unique(case.clusters)) < UNITS:
        return None
    rng = generator(case.seed, "change")
    most = min(MOST, max(NUMBERS // log.spec.observation_size, 1_000))
    # At random: rows at equal distances may all be the same steps of their episodes.
    rows = np.arange(len(log)) if len(log) <= most else np.sort(rng.choice(len(log), most, replace=False))
    episode, table = log.episode_at(rows), Table.of(log) if case.positions else case.table
    if table is not None and ROWS * len(table.seen) <= len(rows):
        known = np.eye(len(table.seen))[table.codes(log.observations[rows])]
    else:
        known = _regressors(log, log.observations[rows], rng)
    positions = (waves(log, episode), places(case.clusters, episode))
    acted, cluster = _actions(log, rows), case.clusters[episode]
    found = [p_value(known, each, acted, cluster) for each in positions if each.shape[1]]
    # Where users come in turns, a change along the log is nearly one along their episodes, too.
    return Change(min(min(found) * len(found), 1.0), within=min(found) < found[0] * (CLEARLY if found[0] < LEVEL else 1.0))


def _regressors(log: Dataset, observations: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Standardised observations, or random projections of many numbers, and the products of few."""
    view = Normalizer.of(log.spec, standardise=True)
    seen = np.clip(np.asarray(view.observe(np.asarray(observations)), np.float64), -FAR, FAR)
    rows, count = seen.shape
    if count > (most := max(min(WIDE, rows // ROWS), 1)):
        seen = seen @ (rng.standard_normal((count, most)) / np.sqrt(count))
    one, other = np.triu_indices(seen.shape[1])
    few = len(one) <= min(PRODUCTS, rows // ROWS - seen.shape[1])
    return np.concatenate([seen, seen[:, one] * seen[:, other]], 1) if few else seen


def _actions(log: Dataset, rows: np.ndarray) -> np.ndarray:
    """(rows, columns) indicators of the most frequent actions, of two of one alone, or continuous actions and their squares."""
    taken = np.asarray(log.actions[rows])
    if log.spec.discrete:
        most = 1 if log.spec.action_size == 2 else COLUMNS
        frequent = np.argsort(-np.bincount(taken, minlength=log.spec.action_size), kind="stable")[:most]
        return (taken[:, None] == frequent).astype(np.float64)
    unit = np.asarray(Normalizer.of(log.spec).to_unit(taken), np.float64)
    return np.concatenate([unit, np.square(unit)], 1)[:, :COLUMNS]


def p_value(given: np.ndarray, time: np.ndarray, columns: np.ndarray, cluster: np.ndarray) -> float:
    """The p-value of no correlation of `time` with any of the columns beyond what is linear in `given`, by Bonferroni.

    Args:
        given: (rows, n) regressors, to which a constant is added.
        time: (rows, m) functions of the position.
        columns: (rows, k) what may have changed; one that is constant, or linear in `given`, is left out.
        cluster: (rows,) numbers of the clusters, whose errors are independent of each other.
    """
    rows = len(given)
    given = given[:, given.std(0) > 0]
    given = np.concatenate([np.ones((rows, 1)), (given - given.mean(0)) / given.std(0)], 1)
    both = np.concatenate([time, columns], 1)
    gram = given.T @ given + RIDGE * rows * np.eye(given.shape[1])
    both = both - given @ np.linalg.solve(gram, given.T @ both)
    waved, left = both[:, : time.shape[1]], both[:, time.shape[1] :]
    left = left[:, left.std(0) > 1e3 * RIDGE * columns.std(0)]
    return p_of_products(waved, left, cluster, freedom=1 - given.shape[1] / rows)  # residuals of fitted rows are too small
