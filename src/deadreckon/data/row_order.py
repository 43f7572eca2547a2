"""What speaks against the order in which the rows of an episode are taken."""

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import as_dates, decoded, flat, is_missing, is_text, ordered_moments
from deadreckon.data.schema import Schema

_FEWER = 4  # times that pieces of episodes are more than values of what each of them has one of
_LEAST = 10  # falls below which nothing is told: by chance they have no rise among them with probability 2^-10


def about_order(
    table: pa.Table, schema: Schema, codes: np.ndarray | None, moments: np.ndarray | None, order: np.ndarray | slice | None
) -> list[str]:
    """What to say of rows that may be in another order than they stand in.

    Args:
        table: (rows,) of each column.
        schema: of it.
        codes: (rows,) index of each row's episode; None: all rows are one.
        moments: (rows,) of each row; None: they are in order.
        order: in which the rows are taken; a slice where that is the table's.
    """
    time, episode = schema.one("time"), schema.one("episode")
    if time is not None:
        told = _past_midnight(table, time.name, np.zeros(table.num_rows, int) if codes is None else codes, order)
        if codes is None or moments is None or episode is None:
            return told
        others = schema.named("observation", "ignore", "keep", "group")
        return [*told, *_merged(table, episode.name, others, codes), *_by_names(episode.name, time.name, codes, moments)]
    if codes is None:
        return []
    left_out = schema.named("ignore", "keep")
    return [*_falling(table, left_out, codes), *_apart(table, [*schema.named("observation"), *left_out], codes)]


def _past_midnight(table: pa.Table, time: str, codes: np.ndarray, order: np.ndarray | slice | None) -> list[str]:
    """What to say of episodes that times of day, which have no date, put in another order than the table does."""
    if not pa.types.is_time(table.column(time).type) or not isinstance(order, np.ndarray):
        return []
    own = codes[order]
    changed = len(np.unique(own[1:][(own[1:] == own[:-1]) & (order[1:] < order[:-1])]))
    episodes = int(codes.max()) + 1
    which = "rows" if episodes == 1 else f"{changed:,} of {episodes:,} episodes"
    text = f"{which} are put in another order than the table's by {time}"
    how = f"give {time} with its date, or leave it out if the rows are in order"
    return [f"{text}, which has times of day without a date, as where one passes midnight: {how}"] if changed else []


def _merged(table: pa.Table, episode: str, columns: list[str], codes: np.ndarray) -> list[str]:
    """What to say of episodes that stand in several pieces, each with a value of a column, as a machine or a patient."""
    starts = np.append(0, np.flatnonzero(codes[1:] != codes[:-1]) + 1)
    episodes = int(codes.max()) + 1
    if len(starts) == episodes or 2 * len(starts) > len(codes):  # of rows in the order of time each is a piece
        return []
    for name in columns:
        values = flat(table, name, ignored=True)
        if not (pa.types.is_integer(values.type) or is_text(values.type)) or is_missing(values).any():
            continue
        found = decoded(values).dictionary_encode().indices.to_numpy()
        size = int(found.max()) + 1
        if size * _FEWER > len(starts) or (np.diff(found)[np.diff(codes) == 0] != 0).any():
            continue
        pairs = codes[starts] * size + found[starts]
        if len(np.unique(pairs)) == len(starts):
            text = f"{len(starts):,} pieces of rows have one value of {episode} and one of {name} each"
            return [f"{text}, and are read as {episodes:,} episodes: if each {name} counts its own, write both into one column"]
    return []


def _by_names(episode: str, time: str, codes: np.ndarray, moments: np.ndarray) -> list[str]:
    """What to say of episodes of which most begin at the same time and whose names have another order than the table."""
    first = np.full(int(codes.max()) + 1, moments.max())
    np.minimum.at(first, codes, moments)
    appeared = codes[np.sort(np.unique(codes, return_index=True)[1])]
    if 2 * len(np.unique(first)) > len(first) or (np.diff(appeared) > 0).all():
        return []
    text = f"most episodes begin at the same {time} and are put in the order of {episode}, which is not the table's"
    return [f"{text}: which are the latest is not known"]


