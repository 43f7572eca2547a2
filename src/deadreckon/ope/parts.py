"""Whether residuals have mean zero in all parts of a column: its levels, or its quantiles."""

import numpy as np
from scipy.special import chdtrc

PARTS = 10  # most parts of a column
ROWS = 20  # least number of clusters, or of rows, for each part


def parts_of(column: np.ndarray, units: int) -> np.ndarray | None:
    """(rows,) the part of each row, 0, 1, ...: its level, or its quantile; None for a column that never changes."""
    most = max(min(PARTS, units // ROWS), 2)
    values, part = np.unique(column, return_inverse=True)
    if len(values) > most:
        edges = np.unique(np.quantile(column, np.arange(1, most) / most))
        part = np.searchsorted(edges, column, side="right" if edges[0] == values[-1] else "left")
    part = np.unique(part, return_inverse=True)[1]
    return part if part.max() > 0 else None


def frequent(actions: np.ndarray, most: int, rows: int) -> list[int]:
    """The `most` most frequent of discrete (rows,) actions, those with so many rows or more."""
    counts = np.bincount(actions)
    return [a for a in np.argsort(-counts, kind="stable")[:most].tolist() if counts[a] >= rows]


def means_of(part: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(rows,) mean of the values in the part of each row."""
    return (np.bincount(part, values) / np.maximum(np.bincount(part), 1))[part]


def sums_of(residual: np.ndarray, part: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(units, parts) sums of the residuals."""
    units, parts = int(unit.max()) + 1, int(part.max()) + 1
    return np.bincount(unit * parts + part, residual, units * parts).reshape(units, parts)


def apart(
    residual: np.ndarray, variance: np.ndarray, whole: float, part: np.ndarray | None, unit: np.ndarray
) -> tuple[float, float]:
    """The p-value of residuals that have mean zero in all parts, and how much the parts tell of what they are residuals of: a
    correlation, less what chance explains.

    Args:
        residual: (rows,) what was observed beyond its expectation.
        variance: (rows,) of each, by the model of the expectation; 0 where it says nothing of variances.
        whole: variance of what was observed.
        part, unit: (rows,) of each row.
    """
    if part is None:
        return 1.0, 0.0
    sums = sums_of(residual, part, unit)
    # Few events say little of the variance, which propensities of rare actions know.
    variance = np.maximum(np.square(sums).sum(0), np.bincount(part, variance))
    total, rows = sums.sum(0), np.bincount(part)
    excess = float(((np.square(total) - variance) / np.maximum(rows, 1)).sum()) / len(residual)
    together = sums.T @ sums
    np.fill_diagonal(together, variance)
    square = float(total @ np.linalg.lstsq(together, total, rcond=None)[0])
    return float(chdtrc(len(total), square)), float(np.sqrt(max(excess, 0.0) / max(whole, 1e-12)))
