"""Which episodes of a log policies were trained on, by the contents of episodes and never by names of logs or files."""

from collections.abc import Sequence

import numpy as np

from deadreckon.data.dataset import Dataset


def seen(taught: np.ndarray, log: Dataset) -> np.ndarray:
    """(episodes,) bool: whether a policy was trained on the episode.

    Args:
        taught: uint64 `episode_ids` of its training episodes, in any order.
        log: any log, whole or a part.
    """
    return np.isin(log.episode_ids, taught)


def unseen_by(taught: Sequence[np.ndarray | None], log: Dataset) -> np.ndarray:
    """(episodes,) bool: whether no policy whose training episodes are known was trained on the episode.

    Args:
        taught: as in `seen`, of each policy; None where they are not known.
        log: any log, whole or a part.
    """
    known = {each.tobytes(): each for each in taught if each is not None}  # the seeds of a run share theirs
    unseen = np.ones(log.episodes, bool)
    for each in known.values():
        unseen &= ~seen(each, log)
    return unseen
