"""Calibration of learned propensities on held-out rows (Guo, Pleiss, Sun and Weinberger 2017).

Networks that were trained for long are overconfident. For propensities this is worse than for predictions: an estimate divides
by them, and actions that a model considers rare have the largest weights. Everything here is fitted to out-of-fold rows of
whole episodes; otherwise there would be nothing to correct.

For discrete actions logits are divided by one temperature and shifted per action. A density is left as it is: its power does
not integrate to one, and the missing factor, which depends on the observation, would go into every weight. Those of several
models are mixed.
"""

import numpy as np

from deadreckon.errors import UserError

ROUNDS = 20  # of proportional fitting
MOST = 100.0  # largest temperature, and one over the smallest: beyond, the model is useless, or separates all rows


def temperature(logits: np.ndarray, taken: np.ndarray, prior: float = 0.0) -> float:
    """The temperature T of softmax(logits / T) with the highest likelihood of the logged actions; above one if overconfident.

    Args:
        logits: (n, actions) of the model, or its log-probabilities, of rows that it was not fitted to.
        taken: (n,) numbers of the logged actions.
        prior: penalty of half the square of log T, in rows: with few of them, which may all be predicted right, T stays near
            one.

    Returns:
        T within 1 / 100 and 100.

    Raises:
        UserError: arrays of different lengths, no rows, or a taken action that the model excludes.
    """
    logits = _checked(logits, taken)
    allowed = np.isfinite(logits)
    known = np.where(allowed, logits, 0.0)
    # The log-likelihood is concave in 1 / T: its slope, sum of (taken - expected) logits, falls and crosses zero once.
    own = known[np.arange(len(taken)), taken]

    def slope(inverse: float) -> float:
        found = float((own - (_softmax(inverse * known, allowed) * known).sum(1)).mean())
        return found - prior * np.log(inverse) / (inverse * len(taken))

    low, high = 1.0 / MOST, MOST
    if slope(low) <= 0:
        return MOST
    if slope(high) >= 0:
        return 1.0 / MOST
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if slope(middle) > 0 else (low, middle)
    return float(1.0 / np.sqrt(low * high))


def stacked(log_densities: np.ndarray, prior: float = 0.0) -> np.ndarray:
    """(models,) the shares of a mixture with the highest likelihood, by expectation maximisation (stacking; Yao et al. 2018).

    Args:
        log_densities: (models, n) of rows that they were not fitted to.
        prior: weight, in rows, of equal shares.
    """
    count, n = log_densities.shape
    shares = np.full(count, 1.0 / count)
    for _ in range(ROUNDS):
        each = np.log(shares)[:, None] + log_densities
        shares = (_softmax(each.T, np.ones(each.T.shape, bool)).sum(0) + prior / count) / (n + prior)
    return shares


def shifts(logits: np.ndarray, taken: np.ndarray, rows: float = 0.5) -> np.ndarray:
    """(actions,) shifts of the logits with which the mean probability of each action is its logged frequency.

    A converged fit by maximum likelihood has this property, but a fit that is stopped early may still overestimate actions that
    are rare or never taken. Found by proportional fitting (Deming and Stephan 1940).

    Args:
        logits: (n, actions) of the model.
        taken: (n,) numbers of the logged actions.
        rows: pseudo-count that is added to the logged and to the predicted number of each action, so that frequencies of zero
            do not give infinite shifts.

    Raises:
        UserError: arrays of different lengths, no rows, or a taken action that the model excludes.
    """
    logits = _checked(logits, taken)
    allowed = np.isfinite(logits)
    known = np.where(allowed, logits, 0.0)
    count = np.bincount(taken, minlength=logits.shape[1]) + rows
    found = np.zeros(logits.shape[1])
    for _ in range(ROUNDS):
        found += np.log(count / (_softmax(known + found, allowed).sum(0) + rows))
    return found


def _checked(logits: np.ndarray, taken: np.ndarray) -> np.ndarray:
    logits, taken = np.asarray(logits, float), np.asarray(taken)
    if logits.ndim != 2 or taken.shape != (len(logits),) or not len(logits):
        raise UserError(f"one action for each row of logits is needed, got shapes {taken.shape} and {logits.shape}")
    if taken.min() < 0 or taken.max() >= logits.shape[1]:
        raise UserError(f"actions must be 0 .. {logits.shape[1] - 1}, got {taken.min()} .. {taken.max()}")
    if np.isnan(logits).any() or np.isposinf(logits).any():
        raise UserError("logits must be numbers, or minus infinity for actions that are excluded")
    if np.isneginf(logits[np.arange(len(taken)), taken]).any():
        raise UserError("the model excludes actions that were taken; no scale of the logits can correct that")
    return logits


def _softmax(logits: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    scores = np.where(allowed, logits, -np.inf)
    weights = np.exp(scores - scores.max(1, keepdims=True))
    return weights / weights.sum(1, keepdims=True)
