"""Divides episodes into training and held-out ones: whole episodes, or whole clusters of them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deadreckon.data.scratch import BLOCK
from deadreckon.errors import UserError, unknown

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset

RANDOM, TIME = "random", "time"


class Parts(NamedTuple):
    """Two disjoint parts of a log, which together have all its episodes.

    Attributes:
        learning: (learning,) indices of training episodes, ascending.
        held: (held,) indices of episodes that are held out, ascending.
    """

    learning: np.ndarray
    held: np.ndarray


@dataclass(frozen=True)
class Holdout:
    """Episodes that are held out from training, so that policies can be evaluated on them.

    Attributes:
        share: of the episodes, between 0 and 1.
        by: "random", "time" (the latest: rows are in the order of time), or a column of the log's extras, such as a user or a
            site, each value of which is held out as a whole or not at all. Without a column, copies of an episode are held out
            together.
        seed: of the draw.
    """

    share: float = 0.2
    by: str = RANDOM
    seed: int = 0

    def parts(self, log: "Dataset") -> Parts:
        """The training episodes and the held-out episodes of `log`.

        Raises:
            UserError: a share that is not between 0 and 1, fewer than two episodes or clusters, or a column that is unknown or
                changes within an episode.
        """
        if not 0 < self.share < 1:
            raise UserError(f"the share held out must lie between 0 and 1, got {self.share}")
        cluster = clusters(log, self.by)
        _enough(log, cluster, self.by, 2)
        sizes = np.bincount(cluster)
        if self.by == TIME:
            held = np.isin(cluster, self._latest(cluster, sizes))
        elif self.by == RANDOM and len(sizes) == log.episodes:
            order = np.random.default_rng(self.seed).permutation(log.episodes)
            held = np.isin(cluster, order[min(max(round((1 - self.share) * log.episodes), 1), log.episodes - 1) :])
        else:
            held = np.isin(cluster, self._drawn(sizes))
        return Parts(np.flatnonzero(~held), np.flatnonzero(held))

    def told(self) -> dict[str, Any]:
        """As JSON values."""
        return {"share": self.share, "by": self.by, "seed": self.seed}

    def _latest(self, cluster: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """The clusters that end latest, as many as bring their episodes nearest to the share; one at least, never all."""
        order = _latest_last(cluster)
        learning = np.cumsum(sizes[order])[:-1]  # episodes of the first one, two, ... clusters
        return order[int(np.argmin(np.abs(learning - round((1 - self.share) * len(cluster))))) + 1 :]

    def _drawn(self, sizes: np.ndarray) -> list[int]:
        """Clusters in random order, each taken if that brings their episodes nearer to the share; one at least, never all."""
        order, wanted = np.random.default_rng(self.seed).permutation(len(sizes)), self.share * sizes.sum()
        taken: list[int] = []
        count = 0
        for each in order:
            if len(taken) + 1 < len(sizes) and abs(count + sizes[each] - wanted) < abs(count - wanted):
                taken.append(int(each))
                count += sizes[each]
        return taken or [int(order[np.argmin(sizes[order])])]


@dataclass(frozen=True)
class Fold:
    """One part of several that are held out in turn, used like a `Holdout`.

    Attributes:
        fold: which, 0 .. folds - 1.
        folds: number of folds.
        by: see `Holdout`.
        seed: of the draw.
    """

    fold: int
    folds: int = 5
    by: str = RANDOM
    seed: int = 0

    def parts(self, log: "Dataset") -> Parts:
        """The episodes of all other folds, and those of this one; errors as of `folds`."""
        held = folds(log, self.folds, self.by, self.seed) == self.fold
        return Parts(np.flatnonzero(~held), np.flatnonzero(held))

    def told(self) -> dict[str, Any]:
        """As JSON values."""
        return {"share": 1 / self.folds, "by": self.by, "seed": self.seed, "fold": self.fold, "folds": self.folds}


def group_of(log: "Dataset") -> str | None:
    """The extra column, such as a user, whose values define which episodes belong together; None if there is none."""
    found = log.provenance.extra.get("group")
    return found if found in log.extras else None


def clusters(log: "Dataset", by: str = RANDOM) -> np.ndarray:
    """(episodes,) number 0, 1, ... of the cluster that each episode belongs to: for "random" and "time" its own, or that of its
    copies (`Dataset.copied`), else one for each value of the column `by`.

    Raises:
        UserError: the log has no such column, or it changes within an episode; or the latest episodes of a memory-mapped log
            have copies, so that both parts would be copied into memory.
    """
    if by not in (RANDOM, TIME):
        return groups(log, by)[1]
    if (found := log.copied) is None:
        return np.arange(log.episodes)
    if by == TIME and isinstance(log.observations, np.memmap):
        told = f"{log.name}: {log.episodes - len(np.unique(found)):,} of {log.episodes:,} episodes repeat an earlier one"
        raise UserError(f"{told}, and the latest of a memory-mapped log are not held out with copies; leave the copies out")
    return found


def units_of(log: "Dataset") -> np.ndarray:
    """(episodes,) number of the independent unit that each episode belongs to: of its cluster by the log's group, or its own.

    Raises:
        UserError: the group's column changes within an episode.
    """
    return clusters(log, group_of(log) or RANDOM)


def units_in_words(log: "Dataset", by: str) -> str:
    """What the clusters of a log by `by` are, for messages."""
    if by not in (RANDOM, TIME):
        return f"values of {by}"
    return "episodes" if len(np.unique(clusters(log, by))) == log.episodes else "different episodes"


def groups(log: "Dataset", by: str) -> tuple[np.ndarray, np.ndarray]:
    """The values of a column that has one per episode, and (episodes,) the number of each episode's; see `clusters`."""
    columns = {name: column for name, column in log.extras.items() if column.size == len(log)}
    if by not in columns:
        known = unknown("column", by, columns) if columns else f"unknown column {by!r}"
        raise UserError(f"{log.name}: {known}; columns of a table are known if it was read with --keep {by}")
    column = columns[by].reshape(-1)
    first = np.asarray(column[log.starts])
    for start in range(0, len(log), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(log)))
        episodes = log.episode_at(rows)
        changed = np.flatnonzero(column[rows] != first[episodes])
        if len(changed):
            row, episode = int(rows[changed[0]]), int(episodes[changed[0]])
            told = f"{first[episode]} in row {log.starts[episode]} and {column[row]} in row {row}"
            text = f"column {by} changes within episode {episode} ({told})"
            raise UserError(f"{log.name}: {text}; one value per episode is needed")
    values, codes = np.unique(first, return_inverse=True)
    return values, codes


