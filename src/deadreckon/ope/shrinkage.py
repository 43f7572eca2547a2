"""Doubly robust estimates with shrunk weights (Su, Dimakopoulou, Krishnamurthy and Dudik 2020).

Optimistic shrinkage takes w_lambda = lambda w / (w^2 + lambda), which minimises lambda (w' - w)^2 + w^2 w'^2 over w' and with
it a bound of the squared error: it grows up to sqrt(lambda) / 2 at w = sqrt(lambda) and falls beyond. An infinite lambda gives
the plain weights, and zero the critic alone. For sequences the weight up to each decision is shrunk; the paper considers one
step only.
"""

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.sequences import corrected


def shrunk(log_weights: np.ndarray, strength: float) -> np.ndarray:
    """The shrunk weights, in the shape of their logarithms.

    Args:
        log_weights: logarithms of the weights; minus infinity is a weight of zero.
        strength: lambda, from 0 (no weight at all) to infinity (weights as they are).

    Raises:
        UserError: a negative lambda.
    """
    if not strength >= 0:
        raise UserError(f"lambda of shrinkage must be 0 or more, got {strength:g}")
    if strength == 0:
        return np.zeros_like(log_weights)
    if np.isinf(strength):
        return np.exp(log_weights)
    # 1 / (1/w + w/lambda) in logarithms: w^2 may overflow where the result is ordinary.
    return np.exp(-np.logaddexp(-log_weights, log_weights - np.log(strength)))


def shrinkage_scores(
    begin: np.ndarray,
    log_rho: np.ndarray,
    errors: np.ndarray,
    lengths: np.ndarray,
    discount: float,
    strengths: np.ndarray,
) -> np.ndarray:
    """(strengths, episodes) scores, whose means over the episodes are the estimates.

    Args:
        begin: (episodes,) V at the initial states.
        log_rho: (rows,) log rho_{0:t}; see `sequences.cumulate`.
        errors: (rows,) r + discount V(s') - Q(s, a), with V(s') zero after terminals; in units of the reward.
        lengths: (episodes,) rows of each episode.
        discount: per step.
        strengths: (strengths,) values of lambda.

    Raises:
        UserError: a negative lambda.
    """
    return np.stack([corrected(begin, shrunk(log_rho, s), errors, lengths, discount) for s in strengths])
