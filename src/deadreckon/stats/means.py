"""Confidence intervals of a mean of independent numbers, two-sided at level 1 - `alpha`, with their sources' constants."""

import numpy as np
from scipy import special  # scipy.stats takes seconds to import

from deadreckon.stats.interval import ALPHA, Interval, same


def student(x: np.ndarray, alpha: float = ALPHA) -> tuple[float, float]:
    """mean +- t_{n-1} s / sqrt(n): valid for many numbers, or normal ones; infinite for one number."""
    n = len(x)
    if n < 2:
        return -np.inf, np.inf
    half = special.stdtrit(n - 1, 1 - alpha / 2) * x.std(ddof=1) / np.sqrt(n)
    return float(x.mean() - half), float(x.mean() + half)


def student_interval(x: np.ndarray) -> Interval:
    """The mean with Student's interval at `LEVEL`, whose ends are NaN for numbers that show no spread: one, or all the same."""
    return Interval(float(x.mean()), *(student(x) if len(x) > 1 and not same(x) else (np.nan, np.nan)))


def hoeffding(x: np.ndarray, low: float, high: float, alpha: float = ALPHA) -> tuple[float, float]:
    """mean +- (high - low) sqrt(log(2 / alpha) / 2n) for x in [low, high]: holds for every n (Hoeffding 1963)."""
    half = (high - low) * np.sqrt(np.log(2 / alpha) / (2 * len(x)))
    return float(x.mean() - half), float(x.mean() + half)


def empirical_bernstein(x: np.ndarray, low: float, high: float, alpha: float = ALPHA) -> tuple[float, float]:
    """mean +- (sqrt(2 s^2 log(4 / alpha) / n) + 7 (high - low) log(4 / alpha) / (3 (n - 1))) for x in [low, high].

    Maurer and Pontil 2009, Theorem 4: one side fails with probability d where log(2 / d) stands, and d is alpha / 2 here.
    """
    n = len(x)
    if n < 2:
        return -np.inf, np.inf
    term = np.log(4 / alpha)
    half = np.sqrt(2 * x.var(ddof=1) * term / n) + 7 * (high - low) * term / (3 * (n - 1))
    return float(x.mean() - half), float(x.mean() + half)