def folds(log: "Dataset", k: int, by: str = RANDOM, seed: int = 0) -> np.ndarray:
    """(episodes,) fold 0 .. k - 1 of each episode, about as many in each: at random, in stretches of time, or whole clusters.

    Raises:
        UserError: fewer than two folds, or fewer episodes or clusters than folds; see also `clusters`.
    """
    if k < 2:
        raise UserError(f"at least 2 folds are needed, got {k}")
    cluster = clusters(log, by)
    _enough(log, cluster, by, k)
    sizes = np.bincount(cluster)
    if by == TIME:
        order, fold = _latest_last(cluster), np.empty(len(sizes), np.int64)
        fold[order] = (np.cumsum(sizes[order]) - sizes[order]) * k // log.episodes
        if len(np.unique(fold)) < k:  # one episode has very many copies
            fold[order] = np.arange(len(sizes)) * k // len(sizes)
        return fold[cluster]
    rng = np.random.default_rng(seed)
    if by == RANDOM and len(sizes) == log.episodes:
        return rng.permutation(np.arange(log.episodes) % k)
    order = rng.permutation(len(sizes))
    fold, filled = np.empty(len(sizes), np.int64), np.zeros(k, np.int64)
    for each in order[np.argsort(-sizes[order], kind="stable")]:  # the largest first, each to where fewest are
        fold[each] = np.argmin(filled)
        filled[fold[each]] += sizes[each]
    return fold[cluster]


def _latest_last(cluster: np.ndarray) -> np.ndarray:
    """Clusters in the order of their last episodes."""
    last = np.zeros(int(cluster.max()) + 1, np.int64)
    np.maximum.at(last, cluster, np.arange(len(cluster)))
    return np.argsort(last)


def _enough(log: "Dataset", cluster: np.ndarray, by: str, needed: int) -> None:
    count = int(cluster.max()) + 1
    if count < needed:
        raise UserError(f"{log.name}: {count} {units_in_words(log, by)}, at least {needed} are needed to hold some out")
