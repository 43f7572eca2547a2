"""Whether importance weights can be averaged: the shape of their tail (Vehtari, Simpson, Gelman, Yao and Gabry 2024).

The largest weights follow a generalised Pareto distribution of shape k, and moments of weights are finite up to order 1 / k:
beyond 1/2 there is no variance, beyond 0.7 averages of any practical number of episodes are off by unknown amounts, beyond 1
there is no mean.
"""

from collections.abc import Sequence

import numpy as np

from deadreckon.errors import UserError

LEAST = 5  # least number of weights above the threshold to fit a tail
SURE = 1.645  # standard errors of a one-sided 95 % bound
STEEP = 600.0  # range of logarithms in the upper three quarters of a tail beyond which k is infinite


def pareto_k(log_weights: np.ndarray) -> float:
    """The shape k of the tail of importance weights, by the fit of PSIS to the largest of them.

    The tail is the largest fifth of the weights, or 3 sqrt(n) of more than 225 (Vehtari et al. 2024, appendix), without those
    that equal the weight below it, the threshold, which the tail must exceed. Weights of zero are left out.

    Args:
        log_weights: (n,) logarithms; minus infinity is a weight of zero.

    Returns:
        k; infinity if the largest weights differ by more than floats can hold; minus infinity if they are all the same, so
        that there is no tail; NaN if it cannot be estimated: fewer than 25 weights above zero, or fewer than five that exceed
        the rest.

    Raises:
        UserError: logarithms that are NaN or infinite.
    """
    return _fitted(log_weights)[0]


def _fitted(log_weights: np.ndarray) -> tuple[float, int]:
    """Shape of the tail, as `pareto_k`, and the number of weights that it was fitted to, 0 if there was no fit."""
    logs = np.asarray(log_weights, float)
    if np.isnan(logs).any() or np.isposinf(logs).any():
        raise UserError("weights must be finite, their logarithms numbers or minus infinity")
    logs = np.sort(logs[logs > -np.inf])
    n = len(logs)
    if n < 5 * LEAST:
        return float("nan"), 0
    size = int(3 * np.sqrt(n)) if n > 225 else n // 5
    # Logarithms that differ by rounding are those of one weight.
    cutoff = logs[n - size - 1]
    above = logs[logs > cutoff + 1e-9]
    if np.ptp(logs[n - size - 1 :]) < 1e-9 or (len(above) and np.ptp(above) < 1e-9):
        return -np.inf, 0
    if len(above) < LEAST:
        return float("nan"), 0
    if above[-1] - above[(len(above) + 2) // 4 - 1] > STEEP:  # no tail is heavier, and the fit divides by that weight
        return np.inf, len(above)
    from arviz_stats.base.array import array_stats  # takes a second, and only this needs it

    # Its tail size depends on the number of weights: copies of the threshold are added so that the tail is `above`.
    tail = len(above)
    padding = 5 * tail - tail if tail <= 45 else -(-tail * tail // 9) - tail
    # It takes log-likelihoods, which are the negative logarithms of the weights.
    return float(array_stats.psislw(-np.concatenate([np.full(padding, cutoff), above]))[1]), tail


def diagnosed(log_weights: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """`pareto k` of the (n,) weights of each policy, and `pareto k low`, above which it lies with 95 % confidence.

    The standard error of k is about (1 + k) / sqrt(m) for the m weights that k is fitted to (Smith 1987), which for a few dozen
    episodes is as large as the threshold it is compared with.
    """
    fits = [_fitted(each) for each in log_weights]
    k, tail = np.array([each for each, _ in fits]), np.array([weights for _, weights in fits])
    with np.errstate(invalid="ignore"):
        low = k - SURE * (1.0 + k) / np.sqrt(np.maximum(tail, 1))
    return {"pareto k": k, "pareto k low": np.where(np.isinf(k), k, low)}
