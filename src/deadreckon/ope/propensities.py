"""Learned propensities made honest: calibration on rows that the model has not seen (Guo, Pleiss, Sun and Weinberger 2017).

Networks that were fitted long are too sure. Of propensities that is worse than of predictions: an estimate divides by them, and
the actions that a model believes to be rare are the ones that weigh most. Everything here is fitted to rows out of fold, whole
episodes of them, or it would find nothing to correct.

For discrete actions logits are divided by one temperature, or scaled and shifted per action. A density cannot be tempered like
that: its power does not integrate to one, and the missing factor, which depends on the observation, would go into every
weight. The power of a Gaussian is a Gaussian again, with a deviation that is sqrt(T) as large, so for Gaussian heads the
deviations are scaled. A density after a tanh has its Gaussian before it, where the scale is fitted; one that is clipped at
bounds has probabilities there, and is not of this kind.
"""

import numpy as np

from deadreckon.errors import UserError

MOST = 100.0  # largest temperature, and one over the smallest: beyond, the model knows nothing, or separates all rows


def temperature(logits: np.ndarray, taken: np.ndarray) -> float:
    """The temperature T of softmax(logits / T) that makes the logged actions likeliest; above one where the model is too sure.

    Args:
        logits: (n, actions) of the model, or its log-probabilities, of rows that it was not fitted to.
        taken: (n,) numbers of the logged actions.

    Returns:
        T within 1 / 100 and 100.

    Raises:
        UserError: columns that do not belong together, no rows, or a taken action that the model excludes.
    """
    logits = _checked(logits, taken)
    allowed = np.isfinite(logits)
    known = np.where(allowed, logits, 0.0)
    # The log-likelihood is concave in 1 / T: its slope, sum of (taken - expected) logits, falls and crosses zero once.
    own = known[np.arange(len(taken)), taken]

    def slope(inverse: float) -> float:
        return float((own - (_softmax(inverse * known, allowed) * known).sum(1)).mean())

    low, high = 1.0 / MOST, MOST
    if slope(low) <= 0:
        return MOST
    if slope(high) >= 0:
        return 1.0 / MOST
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if slope(middle) > 0 else (low, middle)
    return float(1.0 / np.sqrt(low * high))


def vector_scaling(logits: np.ndarray, taken: np.ndarray, ridge: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """(actions,) scale and (actions,) shift of softmax(scale * logits + shift) that make the logged actions likeliest.

    It starts from, and is drawn towards, the one temperature and no shift: an action that was hardly taken cannot say more.

    Args:
        logits: (n, actions) of rows that the model was not fitted to.
        taken: (n,) numbers of the logged actions.
        ridge: weight of the squared distance from there, in rows.

    Raises:
        UserError: as `temperature`, and logits that are not finite.
    """
    logits = _checked(logits, taken)
    if not np.isfinite(logits).all():
        raise UserError("scaling per action needs finite logits")
    from scipy.optimize import minimize  # half a second, for this alone

    n, actions = logits.shape
    begin = np.concatenate([np.full(actions, 1.0 / temperature(logits, taken)), np.zeros(actions)])
    one = np.eye(actions)[taken]
    spread = max(float(logits.std()), 1e-12)  # so that scales and shifts are drawn alike, whatever the unit of logits

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        scores = x[:actions] * logits + x[actions:]
        top = scores.max(1, keepdims=True)
        total = top[:, 0] + np.log(np.exp(scores - top).sum(1))
        away = (x - begin) * np.repeat([spread, 1.0], actions)
        value = (total - scores[np.arange(n), taken]).sum() + 0.5 * ridge * away @ away
        error = np.exp(scores - total[:, None]) - one
        slope = np.concatenate([(error * logits).sum(0), error.sum(0)]) + ridge * away * np.repeat([spread, 1.0], actions)
        return float(value) / n, slope / n

    found = minimize(loss, begin, jac=True, method="L-BFGS-B", options={"maxiter": 1000, "ftol": 1e-12, "gtol": 1e-7}).x
    return found[:actions], found[actions:]


def calibration_error(log_probs: np.ndarray, taken: np.ndarray, bins: int = 10) -> float:
    """How far probabilities of actions are from how often these are taken, on average over rows and actions.

    For each action rows are put into bins of equal numbers by its probability; in each bin the mean probability is compared
    with the share of rows in which it was taken (the classwise error of Kull et al. 2019, with the bins of Nguyen and O'Connor
    2015). It is the sum over actions, so 2 is the most, and noise of about sqrt(bins * actions / n) remains of a perfect model.

    Args:
        log_probs: (n, actions) of rows that the model was not fitted to.
        taken: (n,) numbers of the logged actions.
        bins: of each action.

    Raises:
        UserError: columns that do not belong together, or no rows.
    """
    probs = np.exp(_checked(log_probs, taken))
    n, actions = probs.shape
    total = 0.0
    for action in range(actions):
        p = probs[:, action]
        # Equal probabilities belong together, however many there are: bins part where values do.
        edges = np.unique(np.quantile(p, np.linspace(0, 1, min(bins, n) + 1)[1:-1]))
        where = np.searchsorted(edges, p, side="right")
        total += np.abs(np.bincount(where, p - (taken == action))).sum()
    return total / n


def gaussian_scale(residuals: np.ndarray) -> np.ndarray:
    """(d,) factors of a Gaussian head's standard deviations that make rows likeliest, which the head was not fitted to.

    The root mean square of the residuals; above one where the model is too sure.

    Args:
        residuals: (n, d) of (action - mean) / deviation, before the tanh where there is one.

    Raises:
        UserError: no rows, or residuals that are not finite.
    """
    residuals = np.asarray(residuals, float)
    if residuals.ndim != 2 or not len(residuals) or not np.isfinite(residuals).all():
        raise UserError(f"a scale needs finite residuals of some rows and dimensions, got an array of shape {residuals.shape}")
    return np.sqrt(np.square(residuals).mean(0))


def _checked(logits: np.ndarray, taken: np.ndarray) -> np.ndarray:
    logits, taken = np.asarray(logits, float), np.asarray(taken)
    if logits.ndim != 2 or taken.shape != (len(logits),) or not len(logits):
        raise UserError(f"one action for each row of logits is needed, got shapes {taken.shape} and {logits.shape}")
    if taken.min() < 0 or taken.max() >= logits.shape[1]:
        raise UserError(f"actions must be 0 .. {logits.shape[1] - 1}, got {taken.min()} .. {taken.max()}")
    if np.isnan(logits).any() or np.isposinf(logits).any():
        raise UserError("logits must be numbers, or minus infinity for actions that are excluded")
    if np.isneginf(logits[np.arange(len(taken)), taken]).any():
        raise UserError("the model excludes actions that were taken; no scale of logits can mend that")
    return logits


def _softmax(logits: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    scores = np.where(allowed, logits, -np.inf)
    weights = np.exp(scores - scores.max(1, keepdims=True))
    return weights / weights.sum(1, keepdims=True)
