"""Rows that repeat earlier ones, which put the same row into what is learned from and what is held out."""

from typing import NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.told import observation_names

_SHARE = 0.01  # of the rows, above which copies are told
_STRETCH, _TOGETHER = 20, 0.5  # so many copies, and such a share of them, follow each other where a part was stored twice
_ADVICE = "leave the copies out, else held-out rows are used for training"
_OWN = 0.9  # of the rows that are no copies: so many have a value of their own in a column that tells rows apart


class Copies(NamedTuple):
    """Rows that repeat an earlier one.

    Attributes:
        many: how many.
        together: share of them that follow another one as the rows that they repeat follow each other.
    """

    many: int
    together: float


def copies(log: Dataset, rows: int) -> Copies:
    """Rows among the first `rows` that repeat an earlier one (observation, action and reward)."""
    parts = [np.ascontiguousarray(column[:rows]).reshape(rows, -1).view(np.uint8).reshape(rows, -1)
             for column in (log.observations, log.actions, log.rewards)]  # fmt: skip
    packed = np.ascontiguousarray(np.concatenate(parts, 1))
    _, first, which = np.unique(
        packed.view(np.dtype((np.void, packed.shape[1]))).ravel(), return_index=True, return_inverse=True
    )
    before = first[which.ravel()]  # the first row that is equal
    again = before < np.arange(rows)
    together = again[1:] & again[:-1] & (before[1:] == before[:-1] + 1)
    return Copies(int(again.sum()), float(together.sum() / max(again.sum(), 1)))


def about_copies(log: Dataset, found: Copies, rows: int) -> list[str]:
    """Advice on copies, if there are many.

    Where each row is an episode, equal rows may be people of whom the same is known. They are told if they come in stretches,
    as where a table was stored twice, or if a column tells rows apart: numbers with decimals that hardly any two rows share,
    but for the copies.

    Args:
        log: the log.
        found: copies among the rows.
        rows: that were looked at.
    """
    if found.many <= _SHARE * rows:
        return []
    text = f"{found.many:,} of {rows:,} rows repeat an earlier one"
    if found.many >= _STRETCH and found.together >= _TOGETHER:
        return [f"{text}, in the same order: if a part of the table was stored twice, {_ADVICE}"]
    if log.lengths.max() > 1:
        return [f"{text}: a split by rows would leak; split by episodes"]
    flat = np.asarray(log.observations[:rows]).reshape(rows, -1)
    for name, values in zip(observation_names(log), flat.T):
        kinds = np.unique(values)
        if len(kinds) >= _OWN * (rows - found.many) and (kinds != np.floor(kinds)).any():
            text = f"{text} completely, although nearly all others differ in {name}"
            return [f"{text}: if the table was stored twice, {_ADVICE}"]
    return []
