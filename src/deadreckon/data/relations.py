"""How two columns are the same but for names, units and rounding."""

import math
from typing import NamedTuple

import numpy as np

LEAST = 20  # rows below which nothing is said
FEW = 64  # rows compared first
_EXACT, _CLOSE = 1e-5, 1e-3  # of a standard deviation: what float32 leaves of an exact linear relation, usually and at most
_ROUGH = 0.02  # of a standard deviation: the coarsest rounding through which a linear relation is seen
_DECIMALS = range(7)  # to which a column may have been rounded


def relation(values: np.ndarray, other: np.ndarray, level: float, ordered: bool) -> str:
    """How two columns are the same but for names and units, or an empty text.

    They are if a line leads from one to the other, exactly or but for the decimals that one is rounded to, or each value of one
    stands beside one value of the other (for `ordered`, rising or falling together), and a random order of rows gives this with
    probability `level` at most. Nothing is said of fewer than `LEAST` rows.

    Args:
        values: (rows,) of a column.
        other: (rows,) to be told by it.
        level: probability of a relation that is told where there is none.
        ordered: whether the order of the values counts.
    """
    if len(values) < LEAST:
        return ""
    few = np.linspace(0, len(values) - 1, min(FEW, len(values))).astype(int)
    paired = _paired(values[few], other[few], ordered)  # spares the sorting of all rows, of nearly all pairs of columns
    if not paired and not (ordered and _line(values[few], other[few])):
        return ""
    kinds, counts = np.unique(other, return_counts=True)
    if len(kinds) < 2:
        return ""
    # Of all orders of the rows, n! / prod(counts!) differ.
    sizes, times = np.unique(counts, return_counts=True)
    within = sum(many * math.lgamma(size + 1) for size, many in zip(sizes.tolist(), times.tolist()))
    arrangements = math.lgamma(len(other) + 1) - within
    likely = math.log(level) + arrangements  # logarithm of the most orders that may give a relation
    if ordered and (line := _line(values, other)):
        # Two lines, and of rounded values each may have stood at any value as near as the rounding is coarse.
        near = _most_within(kinds, 2 * line.unit) if line.unit else 1
        if math.log(2) + len(other) * math.log(near) <= likely:
            return line.words
    # The other relation, in both directions or in all labellings.
    ways = math.log(2) if ordered else math.lgamma(min(len(kinds), 170) + 1)
    return f"one value for each of its {len(kinds):,} values" if ways <= likely and _paired(values, other, ordered) else ""


class _Line(NamedTuple):
    """A line from one column to another: how it is told, and the unit that the other is rounded to; 0 where it is not."""

    words: str
    unit: float


def _line(values: np.ndarray, other: np.ndarray) -> _Line | None:
    """The line that leads from one column to the other in all rows, or None."""
    x, y = values.astype(np.float64), other.astype(np.float64)
    if x.std() == 0 or y.std() == 0:
        return None
    slope = float(((x - x.mean()) * (y - y.mean())).mean() / x.var())
    shift = float(y.mean() - slope * x.mean())
    # Columns are float32: a large offset or a small slope leaves less of an exact relation than numbers around 0 do.
    left = float(np.finfo(np.float32).eps) * (abs(slope) * np.abs(x).max() + np.abs(y).max())
    exact, off = min(_EXACT * y.std() + left, _CLOSE * y.std()), float(np.abs(y - slope * x - shift).max())
    words = f"{slope:.4g} times it" + ("" if abs(shift) <= exact else f" {'-' if shift < 0 else '+'} {abs(shift):.4g}")
    if off <= exact:
        return _Line("equal to it" if abs(slope - 1) < _EXACT and abs(shift) <= exact else words, 0.0)
    # Of either column, what rounding it to the decimals that it has can move the other by.
    for column, factor in ((y, 1.0), (x, abs(slope))):
        unit = _unit(column) * factor
        if 0 < unit <= _ROUGH * y.std() and off <= unit + exact:
            return _Line(f"{words}, rounded", unit)
    return None


def _unit(column: np.ndarray) -> float:
    """The last decimal that a column has, such as 0.01; 0 where it has more than are looked at."""
    for decimals in _DECIMALS:
        if np.abs(column - np.round(column, decimals)).max() <= 1e-6 * max(float(np.abs(column).max()), 10.0**-decimals):
            return 10.0**-decimals
    return 0.0


def _most_within(kinds: np.ndarray, width: float) -> int:
    """The largest number of sorted values in an interval of a width to both sides of one of them."""
    above = np.searchsorted(kinds, kinds + width, side="right")
    below = np.searchsorted(kinds, kinds - width, side="left")
    return int((above - below).max())


def _paired(values: np.ndarray, other: np.ndarray, ordered: bool) -> bool:
    """Whether each value of one column stands beside one value of the other, rising or falling together if `ordered`."""
    kinds, codes = np.unique(other, return_inverse=True)
    of, own = np.unique(values, return_inverse=True)
    if len(of) != len(kinds):
        return False
    pairs = np.zeros(len(of), int)
    pairs[own] = codes
    if (pairs[own] != codes).any() or len(np.unique(pairs)) != len(kinds):
        return False
    return not ordered or bool((np.diff(pairs) > 0).all() or (np.diff(pairs) < 0).all())
