"""Choice of a parameter that trades bias for variance, by the least upper bound of the squared error.

Estimates are given as scores (grid, episodes), one row per value of the parameter, whose means over the episodes are the
estimates. `cross_fitted` chooses the parameter of each fold by the episodes of the other folds, so that the parameter of an
episode's score was not chosen with that episode.
"""

from collections.abc import Callable

import numpy as np

from deadreckon.errors import UserError
from deadreckon.stats.interval import ALPHA


def bias_bound(scores: np.ndarray, full: np.ndarray) -> np.ndarray:
    """(grid,) upper bound of each estimate's bias, from its distance to one without bias; it fails with probability `ALPHA`.

        |mean(full - scores)| + sqrt(2 s^2 log(2 / alpha) / n) + 2 max|full - scores| log(2 / alpha) / (3 n)

    Bernstein's inequality, as in Su, Dimakopoulou, Krishnamurthy and Dudik 2020. They use the second moment and the maximum of
    the weights; here these are of the difference itself, to which the inequality applies and which is zero where the parameter
    changes nothing. Sample moments replace the true ones, so the bound is asymptotic.

    Args:
        scores: (grid, episodes).
        full: (episodes,) scores of an estimate without bias.
    """
    n = scores.shape[1]
    gap, term = full - scores, np.log(2 / ALPHA)
    return np.abs(gap.mean(1)) + np.sqrt(2 * gap.var(1) * term / n) + 2 * np.abs(gap).max(1) * term / (3 * n)


def least_bound(scores: np.ndarray, biases: np.ndarray) -> int:
    """Index of the least s^2 / n + bias^2 (Wang, Agarwal and Dudik 2017; Su, Dimakopoulou et al. 2020).

    Args:
        scores: (grid, episodes).
        biases: (grid,) upper bounds of their means' biases.

    Raises:
        UserError: fewer than two episodes, so that the variance is not known.
    """
    if scores.shape[1] < 2:
        raise UserError(f"a parameter cannot be chosen by the variance of {scores.shape[1]} episode")
    return int(np.argmin(scores.var(1, ddof=1) / scores.shape[1] + np.square(biases)))


def cross_fitted(
    scores: np.ndarray, folds: np.ndarray, choose: Callable[[np.ndarray], int]
) -> tuple[np.ndarray, np.ndarray]:
    """The scores with a parameter that was chosen without them.

    Args:
        scores: (grid, episodes).
        folds: (episodes,) number of each episode's fold.
        choose: function from the (n,) indices of the episodes outside a fold to the index of the parameter.

    Returns:
        (episodes,) scores, and (folds,) the index chosen for each fold, in ascending order of the folds' numbers.

    Raises:
        UserError: a single fold.
    """
    names = np.unique(folds)
    if len(names) < 2:
        raise UserError("a parameter is chosen on the other folds, so there must be at least two")
    chosen = np.array([choose(np.flatnonzero(folds != name)) for name in names])
    return scores[chosen[np.searchsorted(names, folds)], np.arange(scores.shape[1])], chosen
