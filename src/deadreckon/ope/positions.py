"""Logs whose observations begin with functions of the episode's position in the log, and in its cluster, which models see and
policies do not.

A log with few different observations also gets an indicator of each: a critic's table has no cells for positions, and models
that are linear in a number of a state would be poor.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from deadreckon.data.computed import Computed
from deadreckon.data.dataset import Dataset
from deadreckon.ope.features import PRODUCTS, Table

WAVES = 6  # functions of the position: half a period over the log, one, and so on up to three
PLACES = 3  # functions of the position in the cluster: half a period over the ranks of all of them, one, and one and a half
ROOM = 20_000_000  # most numbers of indicators over all rows


def waves(log: Dataset, episodes: np.ndarray) -> np.ndarray:
    """(n, WAVES) cosines of half periods 1, 2, ... over the log, at the middle row of each of these (n,) episodes."""
    return _cosines((log.starts[episodes] + 0.5 * log.lengths[episodes]) / len(log), WAVES)


def places(clusters: np.ndarray, episodes: np.ndarray) -> np.ndarray:
    """(n, PLACES) cosines of half periods 1, 2, ... over the ranks of places, ties at their mean rank, for each of these (n,)
    episodes: 0 for the first of a user, 1 for the second; (n, 0) if each is the first of its cluster.

    Args:
        clusters: (episodes of the log,) number of each episode's cluster, 0, 1, ....
        episodes: numbers of some episodes.
    """
    counts, order = np.bincount(clusters), np.argsort(clusters, kind="stable")
    if counts.max() == 1:
        return np.zeros((len(episodes), 0), np.float32)
    place = np.empty(len(clusters), int)
    place[order] = np.arange(len(clusters)) - np.repeat(np.cumsum(counts) - counts, counts)
    often = np.bincount(place)
    rank = (np.cumsum(often) - 0.5 * often) / len(clusters)
    return _cosines(rank[place[episodes]], PLACES)


def _cosines(position: np.ndarray, count: int) -> np.ndarray:
    return np.cos(np.pi * position[:, None] * np.arange(1, count + 1)).astype(np.float32)


def with_positions(
    log: Dataset, clusters: np.ndarray, parts: Sequence[slice] | None, policies: int
) -> tuple[Dataset, list[slice]]:
    """The log with `waves` and `places` before each observation, computed when rows are read.

    Args:
        log: with flat observations.
        clusters: (episodes,) number of each episode's cluster, 0, 1, ....
        parts: slice of an observation that each policy acts on; None: all of it.
        policies: number of them.

    Returns:
        The log, whose episodes keep their ids, and the slices in its observations.
    """
    each, size = np.arange(log.episodes), log.spec.observation_size
    own, table = np.concatenate([waves(log, each), places(clusters, each)], 1), Table.of(log)
    if table is not None:  # critics need the products of indicators and actions
        count = len(table.seen)
        few = (own.shape[1] + count + size) * log.spec.action_size <= PRODUCTS and len(log) * count <= ROOM
        table = table if few else None
    placed = lambda seen, episode: _Placed(own, episode, seen, table)  # noqa: E731
    found = replace(
        log, observations=cast(np.ndarray, placed(log.observations, log.episode_of)),
        final_observations=placed(log.final_observations, each)[:],
        successors=None if log.successors is None else cast(np.ndarray, placed(log.successors, log.episode_of)),
        part_of=lambda: log.episode_ids,
    )  # fmt: skip
    more = found.observations.shape[1] - size
    return found, [slice(more + part.start, more + part.stop) for part in parts or [slice(0, size)] * policies]


class _Placed(Computed):
    """(rows, WAVES + indicators + size) observations with functions of their positions."""

    def __init__(self, own: np.ndarray, episode: np.ndarray, seen: Any, table: Table | None):
        self.own, self.episode, self.seen = own, episode, seen
        self.codes = None if table is None else table.codes(np.asarray(seen))
        self.states = 0 if table is None else len(table.seen)
        self.shape = len(seen), own.shape[1] + self.states + seen.shape[1]
        self.dtype = np.result_type(np.float32, seen.dtype)

    def __getitem__(self, index: Any) -> np.ndarray:
        if isinstance(index, tuple):
            return np.asarray(self)[index]
        columns = [self.own[self.episode[index]], np.asarray(self.seen[index])]
        if self.codes is not None:
            columns.insert(1, np.eye(self.states, dtype=np.float32)[self.codes[index]])
        return np.concatenate(columns, axis=-1, dtype=self.dtype)
