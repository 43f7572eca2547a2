"""Rows that repeat earlier ones, which put the same row into what is learned from and what is held out."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.told import observation_names

_SHARE = 0.01  # of the rows, above which copies are told
_OWN = 0.9  # of the rows that are no copies: so many have a value of their own in a column that tells rows apart


def copies(log: Dataset, rows: int) -> int:
    """Rows among the first `rows` that repeat an earlier one (observation, action and reward)."""
    parts = [np.ascontiguousarray(column[:rows]).reshape(rows, -1).view(np.uint8).reshape(rows, -1)
             for column in (log.observations, log.actions, log.rewards)]  # fmt: skip
    packed = np.ascontiguousarray(np.concatenate(parts, 1))
    return rows - len(np.unique(packed.view(np.dtype((np.void, packed.shape[1]))).ravel()))


def about_copies(log: Dataset, found: int, rows: int) -> list[str]:
    """Advice on copies, if there are many.

    Where each row is an episode, equal rows may be people of whom the same is known, so they are told only if a column tells
    rows apart: numbers with decimals that hardly any two rows share, but for the copies.

    Args:
        log: the log.
        found: number of `copies`.
        rows: among so many.
    """
    if found <= _SHARE * rows:
        return []
    text = f"{found:,} of {rows:,} rows repeat an earlier one"
    if log.lengths.max() > 1:
        return [f"{text}: a split by rows would leak; split by episodes"]
    flat = np.asarray(log.observations[:rows]).reshape(rows, -1)
    for name, values in zip(observation_names(log), flat.T):
        kinds = np.unique(values)
        if len(kinds) >= _OWN * (rows - found) and (kinds != np.floor(kinds)).any():
            text = f"{text} completely, although nearly all others differ in {name}: if the table was stored twice"
            return [f"{text}, leave the copies out, or held-out rows are learned from"]
    return []
