"""Intervals from influence functions: of one estimate, of gains, and of all gains at once."""

import numpy as np
from scipy import special

from deadreckon.randomness import generator
from deadreckon.stats.bootstrap import resample_counts
from deadreckon.stats.interval import ALPHA

N_BOOTSTRAP = 2000  # bootstrap samples of the units for the studentised bootstrap
BEYOND = 10  # least number of bootstrap samples beyond a quantile that is used
SURE = 0.01  # error rate of a test that weights average one, for each policy


def errors(influence: np.ndarray) -> np.ndarray:
    """(policies,) standard errors of estimates from their (units, policies) influence functions.

    sqrt(sum_u (psi_u - mean psi)^2 / (n (n - 1))), infinite where there is one unit, or squares are too large for floats.
    """
    n = len(influence)
    if n < 2:
        return np.full(influence.shape[1:], np.inf)
    with np.errstate(over="ignore"):
        return influence.std(0, ddof=1) / np.sqrt(n)


def student(value: np.ndarray, influence: np.ndarray, alpha: float = ALPHA) -> tuple[np.ndarray, np.ndarray]:
    """(policies,) ends of value +- t_{n-1} times the standard error, for each policy separately, by n units."""
    n = len(influence)
    half = errors(influence) * (special.stdtrit(n - 1, 1 - alpha / 2) if n > 1 else np.inf)
    return value - half, value + half


def studentised(influence: np.ndarray, seed: int = 0, n_bootstrap: int = N_BOOTSTRAP) -> np.ndarray:
    """(n_bootstrap, policies) |t| of the means of influence functions over resampled units (bootstrap-t: Efron and Tibshirani
    1993, 12.5).

    A bootstrap sample of equal units has no variance: its t is infinite, or zero if it is at the mean itself.
    """
    n = len(influence)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        psi = (influence - influence.mean(0)) / influence.std(0)
    # The same samples for all estimates that are compared with one seed.
    counts = resample_counts(generator(seed, "resamples"), n, n_bootstrap)
    mean = counts @ psi / n
    variance = np.maximum(counts @ np.square(psi) / n - np.square(mean), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(mean) * np.sqrt(n - 1) / np.sqrt(variance)
    return np.where(variance > 1e-12, t, np.where(np.abs(mean) > 1e-9, np.inf, 0.0))


def _reach(t: np.ndarray, n: int, alpha: float) -> np.ndarray:
    """The quantile of (n_bootstrap, *) studentised means at level 1 - alpha, and never below Student's for n - 1 degrees of
    freedom, which is exact for one normal estimate.

    If fewer than `BEYOND` bootstrap samples lie beyond it, it is the last quantile with so many, times the ratio of Student's
    quantiles. Infinite if there are no more samples than these.
    """
    student = lambda level: special.stdtrit(n - 1, 1 - level / 2)  # noqa: E731
    least = BEYOND / (len(t) + 1)
    if least >= 1:
        return np.full(t.shape[1:], np.inf)
    rank = int(np.ceil((1 - max(alpha, least)) * (len(t) + 1)))
    found = np.sort(t, 0)[rank - 1]
    return np.maximum(found * student(alpha) / student(max(alpha, least)), student(alpha))


def intervals(
    value: np.ndarray, influence: np.ndarray, alpha: float = ALPHA, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(policies,) ends of intervals, for each policy separately, by the studentised bootstrap over units, which adapts to
    skewed scores; infinite for one unit."""
    n, error = len(influence), errors(influence)
    if n < 2:
        return np.full(len(value), -np.inf), np.full(len(value), np.inf)
    with np.errstate(invalid="ignore"):
        half = np.where(error > 0, _reach(studentised(influence, seed), n, alpha) * error, 0.0)
    return value - half, value + half


def beside(half: np.ndarray, deviations: np.ndarray, alpha: float = ALPHA) -> np.ndarray:
    """(policies,) half-widths of intervals of estimates that have a second, independent error.

    It is the root of the sum of the squares of both half-widths; this interval misses at most as often as either of them
    (Banerjee 1960).

    Args:
        half: (policies,) half-widths by the first error.
        deviations: (groups, policies), whose squares sum up to the variance of the second, with groups - 1 degrees of freedom;
            NaN where it is not known, and then so is the interval.
        alpha: share of logs for which the interval may miss.
    """
    error, groups = np.sqrt(np.square(deviations).sum(0)), len(deviations)
    student = special.stdtrit(groups - 1, 1 - alpha / 2) if groups > 1 else np.nan
    return np.hypot(half, np.where(error == 0, 0.0, student * error))


def simultaneous(influence: np.ndarray, alpha: float = ALPHA, seed: int = 0) -> float:
    """The factor c for which value +- c times the standard error holds for all policies at once, at level 1 - alpha.

    The quantile of max_j |t_j| over resampled units, where t_j is the studentised mean of the j-th influence function (Romano
    and Wolf 2005). It adapts to skewed scores and to correlated estimates.

    Args:
        influence: (units, policies), mean zero.
        alpha: share of logs for which one of the intervals may miss.
        seed: of the bootstrap.

    Returns:
        The factor; infinite if there are fewer than two units, or too few bootstrap samples.
    """
    n = len(influence)
    with np.errstate(over="ignore"):  # products of weights may overflow; the interval is infinite then
        psi = influence[:, influence.std(0) > 0]
    if n < 2:
        return np.inf
    t = studentised(psi, seed).max(1) if psi.shape[1] else np.zeros(N_BOOTSTRAP)
    return float(_reach(t, n, alpha))


def gains(
    value: np.ndarray, influence: np.ndarray, against: int, alpha: float = ALPHA, known: np.ndarray | None = None, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Differences of estimates from one of them, paired unit by unit, with intervals that hold for all at once.

    Args:
        value: (policies,) estimates.
        influence: (units, policies) of these.
        against: index of the one that is subtracted.
        alpha: share of logs for which one of the intervals may miss.
        known: (policies,) whether an estimate is valid; the intervals of the others are infinite. None: all are.
        seed: of the bootstrap.

    Returns:
        (policies,) differences, lower and upper ends; zero for `against` itself.
    """
    difference = value - value[against]
    paired = influence - influence[:, [against]]
    error = errors(paired)
    known = np.ones(len(value), bool) if known is None else known
    others = known & (np.arange(len(value)) != against)
    factor = simultaneous(paired[:, others], alpha, seed)
    with np.errstate(invalid="ignore"):
        half = np.where(known, np.where(error > 0, factor * error, 0.0), np.inf)
    half[against] = 0.0
    return difference, difference - half, difference + half
