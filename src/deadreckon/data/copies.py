"""Advice on rows that repeat earlier ones; see `data.repeats`."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.repeats import SHARE, Copies, copied
from deadreckon.data.split import group_of


def copies(log: Dataset, rows: int) -> Copies:
    """Rows among the first `rows` that repeat an earlier one (observation, action and reward)."""
    parts = [np.ascontiguousarray(column[:rows]).reshape(rows, -1).view(np.uint8).reshape(rows, -1)
             for column in (log.observations, log.actions, log.rewards)]  # fmt: skip
    packed = np.ascontiguousarray(np.concatenate(parts, 1))
    _, first, which = np.unique(
        packed.view(np.dtype((np.void, packed.shape[1]))).ravel(), return_index=True, return_inverse=True
    )
    return Copies.of(first[which.ravel()])


def about_copies(log: Dataset, found: Copies, rows: int) -> list[str]:
    """Advice on copies, if there are many.

    Where each row is an episode, equal rows may be people of whom the same is known; they are told if they are copies
    (`data.repeats.copied`).

    Args:
        log: the log.
        found: copies among the rows.
        rows: that were looked at.
    """
    if found.many <= SHARE * rows:
        return []
    text = f"{found.many:,} of {rows:,} rows repeat an earlier one"
    advice = "leave the copies out"
    whole = copied(log) is not None
    if whole and group_of(log) is None:
        advice += "; until then, equal episodes are held out together and counted as one"
    if found.in_order:
        return [f"{text}, in the same order: if a part of the table was stored twice, {advice}"]
    if log.lengths.max() > 1:
        return [f"{text}: {advice if whole else 'a split by rows would leak; split by episodes'}"]
    if whole:
        return [f"{text} completely, although nearly all others differ: if the table was stored twice, {advice}"]
    return []
