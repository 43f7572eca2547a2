"""Pareto fronts of several scores, all of which are maximised, and their exact hypervolume.

The volume is a sum over slices of the last score (Zitzler 2001; While et al. 2006), each of which is a hypervolume in one score
less: O(n log n) for two scores, O(n^2 log n) for three, and a further factor n for each further score.
"""

import numpy as np

BLOCK = 256  # rows that are compared with all at once


def non_dominated(y: np.ndarray) -> np.ndarray:
    """(rows,) bool: which rows of `y` (rows, scores) no other row dominates, i.e. is at least as good as in all scores and
    better in one. Equal rows do not dominate each other."""
    return dominators(y) == 0


def dominators(y: np.ndarray) -> np.ndarray:
    """(rows,) number of rows of `y` (rows, scores) that dominate each row."""
    count = np.zeros(len(y), int)
    for i in range(0, len(y), BLOCK):  # all pairs at once are too many for large tables
        some = y[i : i + BLOCK, None]
        count += ((some >= y).all(2) & (some > y).any(2)).sum(0)
    return count


def hypervolume(y: np.ndarray, reference: np.ndarray) -> float:
    """Hypervolume: the volume of the points above the reference point that at least one row dominates.

    Args:
        y: (rows, scores), one score or more; rows that are not above the reference in all scores add nothing.
        reference: (scores,) the reference point.
    """
    y = np.asarray(y, np.float64) - reference
    y = y[(y > 0).all(1)]
    if not len(y):
        return 0.0
    if y.shape[1] == 1:
        return float(y.max())
    y = y[np.argsort(-y[:, -1], kind="stable")]
    if y.shape[1] == 2:
        # In descending order of the last score, each row adds its gain in the first score times its last score.
        further = np.diff(np.maximum.accumulate(y[:, 0]), prepend=0.0)
        return float(further @ y[:, 1])
    thick = y[:, -1] - np.append(y[1:, -1], 0.0)
    origin = np.zeros(y.shape[1] - 1)
    return float(sum(thick[i] * hypervolume(y[: i + 1, :-1], origin) for i in np.flatnonzero(thick)))


def improvement(point: np.ndarray, front: np.ndarray, reference: np.ndarray) -> float:
    """Increase of the hypervolume of a front (rows, scores) by a point (scores,): its box minus the dominated part of it."""
    above = point - reference
    if (above <= 0).any():
        return 0.0
    return float(above.prod()) - hypervolume(np.minimum(front, point), reference)


def range_of(y: np.ndarray, counts: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(scores,) least scores of the front, and (scores,) its ranges; for a score that is constant there that of all rows.

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
