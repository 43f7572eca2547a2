"""Dates that only fall within episodes: rows that were written from the last to the first, with nothing to order them."""

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import as_dates, flat, is_missing, is_text, ordered_moments

_LEAST = 10  # falls below which nothing is told: by chance they have no rise among them with probability 2^-10


def backwards(table: pa.Table, columns: list[str], codes: np.ndarray) -> list[str]:
    """What to say of columns whose dates fall from row to row of an episode and never rise.

    Args:
        table: (rows,) of each column.
        columns: those that may hold dates.
        codes: (rows,) index of each row's episode, whose rows are taken in the order of the table.
    """
    told, found = [], {}
    for name in columns:
        kind = table.schema.field(name).type
        dates = as_dates(flat(table, name)) if pa.types.is_temporal(kind) or is_text(kind) else None
        if dates is not None and not is_missing(dates).any():
            found[name] = dates
    if not found:
        return []
    order = np.argsort(codes, kind="stable")
    inside = np.diff(codes[order]) == 0
    for name, dates in found.items():
        steps = np.diff(ordered_moments(dates)[order])[inside]
        if (falls := int((steps < 0).sum())) >= _LEAST and not (steps > 0).any():
            text = f"column {name} falls in {falls:,} of {len(steps):,} steps within episodes and never rises"
            told.append(f"{text}: rows are taken in the table's order, which may be the reverse (--time {name})")
    return told
