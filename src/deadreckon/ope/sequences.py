"""Arithmetic along the episodes of a log, on plain arrays, which weighted estimators of sequences share.

The rows of an episode are consecutive, and episodes follow each other, so their `lengths` (episodes,), each at least one,
determine which rows belong to which episode. One-step logs have lengths of one.
"""

import numpy as np

from deadreckon.errors import UserError


def starts_of(lengths: np.ndarray) -> np.ndarray:
    """(episodes,) the first row of each."""
    return np.cumsum(lengths) - lengths


def times(lengths: np.ndarray) -> np.ndarray:
    """(rows,) the step of each row within its episode, from zero."""
    return np.arange(int(np.sum(lengths))) - np.repeat(starts_of(lengths), lengths)


def totals(x: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """(..., episodes) sums over the rows of each episode, of (..., rows).

    Raises:
        UserError: the lengths do not sum to the number of rows, or one is below 1.
    """
    if x.shape[-1] != np.sum(lengths) or np.min(lengths, initial=1) < 1:
        raise UserError(f"episodes of {np.sum(lengths):,} rows, each of at least one, cannot divide {x.shape[-1]:,} rows")
    return np.add.reduceat(x, starts_of(lengths), axis=-1)


def cumulate(log_ratios: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """(rows,) log of rho_{0:t}, the sums of the log-ratios (rows,) over each episode so far.

    Minus infinity, an action that the policy never takes, stays so for the rest of the episode.
    """
    if len(lengths) == len(log_ratios):  # of one step each
        return np.array(log_ratios, float)
    never = np.isneginf(log_ratios)
    known = np.where(never, 0.0, log_ratios)
    first = starts_of(lengths)
    total = np.cumsum(known)
    total -= np.repeat(total[first] - known[first], lengths)
    if never.any():
        misses = np.cumsum(never)
        total[misses > np.repeat(misses[first] - never[first], lengths)] = -np.inf
    return total


def corrected(
    begin: np.ndarray, weights: np.ndarray, errors: np.ndarray, lengths: np.ndarray, discount: float
) -> np.ndarray:
    """(..., episodes) scores of a doubly robust estimate; their mean is the estimate.

        V(s_0) + sum_t discount^t w_t (r_t + discount V(s_{t+1}) - Q(s_t, a_t))

    Jiang and Li 2016, equation 10, unrolled, with any weights in place of rho_{0:t}.

    Args:
        begin: (episodes,) V at the initial states.
        weights: (..., rows) of each row's error.
        errors: (rows,) r + discount V(s') - Q(s, a), with V(s') zero after terminals; in units of the reward.
        lengths: (episodes,) rows of each episode.
        discount: per step.
    """
    # Rows with a weight of zero do not count, even if their error is infinite or NaN.
    terms = weights * np.where(weights == 0.0, 0.0, errors) * discount ** times(lengths)
    return begin + totals(terms, lengths)
