"""SWITCH: doubly robust where weights are small, the critic alone where they are large (Wang, Agarwal and Dudik 2017).

For one step this is their SWITCH-DR: V(s) + w 1[w <= tau] (r - Q(s, a)). For sequences the same holds at each decision, with
the weight up to there:

    V(s_0) + sum_t discount^t rho_{0:t} 1[rho_{0:t} <= tau] (r_t + discount V(s_{t+1}) - Q(s_t, a_t))

An infinite tau is plain doubly robust estimation, a tau of zero the critic alone. It has no bias where the critic has none.
"""

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.sequences import corrected, times, totals


def switch_scores(
    begin: np.ndarray,
    log_rho: np.ndarray,
    errors: np.ndarray,
    lengths: np.ndarray,
    discount: float,
    thresholds: np.ndarray,
) -> np.ndarray:
    """(thresholds, episodes) scores, whose means over the episodes are the estimates.

    Args:
        begin: (episodes,) V at the initial states.
        log_rho: (rows,) log rho_{0:t}; see `sequences.cumulate`.
        errors: (rows,) r + discount V(s') - Q(s, a), with V(s') zero after terminals; in units of the reward.
        lengths: (episodes,) rows of each episode.
        discount: per step.
        thresholds: (thresholds,) largest weights that are used, values of tau; may be infinite.

    Raises:
        UserError: a threshold that is negative or no number.
    """
    scores = [corrected(begin, np.exp(np.where(log_rho <= limit, log_rho, -np.inf)), errors, lengths, discount)
              for limit in _logs(thresholds)]  # fmt: skip
    return np.stack(scores)


def beyond(log_rho: np.ndarray, lengths: np.ndarray, discount: float, thresholds: np.ndarray) -> np.ndarray:
    """(thresholds, episodes) scores whose means estimate the policy's discounted time with weights above each threshold."""
    fade = discount ** times(lengths)
    above = lambda limit: totals(np.exp(np.where(log_rho > limit, log_rho, -np.inf)) * fade, lengths)  # noqa: E731
    return np.stack([above(limit) for limit in _logs(thresholds)])


def _logs(thresholds: np.ndarray) -> np.ndarray:
    thresholds = np.asarray(thresholds, float)
    if not (thresholds >= 0).all():
        raise UserError(f"thresholds of weights must be 0 or more, got {thresholds.min():g}")
    with np.errstate(divide="ignore"):
        return np.log(thresholds)
