"""An interval of a mean that is valid after every sample at once: a confidence sequence (Waudby-Smith and Ramdas 2024).

The capital of `stats.betting`, multiplied in the order of the samples, is a nonnegative martingale if the mean is m. It *ever*
reaches 1 / alpha with a probability of at most alpha (Ville), so every m that was rejected after any number of samples stays
rejected, and looking after each of them does not raise the error rate.

The lower end assumes that no sample lies below `low`, the upper one that none lies above `high`, and both that each sample has
the mean mu given those before it, as independent ones have. Once a sample lies beyond a bound, the end that depends on this
bound is infinite.
"""

from typing import NamedTuple

import numpy as np

from deadreckon.errors import UserError
from deadreckon.stats.betting import FRACTIONS, lower
from deadreckon.stats.interval import ALPHA

ROUNDING = 1e-9  # rounding errors, as a share of the range
POINTS = 12  # most sample sizes at which the ends are computed


class ConfidenceSequence(NamedTuple):
    """Ends after growing numbers of samples; all hold at once with a probability of at least 1 - alpha.

    Attributes:
        counts: (points,) numbers of samples.
        means: (points,) means of the first so many samples.
        low, high: (points,) ends; infinite where a sample lay beyond the bound.
    """

    counts: np.ndarray
    means: np.ndarray
    low: np.ndarray
    high: np.ndarray


def confidence_sequence(x: np.ndarray, bounds: tuple[float, float], alpha: float = ALPHA) -> ConfidenceSequence:
    """The ends after growing numbers of samples, the last of which is of all samples; each end has the level 1 - alpha / 2.

    Args:
        x: (n,) samples in the order in which they came.
        bounds: least and greatest value that a sample can have, known without looking at these samples.
        alpha: probability that an end is ever wrong.

    Raises:
        UserError: no samples, samples that are not finite, or bounds that are not a range.
    """
    x = np.asarray(x, float)
    low, high = bounds
    if not len(x) or not np.isfinite(x).all():
        raise UserError("a confidence sequence needs finite samples, at least one")
    if not (np.isfinite(bounds).all() and low < high):
        raise UserError(f"a confidence sequence needs a finite range, least before greatest, got {low} .. {high}")
    counts = np.unique(np.geomspace(1, len(x), POINTS).round().astype(int))
    below = _lower(x - low, counts, alpha / 2)
    above = _lower(high - x, counts, alpha / 2)
    # Rejected means stay rejected: ends only move inwards, unless a sample lies beyond the bound that they depend on.
    below = np.where(np.isneginf(below), below, low + np.maximum.accumulate(below))
    above = np.where(np.isneginf(above), np.inf, high - np.maximum.accumulate(above))
    return ConfidenceSequence(counts, np.cumsum(x)[counts - 1] / counts, below, above)


def refuted_at(x: np.ndarray, bounds: tuple[float, float], least: float, alpha: float = ALPHA) -> int | None:
    """Number of samples after which the hypothesis that the mean is at least `least` was rejected; None if it was not.

    Unlike the ends of `confidence_sequence` this tests after every sample. A sample above the upper bound ends the tests: an
    earlier rejection stays valid, and there is none afterwards.

    Args:
        x: (n,) samples in the order in which they came.
        bounds: see `confidence_sequence`.
        least: the smallest acceptable mean.
        alpha: probability that it is ever rejected although the mean is that large.
    """
    high, x = bounds[1], np.asarray(x, float)
    beyond = np.flatnonzero(x > high)
    known = x[: beyond[0]] if len(beyond) else x
    if least >= high:  # no mean within the range is, unless all samples lie at its upper end
        slack = ROUNDING * (high - bounds[0])
        short = np.flatnonzero((known < high - slack) | (least > high + slack))
        return int(short[0]) + 1 if len(short) else None
    over = np.flatnonzero(_capital(high - known, high - least) >= np.log(1 / alpha))
    return int(over[0]) + 1 if len(over) else None


def _capital(x: np.ndarray, mean: float) -> np.ndarray:
    """(n,) log of the mixture's capital after each of (n,) samples that are not negative, if their mean is at most `mean`."""
    total = np.full(len(x), -np.inf)
    scaled = x / mean - 1.0
    for fraction in FRACTIONS:
        total = np.logaddexp(total, np.cumsum(np.log1p(fraction * scaled)))
    return total - np.log(len(FRACTIONS))


def _lower(x: np.ndarray, counts: np.ndarray, alpha: float) -> np.ndarray:
    """(points,) lower ends for the mean of samples that are not negative; minus infinity once a sample is negative."""
    broken = np.flatnonzero(x < 0)
    valid = int(broken[0]) if len(broken) else len(x)
    return np.array([lower(x[:count], alpha) if count <= valid else -np.inf for count in counts])
