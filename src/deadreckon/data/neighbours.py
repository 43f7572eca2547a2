"""Whether episodes of a log are alike, as those of one user are, although no column tells which belong together."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import group_of
from deadreckon.data.told import observation_names
from deadreckon.stats.ranks import spearman
from deadreckon.stats.serial import ALIKE, ERRORS, LEAST, several

_ROWS = 20_000  # episodes that are looked at
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
    if found := _alike(log):
        which = max(found, key=lambda i: found[i])
        column = f"rank correlation of {observation_names(log)[which]}: {found[which]:.2f}"
        return [
            f"episodes begin like the episode before ({column}): if several are of one user, machine or day, {name}; if "
            "conditions change slowly, hold out the latest episodes (--holdout-by time)"
        ]
    _, often = np.unique(first, axis=0, return_counts=True)
    again = 1.0 - len(often) / len(first)
    if again > _AGAIN and len(often) >= LEAST and (first != np.floor(first)).any():
        return [f"{again:.0%} of the episodes begin exactly as an earlier one: if these are of one user or machine, {name}"]
    return []


def _alike(log: Dataset) -> dict[int, float]:
    """The numbers of an observation in which episodes begin like the episode before, and their rank correlations. There are
    none if there are few episodes, or if observations are images or a group column tells which belong together."""
    if (first := _first(log)) is None:
        return {}
    found = {i: spearman(column[:-1], column[1:]) for i, column in enumerate(first.T) if several(column)}
    return {i: one for i, one in found.items() if one > max(ALIKE, ERRORS / np.sqrt(len(first)))}


def in_order(log: Dataset) -> np.ndarray | None:
    """(n,) different episodes, in order, at most `_ROWS`; None if a group column tells which belong together."""
    return None if group_of(log) is not None else np.unique(origin(log))[:_ROWS]


def origin(log: Dataset) -> np.ndarray:
    """(episodes,) the first episode that each is a copy of; its own number if it is none."""
    if log.copied is None:
        return np.arange(log.episodes)
    _, first, label = np.unique(log.copied, return_index=True, return_inverse=True)
    return first[label.reshape(-1)]


def _first(log: Dataset) -> np.ndarray | None:
    """(n, numbers) first observations of different episodes; None for images and few episodes, and see `in_order`."""
    if len(log.spec.observation_shape) > 1 or not log.spec.observation_size or (episodes := in_order(log)) is None:
        return None
    if len(episodes) < LEAST:
        return None
    return np.asarray(log.observations[log.starts[episodes]], np.float64)
