"""Advice on rows that repeat earlier ones; see `data.repeats`."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.repeats import SHARE, Copies, first_equal
from deadreckon.data.split import group_of


def copies(log: Dataset, rows: int) -> Copies:
    """Rows among the first `rows` that repeat an earlier one (observation, action and reward); of a log of single steps whose
    episodes are copies, all of it is looked at."""
    if log.copied is not None and log.episodes == len(log):
        return Copies.of(np.unique(log.copied, return_index=True)[1][log.copied])
    return Copies.of(first_equal(log.observations[:rows], log.actions[:rows], log.rewards[:rows]))


def about_copies(log: Dataset, found: Copies, rows: int) -> list[str]:
    """Advice on copies, if there are many.

    Where each row is an episode, equal rows may be people of whom the same is known; they are told if they are copies
    (`data.repeats.copied`).

    Args:
        log: the log.
        found: copies among the rows.
        rows: that were looked at.
    """
    whole = log.copied is not None
    rows = len(log) if whole and log.episodes == len(log) else rows
    if found.many <= SHARE * rows:
        return []
    text = f"{found.many:,} of {rows:,} rows repeat an earlier one"
    advice = "leave the copies out"
    if whole and group_of(log) is None and not isinstance(log.observations, np.memmap):
        advice += "; until then, equal episodes are held out together and counted as one"
    if found.in_order:
        return [f"{text}, in the same order: if a part of the table was stored twice, {advice}"]
    if log.lengths.max() > 1:
        return [f"{text}: {advice if whole else 'a split by rows would leak; split by episodes'}"]
    if whole:
        return [f"{text} completely, although nearly all others differ: if the table was stored twice, {advice}"]
    return []
