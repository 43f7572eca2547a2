"""Whether episodes of a log are alike, as those of one user are, although no column tells which belong together."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import group_of
from deadreckon.data.told import observation_names
from deadreckon.stats.ranks import spearman

_LEAST = 100  # episodes below which nothing is said
_ROWS = 20_000  # episodes that are looked at
_ALIKE, _ERRORS = 0.2, 5.0  # by which a rank correlation must be above 0: in itself, and in standard errors
_RARE = 0.98  # probability that two values are equal, from which on a column has too few others
_AGAIN = 0.2  # share of the episodes that begin with the observation of an earlier one


def about_neighbours(log: Dataset) -> list[str]:
    """Advice on a log without a group column whose episodes begin like the episode before, or, if observations have decimals,
    exactly as earlier ones.

    Episodes of one user, machine or day are alike. A policy that is trained on some of them has an advantage on the others, so
    that its estimate is not valid for new users.
    """
    if (first := _first(log)) is None:
        return []
    name = "name its column (--group), so that they are held out together"
    if found := alike(log):
        which = max(found, key=lambda i: found[i])
        column = f"rank correlation of {observation_names(log)[which]}: {found[which]:.2f}"
        return [
            f"episodes begin like the episode before ({column}): if several are of one user, machine or day, {name}; if "
            "conditions change slowly, hold out the latest episodes (--holdout-by time)"
        ]
    _, often = np.unique(first, axis=0, return_counts=True)
    again = 1.0 - len(often) / len(first)
    if again > _AGAIN and len(often) >= _LEAST and (first != np.floor(first)).any():
        return [f"{again:.0%} of the episodes begin exactly as an earlier one: if these are of one user or machine, {name}"]
    return []


def alike(log: Dataset) -> dict[int, float]:
    """The numbers of an observation in which episodes begin like the episode before, and their rank correlations. There are
    none if there are few episodes, or if observations are images or a group column tells which belong together."""
    if (first := _first(log)) is None:
        return {}
    found = {i: spearman(column[:-1], column[1:]) for i, column in enumerate(first.T) if _several(column)}
    return {i: one for i, one in found.items() if one > max(_ALIKE, _ERRORS / np.sqrt(len(first)))}


def _first(log: Dataset) -> np.ndarray | None:
    """(n, numbers) first observations of different episodes; None for images, few episodes, and logs with a group column."""
    if len(log.spec.observation_shape) > 1 or not log.spec.observation_size or group_of(log) is not None:
        return None
    different = np.arange(log.episodes) if log.copied is None else np.sort(np.unique(log.copied, return_index=True)[1])
    rows = log.starts[different[:_ROWS]]
    return None if len(rows) < _LEAST else np.asarray(log.observations[rows], np.float64)


def _several(column: np.ndarray) -> bool:
    """Whether a column has enough different values for a correlation: of a rare one, two rows that are alike suffice."""
    shares = np.unique(column, return_counts=True)[1] / len(column)
    return bool(np.square(shares).sum() <= _RARE)
