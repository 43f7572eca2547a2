"""Whether episodes that follow each other in a log are alike, as those of one user are."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import group_of
from deadreckon.data.told import observation_names

_LEAST = 100  # episodes below which nothing is said
_ROWS = 20_000  # episodes that are looked at
_ALIKE, _ERRORS = 0.2, 5.0  # by which a rank correlation must be above 0: in itself, and in standard errors


def about_neighbours(log: Dataset) -> list[str]:
    """Advice on a log without a group column whose episodes begin like the episode before.

    Episodes of one user, machine or day are alike. A policy that is trained on some of them has an advantage on the others, so
    that its estimate is not valid for new users.
    """
    if log.episodes < _LEAST or len(log.spec.observation_shape) > 1 or group_of(log) is not None:
        return []
    first = np.asarray(log.observations[log.starts[:_ROWS]], np.float64)
    rank = np.stack([np.unique(column, return_inverse=True)[1].ravel() for column in first.T], 1).astype(np.float64)
    rank -= rank.mean(0)
    spread = np.square(rank).sum(0)
    moving = spread > 0
    alike = np.where(moving, (rank[1:] * rank[:-1]).sum(0) / np.where(moving, spread, 1.0), 0.0)
    which = int(np.argmax(alike))
    if alike[which] <= max(_ALIKE, _ERRORS / np.sqrt(len(first))):
        return []
    name = observation_names(log)[which]
    return [
        f"episodes begin like the episode before (correlation of {name}: {alike[which]:.2f}): if several are of one user, "
        "machine or day, name its column (--group), so that they are held out together; if conditions change slowly, hold out "
        "the latest episodes (--holdout-by time)"
    ]
