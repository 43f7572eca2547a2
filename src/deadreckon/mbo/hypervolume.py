"""Fronts of several scores that are all to be made large, and the volume that they dominate, exactly.

The volume is summed over slices of the last score (Zitzler 2001; While et al. 2006), each the volume of the rows above it in
one score less: n log n steps for two scores, n^2 for three, and more for each further one.
"""

import numpy as np

BLOCK = 256  # rows that are compared with all at once


def non_dominated(y: np.ndarray) -> np.ndarray:
    """(rows,) which of (rows, scores) no other row is at least as good as in all scores and better in one; twins all are."""
    beaten = np.zeros(len(y), bool)
    for i in range(0, len(y), BLOCK):  # all pairs at once are too many for large tables
        some = y[i : i + BLOCK, None]
        beaten |= ((some >= y).all(2) & (some > y).any(2)).any(0)
    return ~beaten


def hypervolume(y: np.ndarray, reference: np.ndarray) -> float:
    """The volume between a reference point and (rows, scores): what one of the rows is at least as good as in all scores.

    Args:
        y: (rows, scores), one score or more; rows that are not above the reference in all scores count nothing.
        reference: (scores,) the corner from which it is measured.
    """
    y = np.asarray(y, np.float64) - reference
    y = y[(y > 0).all(1)]
    if not len(y):
        return 0.0
    if y.shape[1] == 1:
        return float(y.max())
    y = y[np.argsort(-y[:, -1], kind="stable")]
    if y.shape[1] == 2:
        # From the highest row down, each adds what it reaches further, by its height.
        further = np.diff(np.maximum.accumulate(y[:, 0]), prepend=0.0)
        return float(further @ y[:, 1])
    thick = y[:, -1] - np.append(y[1:, -1], 0.0)
    origin = np.zeros(y.shape[1] - 1)
    return float(sum(thick[i] * hypervolume(y[: i + 1, :-1], origin) for i in np.flatnonzero(thick)))


def improvement(point: np.ndarray, front: np.ndarray, reference: np.ndarray) -> float:
    """How much the hypervolume of (rows, scores) grows by one point (scores,): its own box, less what is dominated there."""
    above = point - reference
    if (above <= 0).any():
        return 0.0
    return float(above.prod()) - hypervolume(np.minimum(front, point), reference)


def range_of(y: np.ndarray, counts: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(scores,) the least scores of the front, and its ranges; of a score in which it is flat that of all rows.

    Args:
        y: (rows, scores).
        counts: (rows,) which of them may be on the front; None: all.
    """
    some = y if counts is None else y[counts]
    front = some[non_dominated(some)]
    span = np.ptp(front, axis=0)
    return front.min(0), np.where(span > 0, span, np.ptp(y, axis=0))


def reference_of(y: np.ndarray, counts: np.ndarray | None = None) -> np.ndarray:
    """(scores,) a reference point: below the least scores of the front by a tenth of its range (Ishibuchi et al. 2018).

    The front and its range are those of `range_of`.
    """
    low, span = range_of(y, counts)
    return low - 0.1 * span
