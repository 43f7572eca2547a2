"""Which episodes of a log policies have learned from. What counts are the numbers of episodes, never names of logs or files."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.data.dataset import Dataset


def seen(taught: np.ndarray, log: Dataset) -> np.ndarray:
    """(episodes,) bool: the episode is among those that a policy has learned from.

    Args:
        taught: uint64 `episode_ids` that it has learned from, in any order.
        log: any log, whole or a part.
    """
    return np.isin(log.episode_ids, taught)


@dataclass(frozen=True)
class Seen:
    """What some policies have seen of a log.

    Attributes:
        unseen: (episodes,) bool: no policy of which it is known has learned from the episode.
        unknown: which policies nobody knows it of: files from before it was noted, or from elsewhere, or functions.
    """

    unseen: np.ndarray
    unknown: tuple[int, ...]

    @classmethod
    def of(cls, taught: Sequence[np.ndarray | None], log: Dataset) -> "Seen":
        """Of policies that have learned from these episodes each; None where that is not known."""
        known = {each.tobytes(): each for each in taught if each is not None}  # the seeds of a run share theirs
        unseen = np.ones(log.episodes, bool)
        for each in known.values():
            unseen &= ~seen(each, log)
        return cls(unseen, tuple(i for i, each in enumerate(taught) if each is None))
