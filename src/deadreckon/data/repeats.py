"""Episodes that repeat earlier ones, as where a table was stored twice or a join repeated its rows.

Copies in training and in held-out episodes make a policy look better than it is, and copies that are counted as independent
make intervals too narrow. Episodes that are copies of each other are therefore one cluster.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deadreckon.data.spec import Box

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset

SHARE = 0.01  # of the rows or episodes, up to which copies are neglected
_STRETCH, _TOGETHER = 20, 0.5  # so many copies, and such a share of them, follow each other where a part was stored twice
_OFTEN = 4  # more copies of each, on average, follow each other where few different rows repeat by themselves
_LEAST, _OWN = 20, 0.9  # so many different episodes at least, and such a share of them, differ in what tells episodes apart
_SHARED = 0.5  # most of the different episodes that share it, for each copy


class Copies(NamedTuple):
    """Rows or episodes that repeat an earlier one.

    Attributes:
        many: how many.
        different: of how many.
        together: share of them that follow another one as the rows that they repeat follow each other.
    """

    many: int
    different: int
    together: float

    @classmethod
    def of(cls, first: np.ndarray) -> "Copies":
        """The copies among n things, of each of which the first that is equal is given: (n,) indices."""
        again = first < np.arange(len(first))
        together = again[1:] & again[:-1] & (first[1:] == first[:-1] + 1)
        return cls(int(again.sum()), len(np.unique(first[again])), float(together.sum() / max(again.sum(), 1)))

    @property
    def in_order(self) -> bool:
        """Whether they come in stretches, as where a part was stored twice, and not as where few contexts take turns."""
        return self.many >= _STRETCH and self.together >= _TOGETHER and self.many <= _OFTEN * self.different


def first_equal(*columns: np.ndarray) -> np.ndarray:
    """(rows,) index of the first row that is equal in all of these (rows, ...) columns."""
    rows = len(columns[0])
    plain = (np.ascontiguousarray(each) + np.zeros((), each.dtype) for each in columns)  # -0.0 is 0.0
    parts = [each.reshape(rows, -1).view(np.uint8).reshape(rows, -1) for each in plain]
    packed = np.ascontiguousarray(np.concatenate(parts, 1))
    whole = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first, which = np.unique(whole, return_index=True, return_inverse=True)
    return first[which.ravel()]


def copied(log: "Dataset") -> np.ndarray | None:
    """(episodes,) number 0, 1, ... of each episode, the same for copies of one; None if there are none or hardly any.

    Equal episodes are copies if they come in stretches, or if no other episode has their last observation (or its reward or
    continuous action, if these have decimals), and hardly any different episodes share one. Others may be equal by chance, as
    where little is known of a context, or where cells were empty. Episodes that this package collected are never copies.
    """
    _, first, which = np.unique(log.episode_contents, return_index=True, return_inverse=True)
    first = first[which.ravel()]  # (episodes,) the first that is equal
    found = Copies.of(first)
    if found.many <= SHARE * log.episodes or log.provenance.source == "collected":
        return None
    if not found.in_order:
        every = np.arange(log.episodes)
        once = every[first == every]
        own = np.zeros(log.episodes, bool)
        own[once] = _alone(log, once, found.many)
        first = np.where(own[first], first, every)
        if Copies.of(first).many <= SHARE * log.episodes:
            return None
    return np.unique(first, return_inverse=True)[1].ravel()


def _alone(log: "Dataset", episodes: np.ndarray, many: int) -> np.ndarray:
    """(n,) bool: which of these different episodes have something for themselves that nearly all of them do.

    Where an observation comes again by itself, the actions and rewards of some of its episodes differ. So there must be fewer
    of these than `many`, the number of copies.
    """
    if len(episodes) < _LEAST:
        return np.zeros(len(episodes), bool)
    rows = log.ends[episodes]
    reward = np.asarray(log.rewards[rows])
    keys = [np.asarray(log.observations[rows])]
    if isinstance(log.action_space, Box):
        keys += [each for each in np.asarray(log.actions[rows]).reshape(len(rows), -1).T if _decimals(each)]
    keys += [reward] if _decimals(reward) else []
    for values in keys:
        _, which, often = np.unique(first_equal(values), return_inverse=True, return_counts=True)
        if len(often) >= _OWN * len(episodes) and (often > 1)[which].sum() <= _SHARED * many:
            return often[which] == 1
    return np.zeros(len(episodes), bool)


def _decimals(values: np.ndarray) -> bool:
    return bool((values != np.floor(values)).any())
