"""Which episodes of a log policies were trained on, by the contents of episodes and never by names of logs or files."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.data.dataset import Dataset


def seen(taught: np.ndarray, log: Dataset) -> np.ndarray:
    """(episodes,) bool: whether a policy was trained on the episode.

    Args:
        taught: uint64 `episode_ids` of its training episodes, in any order.
        log: any log, whole or a part.
    """
    return np.isin(log.episode_ids, taught)


@dataclass(frozen=True)
class Seen:
    """Which episodes of a log some policies were trained on.

    Attributes:
        unseen: (episodes,) bool: no policy whose training episodes are known was trained on the episode.
        unknown: indices of policies whose training episodes are not known: files of older versions or from elsewhere, and
            functions.
    """

    unseen: np.ndarray
    unknown: tuple[int, ...]

    @classmethod
    def of(cls, taught: Sequence[np.ndarray | None], log: Dataset) -> "Seen":
        """For policies with these training episodes each; None where they are not known."""
        known = {each.tobytes(): each for each in taught if each is not None}  # the seeds of a run share theirs
        unseen = np.ones(log.episodes, bool)
        for each in known.values():
            unseen &= ~seen(each, log)
        return cls(unseen, tuple(i for i, each in enumerate(taught) if each is None))
