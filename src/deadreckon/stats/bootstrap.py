"""Intervals from bootstrap samples of an estimate, and from the members of an ensemble."""

import numpy as np
from scipy import special

from deadreckon.stats.interval import ALPHA

RESAMPLES = 1000
TAIL = 10  # least number of bootstrap samples beyond a percentile that is used
_AT_ONCE = 2**16  # draws at a time, which fit in the processor's cache


def resample_counts(rng: np.random.Generator, units: int, resamples: int) -> np.ndarray:
    """(resamples, units) how often each unit is in a sample of as many, drawn with replacement.

    A multinomial sample of equal probabilities, from draws of the units instead of one binomial for each: several times as fast
    for hundreds of units.
    """
    counts = np.empty((resamples, units))
    rows = max(1, _AT_ONCE // units)
    for first in range(0, resamples, rows):
        part = counts[first : first + rows]
        drawn = rng.integers(units, size=part.shape, dtype=np.int32) + units * np.arange(len(part))[:, None]
        part[:] = np.bincount(drawn.ravel(), minlength=part.size).reshape(part.shape)
    return counts


def percentile_interval(draws: np.ndarray, ess: float, alpha: float = ALPHA) -> tuple[float, float]:
    """The bootstrap's percentile interval from (n,) bootstrap samples, expanded for a small effective sample size `ess`.

    The percentiles are those of a normal distribution whose standard deviation is too small by the factor sqrt(1 - 1/ess); they
    are expanded to those of Student's t (Hesterberg 2015). An end beyond which fewer than `TAIL` bootstrap samples would lie is
    extrapolated, as for a normal distribution, from the last percentile with so many.
    """
    n = max(ess, 2.0)
    # Both in standard deviations of the bootstrap samples: the end, and the farthest percentile with enough samples beyond.
    wanted = float(np.sqrt(1.0 / (1.0 - 1.0 / n)) * special.stdtrit(n - 1, 1 - alpha / 2))
    safe = min(wanted, float(special.ndtri(1 - min(TAIL / len(draws), 0.5 - 1e-3))))
    tail = 100.0 * float(special.ndtr(-safe))
    middle, low, high = np.percentile(draws, [50.0, tail, 100.0 - tail])
    return float(middle - wanted / safe * (middle - low)), float(middle + wanted / safe * (high - middle))


def jackknife(values: np.ndarray, left_out: float) -> np.ndarray:
    """(groups, ...) deviations whose squares sum up to variances of estimates, from (groups, ...) values of which each leaves
    out one group of the data. NaN of one group, whose variance is not known.

    The delete-a-group jackknife (Shao and Wu 1989) for G groups that need not make up the whole data: where each holds a share
    d of it, the variance is (1 - d)^2 / d * G / (G - 1) times the mean square of the values around their mean, which is G - 1
    times that where d = 1 / G. Its degrees of freedom are G - 1.

    Args:
        values: of groups that have no row in common.
        left_out: share of the data that each leaves out, in (0, 1).
    """
    groups = len(values)
    if groups < 2:
        return np.full(values.shape, np.nan)
    return (values - values.mean(0)) * (1.0 - left_out) / np.sqrt(left_out * (groups - 1))


def prediction(values: np.ndarray) -> np.ndarray:
    """(members, ...) deviations whose squares sum up to the variances of `ensemble_interval`; NaN of one member."""
    members = len(values)
    if members < 2:
        return np.full(values.shape, np.nan)
    return (values - values.mean(0)) * np.sqrt((1 + 1 / members) / (members - 1))


def ensemble_interval(values: np.ndarray, alpha: float = ALPHA) -> tuple[np.ndarray, np.ndarray]:
    """Intervals from (members, ...) estimates, each fitted to a bootstrap resample: mean +- t_{m-1} s sqrt(1 + 1/m).

    A member differs from the estimate as the estimate does from the truth (the bootstrap principle), so this is a prediction
    interval for one more draw. It includes the randomness of the log and of the fit, but not a bias that all members share.
    """
    members = len(values)
    if members < 2:
        return np.full(values.shape[1:], np.nan), np.full(values.shape[1:], np.nan)
    half = special.stdtrit(members - 1, 1 - alpha / 2) * values.std(0, ddof=1) * np.sqrt(1 + 1 / members)
    return values.mean(0) - half, values.mean(0) + half
