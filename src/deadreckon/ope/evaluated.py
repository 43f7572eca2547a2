"""The evaluated episodes of a log: what they show by themselves, whatever the policies do."""

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from deadreckon.data.batch import redrawn
from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import rows_of
from deadreckon.data.split import clusters as clusters_of
from deadreckon.errors import UserError
from deadreckon.ope.estimand import TAIL, discounted_steps
from deadreckon.ope.features import Table
from deadreckon.ope.fits import Fits
from deadreckon.ope.sequences import times
from deadreckon.ope.settings import EstimateSettings
from deadreckon.ope.weights import GROUPS, Episodes
from deadreckon.randomness import generator


class EvaluatedLog(Fits):
    """The episodes of a log that policies are evaluated on, cut to the horizon, and what they show whatever the policies do.

    Args:
        given: the log as it was recorded.
        plain: `given` with the observations that policies act on.
        log: `plain` with the observations of the models of the behaviour policy and of values.
        settings: of the estimates.
        held: (n,) indices of the evaluated episodes; None: all.
        clusters: (episodes of `given`,) cluster of each, 0, 1, ....

    Attributes:
        data: the evaluated episodes of `log`.

    Raises:
        UserError: settings out of range, or episodes that are not different ones of the log.
    """

    def __init__(
        self, given: Dataset, plain: Dataset, log: Dataset, settings: EstimateSettings, held: np.ndarray | None,
        clusters: np.ndarray,
    ):  # fmt: skip
        self.settings = settings
        super().__init__(settings.estimand(given), settings)
        self.discount = self.estimand.discount
        self.given, self.clusters = given, clusters
        self.held = np.arange(given.episodes) if held is None else _different(held, given.episodes)
        self.log = self.estimand.cut(log)
        self.plain = self.estimand.cut(plain) if log is not plain else self.log
        self.data = self.log if held is None else self.log.select(self.held)

    @cached_property
    def units(self) -> np.ndarray:
        """(episodes of `data`,) unit of each episode, 0 .. n - 1: its cluster, or a random group of clusters where there are
        more than `GROUPS`. Units are resampled, and influence functions are summed over them."""
        count = int(self.cluster.max()) + 1
        mixed = generator(self.seed, "units").permutation(np.arange(count) % min(count, GROUPS))
        return mixed[self.cluster]

    @cached_property
    def cluster(self) -> np.ndarray:
        """(episodes of `data`,) cluster of each, 0 .. n - 1."""
        return np.unique(self.clusters[self.held], return_inverse=True)[1]

    @cached_property
    def clustered(self) -> bool:
        """Whether some of the evaluated episodes are of one cluster."""
        return int(self.cluster.max()) + 1 < len(self.cluster)

    @cached_property
    def episodes(self) -> Episodes:
        """The shape of the evaluated episodes, as weighted sums need it."""
        return Episodes(self.data, self.discount, self.seed, self.units)

    def episodes_of(self, part: np.ndarray) -> Episodes:
        """`episodes` for a part of them, a mask (episodes,): the probability of a cut-off is estimated from the part alone."""
        units = np.unique(self.units[part], return_inverse=True)[1]
        return Episodes(self.data.select(np.flatnonzero(part)), self.discount, self.seed, units)

    @cached_property
    def time(self) -> np.ndarray:
        """(rows,) steps since the episode's start."""
        return times(self.data.lengths)

    @cached_property
    def ended(self) -> np.ndarray:
        """(rows,) whether the task ended there: terminals of the log, without the ends that the horizon makes."""
        return self._uncut[0]

    @cached_property
    def followed(self) -> np.ndarray:
        """(rows,) whether the row's successor is known, or the horizon or the task ends the episode there; all true if only the
        first reward counts."""
        return np.ones(len(self.data), bool) if self._alone else self._uncut[1]

    @property
    def _alone(self) -> bool:
        return self.discount == 0.0 or self.estimand.horizon == 1

    @cached_property
    def shown(self) -> np.ndarray:
        """(rows,) whether the behaviour policy's next action is known: the log shows it, or its frequency there, or there is no
        next row."""
        return ~(self.data.is_end | self._apart) | self.ended | (self._habits is not None) | self._alone

    @cached_property
    def _apart(self) -> np.ndarray:
        """(rows,) `Dataset.apart` of the original log: features of one image may differ by rounding between computations."""
        if self.data.successors is None:
            return np.zeros(len(self.data), bool)
        given = self.given  # no horizon cuts such a log
        return given.apart[rows_of(given.starts[self.held], given.lengths[self.held])]

    @cached_property
    def complete(self) -> bool:
        """Whether the log shows the return of each episode: all end at the same step or earlier, and hardly any of the
        estimand's discounted time lies beyond."""
        return self.episodes.even and self.beyond <= TAIL

    @cached_property
    def beyond(self) -> float:
        """Share of the estimand's discounted time that lies beyond the ends of the recording, in the log's episodes."""
        return self._beyond(self.data.lengths, np.asarray(self.data.terminals)[self.data.ends])

    @cached_property
    def cut_ahead(self) -> float:
        """The same share in the episodes that are cut off; 0 if there are none."""
        cut = ~np.asarray(self.data.terminals)[self.data.ends]
        return float(self._ahead[self.data.lengths[cut] - 1].mean()) if cut.any() else 0.0

    def beyond_of(self, log_rho: np.ndarray, part: Episodes | None = None) -> float:
        """`beyond` in a policy's episodes, whose weights estimate how many of them end before they would be cut off; at least
        `beyond`. The uncertainty of this estimate is not known: weights based on few episodes may miss those that are cut off,
        and are reported separately.

        Args:
            log_rho: (rows,) logarithms of the products of its ratios along each episode; see `Episodes.cumulate`.
            part: the evaluated episodes that the rows belong to; None: all of them.
        """
        part = self.episodes if part is None else part
        if self._endless(part).sum() <= (least := self._beyond(part.lengths, part.ended)):  # no policy has more
            return least
        return self._at_least(part, part.going_on(log_rho))

    def beyond_if(self, going_on: np.ndarray) -> float:
        """The same for a policy of whose episodes the share `going_on` (steps,) continues after each step."""
        return self._at_least(self.episodes, going_on)

    def _at_least(self, part: Episodes, going_on: np.ndarray) -> float:
        share, least = float(self._endless(part) @ going_on), self._beyond(part.lengths, part.ended)
        return share if share > least * (1 + 1e-9) else least

    def _beyond(self, lengths: np.ndarray, ended: np.ndarray) -> float:
        return float((self._ahead[lengths - 1] * ~ended).mean())

    def _endless(self, part: Episodes) -> np.ndarray:
        """(steps,) `beyond` of episodes that no terminal ends, by the step after which they are cut off."""
        return -np.diff(part.uncensored) * self._ahead[: part.steps]

    @cached_property
    def _ahead(self) -> np.ndarray:
        """(steps,) share of the estimand's discounted time that lies after each step of the longest episode."""
        steps, horizon = np.arange(1, int(self.data.lengths.max()) + 1), self.estimand.horizon
        if horizon is None:
            return self.discount**steps
        done = np.array([discounted_steps(self.discount, int(step)) for step in steps])
        return 1.0 - done / discounted_steps(self.discount, horizon)

    @property
    def positions(self) -> bool:
        """Whether models see the positions of episodes, which policies do not; see `ope.over_time`."""
        return self.plain is not self.log

    @property
    def table(self) -> Table | None:
        """The log's different observations, numbered; None if there are many, if models see positions, or if actions are
        continuous. Made once."""
        return None if self.positions else self.once("table", lambda: Table.of(self.log))

    @cached_property
    def _habits(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """A function from (n, d) observations to (n, actions) action frequencies in the log, for next actions that the log does
        not show. None if it shows them all, or if there are too many different observations."""
        whole = self.data.terminals[self.data.ends].all() and not self._apart.any()
        if whole or (table := Table.of(self.plain) if self.positions else self.table) is None:
            return None
        shares, size = table.shares(self.plain), self.plain.spec.observation_size
        return lambda observations: shares[table.codes(np.asarray(observations)[:, -size:])]

    @cached_property
    def _uncut(self) -> tuple[np.ndarray, np.ndarray]:
        if self.estimand.horizon is None:
            return np.asarray(self.data.terminals), self.data.usable
        whole = self.given.select(self.held)
        kept = times(whole.lengths) < self.estimand.horizon
        return np.asarray(whole.terminals)[kept], whole.usable[kept]

    def folds(self, count: int) -> np.ndarray:
        """(episodes of `data`,) fold of each, 0 .. count - 1, or as many as there are clusters; clusters stay whole.

        Raises:
            UserError: fewer than two clusters.
        """
        clusters = int(self.cluster.max()) + 1
        if clusters < 2:
            raise UserError(f"{self.data.name}: one episode or cluster cannot be cross-fitted; two or more are needed")
        dealt = generator(self.seed, "folds").permutation(np.arange(clusters) % min(count, clusters))
        return dealt[self.cluster]

    @cached_property
    def effective_horizon(self) -> float:
        """The divisor that brings a return to the scale of a reward."""
        return self.estimand.effective_horizon(self.data)

    @cached_property
    def timed(self) -> Dataset:
        """`data` as critics use it: with a horizon, observations include the elapsed share of it (0 to 1)."""
        return _timed(self.data, self.estimand.horizon)

    def redrawn(self, members: int) -> np.ndarray:
        """(episodes, members) count of each episode for each member of an ensemble: resampled with replacement.

        One member alone counts every episode once.
        """
        return redrawn(int(self.cluster.max()) + 1, members, self.seed)[self.cluster]



def numbered(clusters: np.ndarray | None, log: Dataset) -> np.ndarray:
    """(episodes,) the cluster of each episode, 0, 1, ...: as given, or by default as `data.split.clusters` finds them.

    Raises:
        UserError: there is not one for each episode.
    """
    if clusters is None:
        return clusters_of(log)
    if np.shape(clusters) != (log.episodes,):
        raise UserError(f"clusters must be one number per episode, ({log.episodes},), got {np.shape(clusters)}")
    return np.unique(clusters, return_inverse=True)[1]

def check_order(log: Dataset) -> None:
    """Refuses logs that do not show the behaviour policy's next actions, because its value is then not known.

    Raises:
        UserError: for most rows the next observation differs from that of the next row, and there are many observations.
    """
    inside, apart = len(log) - log.episodes, int(log.apart.sum())
    if 2 * apart > inside and Table.of(log) is None:
        raise UserError(
            f"{log.name}: {apart:,} of {inside:,} rows inside of episodes are followed by another observation than that of "
            "the next row, so it does not show what its policy did next; give the rows in the order in which they were recorded"
        )


def _different(held: Any, episodes: int) -> np.ndarray:
    """Checked indices of episodes. With duplicates, critics could be trained on episodes that they evaluate."""
    found = np.asarray(held)
    if found.ndim != 1 or not len(found) or not np.issubdtype(found.dtype, np.integer):
        raise UserError(f"held must be whole numbers, indices of one or more episodes, got {found.dtype}, shape {found.shape}")
    if found.min() < 0 or found.max() >= episodes or len(np.unique(found)) < len(found):
        told = f"got {len(found)}, of which {len(np.unique(found))} differ, from {found.min()} to {found.max()}"
        raise UserError(f"held must be different episodes, 0 .. {episodes - 1}, {told}")
    return found


def _timed(data: Dataset, horizon: int | None) -> Dataset:
    if horizon is None or horizon == 1:
        return data
    time = times(data.lengths)
    with_time = lambda seen, t: np.concatenate([np.asarray(seen), (t / horizon).astype(np.float32)[:, None]], 1)  # noqa: E731
    final = with_time(data.final_observations, data.lengths)
    successors = None if data.successors is None else with_time(data.successors, time + 1)
    observations = with_time(data.observations, time)
    return dataclasses.replace(data, observations=observations, final_observations=final, successors=successors)
