"""Tests of residuals that should not go together, with errors by clusters."""

import numpy as np
from scipy.special import stdtr


def p_of_products(one: np.ndarray, other: np.ndarray, cluster: np.ndarray, freedom: float = 1.0) -> float:
    """The p-value of no correlation between any column of `one` and any of `other`, by Bonferroni.

    The sum of the products of two columns over a cluster has mean zero without a correlation, and Student's t statistic of
    these sums needs no more than that clusters are independent of each other (Liang and Zeger 1986).

    Args:
        one: (rows, m) residuals, with mean zero.
        other: (rows, k) residuals, with mean zero.
        cluster: (rows,) numbers of the clusters.
        freedom: by how much the variance of these residuals is too small, such as the degrees of freedom for each row that a
            regression has left.
    """
    number = np.unique(cluster, return_inverse=True)[1]
    count, found = int(number.max()) + 1, [1.0]
    for left in one.T:
        for right in other.T:
            sums = np.bincount(number, left * right, count)
            if (error := np.sqrt(np.square(sums).sum() / max(freedom, 1 / len(one)))) > 0:
                found.append(float(2 * stdtr(count - 1, -abs(sums.sum()) / error)))
    return min(min(found) * max(len(found) - 1, 1), 1.0)
