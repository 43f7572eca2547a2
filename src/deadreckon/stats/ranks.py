"""Rank correlation (Spearman 1904)."""

import numpy as np
from jaxtyping import Float

SORTED = 0.9  # share of the changes from row to row in one direction, from which on rows are in the order of a column


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """The rank correlation of two (rows,) lists, ties at their mean rank; 0 if one of them is constant."""
    flat = np.ptp(a) == 0 or np.ptp(b) == 0
    return 0.0 if flat else float(spearman_of_each(a[None], b[None])[0])


def spearman_of_each(a: Float[np.ndarray, "n rows"], b: Float[np.ndarray, "n rows"]) -> Float[np.ndarray, "n"]:
    """`spearman` of many pairs of lists at once; NaN if one of a pair is constant."""
    from scipy.stats import rankdata  # slow to import, and few need it

    x, y = (ranks - ranks.mean(1, keepdims=True) for ranks in (rankdata(each, axis=1) for each in (a, b)))
    spread = np.sqrt(np.square(x).sum(1) * np.square(y).sum(1))
    return np.divide((x * y).sum(1), spread, out=np.full(len(a), np.nan), where=spread > 0.0)


def sorted_by(values: np.ndarray) -> bool:
    """Whether rows are in the order of these (rows,) values: nearly all changes from row to row have one direction."""
    return one_way(np.diff(values))


def one_way(steps: np.ndarray) -> bool:
    """Whether nearly all of these (n,) changes that are not 0 have one direction; not if all are 0."""
    steps = np.sign(steps)
    return bool(max((steps > 0).sum(), (steps < 0).sum()) >= SORTED * max((steps != 0).sum(), 1))
