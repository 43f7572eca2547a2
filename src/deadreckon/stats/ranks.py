"""Rank correlation."""

import numpy as np


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """The rank correlation of two (rows,) lists (Spearman 1904), ties at their mean rank; 0 where one of them is flat."""
    from scipy.stats import rankdata  # slow to import, and few need it

    flat = np.ptp(a) == 0 or np.ptp(b) == 0
    return 0.0 if flat else float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])
