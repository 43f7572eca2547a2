"""The effective sample size of rows in clusters, such as batches, which are not independent."""

import numpy as np


def intraclass(values: np.ndarray, codes: np.ndarray) -> float:
    """The intraclass correlation of (rows,) values in clusters: the share of their variance that is between clusters, by
    one-way analysis of variance (Donner 1986, eq. 2.2), in [0, 1]; 0 if each row is a cluster, and 1 if all rows are one, when
    it cannot be estimated.

    Args:
        values: (rows,).
        codes: (rows,) 0, 1, ..., the cluster of each row.
    """
    size = np.bincount(codes).astype(np.float64)
    size, n, clusters = size[size > 0], len(values), int((size > 0).sum())
    if clusters == 1 < n:
        return 1.0
    if clusters == n or np.ptp(values) == 0:
        return 0.0
    count = np.maximum(np.bincount(codes), 1)
    mean = (np.bincount(codes, values) / count)[codes]
    between = np.square(mean - values.mean()).sum() / (clusters - 1)
    within = np.square(values - mean).sum() / (n - clusters)
    usual = (n - np.square(size).sum() / n) / (clusters - 1)
    return float(np.clip((between - within) / (between + (usual - 1.0) * within), 0.0, 1.0))


def effective(codes: np.ndarray, *values: np.ndarray) -> float:
    """Effective number of independent rows among rows in clusters.

    n / (1 + (m - 1) r), with m the mean over rows of the size of a row's cluster, and r the intraclass correlation: of one list
    of values for statistics of these (Kish 1965), the product of both for a correlation or regression of one on the other
    (Scott and Holt 1982). Where rows of a cluster are alike it is n^2 over the sum of the clusters' squared sizes, which is
    less than the number of clusters if these are of unequal size: statistics count rows, so large clusters count more.

    Args:
        codes: (rows,) 0, 1, ..., the cluster of each row.
        values: one (rows,) list or two.
    """
    n, size = len(codes), np.bincount(codes)
    shared = float(np.prod([intraclass(each, codes) for each in values]))
    return float(n / (1.0 + (np.square(size).sum() / n - 1.0) * shared))
