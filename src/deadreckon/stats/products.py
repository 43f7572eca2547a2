"""Tests of residuals that should not go together, with errors by clusters."""

import numpy as np
from scipy.special import stdtr


def p_of_products(
    one: np.ndarray, other: np.ndarray, cluster: np.ndarray, *, freedom: float = 1.0, centred: bool = False
) -> float:
    """The p-value of no correlation between any column of `one` and any of `other`, by Bonferroni.

    The sum of the products of two columns over a cluster has mean zero without a correlation, and a t statistic of these
    sums needs no more than that clusters are independent of each other (Liang and Zeger 1986).

    Args:
        one: (rows, m) residuals, with mean zero.
        other: (rows, k) residuals, with mean zero.
        cluster: (rows,) numbers of the clusters.
        freedom: by how much the variance of these residuals is too small, such as the degrees of freedom for each row that a
            regression has left.
        centred: whether errors are those of the sums from their mean, as of Student's t. Otherwise, as of a score test, |t| is
            at most the root of the number of clusters, so that few clusters show little.
    """
    number = np.unique(cluster, return_inverse=True)[1]
    count, found = int(number.max()) + 1, [1.0]
    for left in one.T:
        for right in other.T:
            sums = np.bincount(number, left * right, count)
            scatter = count * sums.var(ddof=1) if centred and count > 1 else np.square(sums).sum()
            if (error := np.sqrt(scatter / max(freedom, 1 / len(one)))) > 0:
                found.append(float(2 * stdtr(count - 1, -abs(sums.sum()) / error)))
    return min(min(found) * max(len(found) - 1, 1), 1.0)
