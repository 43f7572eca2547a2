"""Confidence intervals of a mean, two-sided at level 1 - `alpha`, with the constants of their sources."""

import numpy as np
from scipy import special  # scipy.stats takes seconds to import

ALPHA = 0.05
RESAMPLES = 1000
TAIL = 10  # redraws beyond a percentile that it takes to know it


def student(x: np.ndarray, alpha: float = ALPHA) -> tuple[float, float]:
    """mean +- t_{n-1} s / sqrt(n): right for many episodes, or normal ones."""
    n = len(x)
    if n < 2:
        return -np.inf, np.inf
    half = special.stdtrit(n - 1, 1 - alpha / 2) * x.std(ddof=1) / np.sqrt(n)
    return float(x.mean() - half), float(x.mean() + half)


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


def percentiles(draws: np.ndarray, effective: float, alpha: float = ALPHA) -> tuple[float, float]:
    """The bootstrap's interval from (n,) redrawn estimates, wider where few episodes count.

    Percentiles of redraws are those of a normal with a deviation that is too small by sqrt(1 - 1/n); they are expanded to
    those of Student's t (Hesterberg 2015), with as many episodes as the weights amount to. An end beyond which fewer than
    `TAIL` redraws would lie is continued from the last percentile that has so many, as a normal's would be.
    """
    n = max(effective, 2.0)
    # In standard deviations of the redraws, and how far they reach for sure.
    wanted = float(np.sqrt(1.0 / (1.0 - 1.0 / n)) * special.stdtrit(n - 1, 1 - alpha / 2))
    safe = min(wanted, float(special.ndtri(1 - min(TAIL / len(draws), 0.5 - 1e-3))))
    tail = 100.0 * float(special.ndtr(-safe))
    middle, low, high = np.percentile(draws, [50.0, tail, 100.0 - tail])
    return float(middle - wanted / safe * (middle - low)), float(middle + wanted / safe * (high - middle))


def spread(values: np.ndarray, alpha: float = ALPHA) -> tuple[np.ndarray, np.ndarray]:
    """Intervals from (members, ...) estimates, each fitted to redrawn episodes: mean +- t_{m-1} s sqrt(1 + 1/m).

    A member differs from the estimate as the estimate does from the truth (the bootstrap), so what is missing is one more
    draw: the interval is that of a prediction. It knows of the log's randomness and the fit's, not of a bias that all share.
    """
    members = len(values)
    if members < 2:
        return np.full(values.shape[1:], np.nan), np.full(values.shape[1:], np.nan)
    half = special.stdtrit(members - 1, 1 - alpha / 2) * values.std(0, ddof=1) * np.sqrt(1 + 1 / members)
    return values.mean(0) - half, values.mean(0) + half