def _apart(table: pa.Table, columns: list[str], codes: np.ndarray) -> list[str]:
    """What to say of episodes whose rows do not stand together, and of a column that seems to count their steps."""
    pieces, episodes = 1 + int((codes[1:] != codes[:-1]).sum()), int(codes.max()) + 1
    if pieces == episodes:
        return []
    text = f"rows of an episode are not together ({episodes:,} episodes in {pieces:,} pieces)"
    order = np.argsort(codes, kind="stable")
    inside = np.diff(codes[order]) == 0
    for name in columns:
        values = flat(table, name, ignored=True)
        if not pa.types.is_integer(values.type) or is_missing(values).any():
            continue
        steps = values.to_numpy(zero_copy_only=False)
        falls = steps[order][1:] < steps[order][:-1]
        ranked = steps[np.lexsort((steps, codes))]
        if (falls & inside).any() and (ranked[1:] - ranked[:-1] == 1)[inside].all():
            return [f"{text}, and column {name} counts their steps in another order: --time {name} puts them in order"]
    return [f"{text}: they are taken in the table's order (--time COLUMN orders them)"]


def about_dates(table: pa.Table, schema: Schema) -> list[str]:
    """What to say of a table whose order is that of the rows, as no column gives one, and not that of its dates."""
    steps = {name: np.diff(ordered_moments(dates)) for name, dates in _dates(table, schema.named("ignore", "keep")).items()}
    if not steps or any((each >= 0).all() for each in steps.values()):
        return []
    name, falls = max(((name, int((each < 0).sum())) for name, each in steps.items()), key=lambda each: each[1])
    if falls < _LEAST:
        return []
    text = f"rows are not in the order of {name}, which falls in {falls:,} of {table.num_rows - 1:,} steps"
    why = "changes along the log, and its latest part, are looked for in the table's order"
    return [f"{text}: if it says when rows were recorded, sort the table by it, the oldest row first, as {why}"]


def _dates(table: pa.Table, columns: list[str]) -> dict[str, pa.Array]:
    """Those of the columns that hold dates, without a missing one."""
    found = {}
    for name in columns:
        kind = table.schema.field(name).type
        dates = as_dates(flat(table, name)) if pa.types.is_temporal(kind) or is_text(kind) else None
        if dates is not None and not is_missing(dates).any():
            found[name] = dates
    return found


def _falling(table: pa.Table, columns: list[str], codes: np.ndarray) -> list[str]:
    """What to say of dates that fall from row to row of an episode and never rise."""
    told, found = [], _dates(table, columns)
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


def missing_steps(time: str, moments: np.ndarray, stops: np.ndarray, ends: np.ndarray | None) -> list[str]:
    """What to say of rows that seem to be missing, where `time` counts steps: whole numbers that mostly grow by one.

    Args:
        time: the column.
        moments: (rows,) of it, sorted.
        stops: (rows,) bool, after which a gap is none.
        ends: (rows,) bool, the last rows of episodes that a column tells apart; None where no column does.
    """
    steps = np.diff(moments)[~stops[:-1]]
    if not len(steps) or (moments != np.floor(moments)).any() or 2 * int((steps == 1).sum()) <= len(steps):
        return []
    told = []
    if gaps := int((steps > 1).sum()):
        told.append(f"{gaps} of {len(steps)} steps skip values of {time}; their rows are taken as following one another")
    if ends is not None:
        starts = moments[np.append(0, np.flatnonzero(ends)[:-1] + 1)]
        values, counts = np.unique(starts, return_counts=True)
        usual = values[np.argmax(counts)]
        # Where time runs on through all episodes, no start is usual, and none is late.
        if 2 * counts.max() > len(starts) and (late := int((starts > usual).sum())):
            text = f"{late} of {len(starts)} episodes start after {time} {usual:g}, where most do"
            told.append(f"{text}; their first rows are taken as starts")
    return told
