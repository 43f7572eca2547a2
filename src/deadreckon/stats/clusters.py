"""How much rows are worth that lie in clusters, such as batches, and are no independent ones."""

import numpy as np


def intraclass(values: np.ndarray, codes: np.ndarray) -> float:
    """The intraclass correlation of (rows,) values in clusters: the share of their variance that rows of one have in common, by
    one-way analysis of variance (Donner 1986, eq. 2.2), in [0, 1]; 0 where each row is a cluster, and 1 where all are one, as
    nothing tells.

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
    """How many independent rows rows in clusters are worth, the number of clusters at least.

    n / (1 + (m - 1) r), with m the size of the cluster that a row is in, in the mean over rows, and r the intraclass
    correlation: of one list of values for what is said of these (Kish 1965), the product of both for a correlation or
    regression of one on the other (Scott and Holt 1982).

    Args:
        codes: (rows,) 0, 1, ..., the cluster of each row.
        values: one (rows,) list or two.
    """
    n, size = len(codes), np.bincount(codes)
    shared = float(np.prod([intraclass(each, codes) for each in values]))
    return max(n / (1.0 + (np.square(size).sum() / n - 1.0) * shared), float((size > 0).sum()))
