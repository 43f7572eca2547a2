"""Pooling of rows of the same design into one row, with the mean score and its standard error."""

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist, squareform
from scipy.special import chdtrc

from deadreckon.errors import UserError
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.variables import FEWEST

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

GAP, LEAST = 10.0, 3.0  # least ratios of distances between recipes to those within one: of the median, and of the gap
# Equal scores are told if these occur in at least so many pairs, ten times as many as chance explains where scores lie on so
# coarse a grid, in a fifth of the rows, and few others occur more often, as numbers of few significant digits do.
PAIRS, SHARE, MOST, RARELY, PEAKED, GRID = 10, 0.2, 4, 0.1, 3.0, 10
CHANCE = 1e-4  # probability of such a gap by chance
APART = 3  # least number of linkage distances between recipes
LINKED = 3_000  # largest number of different designs among which recipes are searched
ROUNDS = 30  # of the iteration for the weights of rows
UNLIKELY = 0.01  # significance level of a scatter of replicates that is larger than their standard errors explain
UNKNOWN = 0.9  # quantile of the positive standard errors that replaces 0


def pooled(data: "Designs") -> "Designs":
    """The same data with one row per design; a warning states how many rows were pooled, and how far they scatter.

    A pooled score is the mean of its rows, weighted by the inverse squares of their standard errors if these are given. Its
    standard error follows from those of the rows if they are given, else from the scatter within designs, pooled over all
    designs (the pooled variance of one-way analysis of variance): s / sqrt(measurements), also for unreplicated designs. If
    given errors are too small for the scatter of replicates, all are multiplied by Birge's ratio (`birge_ratio`).

    Data without replicates, or with fewer than `FEWEST` different designs, is returned unchanged. If all replicates have the
    same score to the last digit, and the same standard error, they carry no information on the noise: one row of each design
    is kept.
    """
    _, first, which = np.unique(data.x, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    if len(first) == len(data) or len(first) < FEWEST:
        return data
    order = np.argsort(first)  # designs in the order of the table
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    which, first = rank[which], first[order]
    count = np.bincount(which).astype(np.float64)
    given = data.std_error
    weight = np.ones(len(data)) if given is None else 1.0 / np.square(given)
    y = np.bincount(which, weight * data.y) / np.bincount(which, weight)
    freedom = len(data) - len(first)
    plain = np.bincount(which, data.y) / count
    scatter = float(np.sqrt(np.square(data.y - plain[which]).sum() / freedom))
    groups = None if data.groups is None else common(data.groups, which)
    repeated, of = int(count[count > 1].sum()), int((count > 1).sum())
    told = f"{repeated} rows are replicates of {of} design{'s' * (of > 1)}"
    if all((each == each[first][which]).all() for each in (data.y, *([] if given is None else [given]))):
        told += f" with the same {data.target} to the last digit; one of each is kept, as if the others were copies"
        warnings.warn(f"{data.name}: {told}", stacklevel=3)
        error = None if given is None else given[first]
        kept = {"table_rows": data.numbered(first), "pooling": told, "groups": groups}
        return replace(data, x=data.x[first], y=data.y[first], std_error=error, **kept)
    told += f" and are pooled; the standard deviation of {data.target} between replicates is {scatter:.3g}"
    if given is None:
        error = scatter / np.sqrt(count)
    else:
        ratio = birge_ratio((data.y - y[which]) / given, freedom)
        error = ratio * np.sqrt(np.bincount(which, np.square(weight * given))) / np.bincount(which, weight)
        if ratio > 1.0:
            told += f", more than their standard errors explain: all standard errors are multiplied by {ratio:.3g}"
    warnings.warn(f"{data.name}: {told}", stacklevel=3)
    return replace(
        data, x=data.x[first], y=y, pooling=told,
        replicates=count, std_error=error, table_rows=data.numbered(first), groups=groups,
    )  # fmt: skip


def birge_ratio(scaled: np.ndarray, freedom: int) -> float:
    """The factor for standard errors if replicates scatter significantly more than these imply: sqrt(chi2 / freedom), and 1 if
    not (Birge 1932; the scale factor S of the Particle Data Group).

    Args:
        scaled: (rows,) deviations from the weighted mean of each design, divided by the standard errors.
        freedom: degrees of freedom of the sum of their squares, chi2: rows less designs.
    """
    chi2 = float(np.square(scaled).sum())
    return (chi2 / freedom) ** 0.5 if chdtrc(freedom, chi2) < UNLIKELY else 1.0


def recipes(data: "Designs") -> np.ndarray:
    """(rows,) number 0, 1, ... of the recipe of each row, in the order of the table.

    Rows are of one recipe if they have the same design, or if their designs differ only by the errors of measured or logged
    settings. The latter is assumed if the sorted distances of single linkage have a gap, the largest distance within a recipe
    is less than 1 / `GAP` of the median distance above the gap, and there are at least four recipes. The gap above k distances
    must be at least a factor of `CHANCE` ^ (-1 / k), which randomly spread designs reach with probability `CHANCE` on a line
    and less in a plane, and of `LEAST`. Among more than `LINKED` different designs, only equal designs are one recipe.
    """
    designs, which = np.unique(data.x, axis=0, return_inverse=True)
    which = which.reshape(-1)
    found = np.arange(len(designs)) if not FEWEST < len(designs) <= LINKED else _linked(data.coordinates.place(designs))
    return _numbered(found[which])


def units(data: "Designs") -> np.ndarray:
    """(rows,) number 0, 1, ... of the unit that each row is held out with, in the order of the table: its group, or its recipe
    if there are no groups or if the recipe is in several, like a control in all batches."""
    alike = data.recipes
    return alike if data.groups is None else _numbered(common(data.groups, alike)[alike])


def common(groups: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The group of each design or recipe, by the groups (rows,) of its rows; `which` (rows,) is the number of each row's design
    or recipe. One that is in several groups becomes a new group."""
    low, high = (np.full(which.max() + 1, fill) for fill in (groups.max(), 0))
    np.minimum.at(low, which, groups)
    np.maximum.at(high, which, groups)
    return np.where(low == high, low, groups.max() + 1 + np.arange(len(low)))


def _numbered(codes: np.ndarray) -> np.ndarray:
    """(rows,) the codes replaced by numbers 0, 1, ... in the order of their first rows."""
    _, first, which = np.unique(codes, return_index=True, return_inverse=True)
    return first.argsort().argsort()[which.reshape(-1)]


def _linked(z: np.ndarray) -> np.ndarray:
    """(designs,) recipe number of each of different designs, by their features `z` (`Coordinates.place`)."""
    distance, tree = _joined(z)
    edges = tree[:, 2]
    wide = np.maximum(CHANCE ** (-1.0 / np.arange(1, len(edges))), LEAST)
    gaps = edges[1:] / np.maximum(edges[:-1], 1e-300) / wide
    if gaps.max() >= 1.0:
        last = int(gaps.argmax())
        group = fcluster(tree, edges[last], "distance") - 1
        # A single row far away, or two clusters of rows, are not recipes.
        several = (np.bincount(group) > 1).sum() > 1 and len(edges) - last > APART
        if several and GAP * distance[group[:, None] == group].max() < np.median(edges[last + 1 :]):
            return group
    return np.arange(len(z))


def _joined(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) distances of points, and SciPy's tree (n - 1, 4) of their single linkage, the distances of which are sorted.

    Coinciding points get a large distance, so that they are joined only through others: the gap above a distance of 0 would be
    infinite.
    """
    far = pdist(z)
    return squareform(far), linkage(np.where(far > 0, far, 2.0 * far.max()), "single")


def units_told(data: "Designs", groups: str | None) -> list[str]:
    """Messages on rows that are held out together: the groups of a column, and rows that are taken for replicates."""
    told = f"rows with the same {groups} are held out together where predictions of unseen designs are tested"
    lines = _equal_scores(data) if groups is None else [f"{told} ({int(data.units.max()) + 1:,} parts)"]
    count, designs = int(data.recipes.max()) + 1, len(np.unique(data.x, axis=0))
    return lines if count == designs else [*lines, (
        f"{designs:,} different designs are {count:,} recipes whose settings differ slightly from row to row: a recipe is held "
        "out as a whole where predictions of unseen designs are tested; write its settings alike to have its rows pooled"
    )]  # fmt: skip


def _equal_scores(data: "Designs") -> list[str]:
    """What to say of scores that occur a few times each, to the last digit, more often than chance explains."""
    values, times = np.unique(data.y, return_counts=True)
    few = (times > 1) & (times <= MOST)
    rows, pairs = int(times[few].sum()), float((times[few] * (times[few] - 1) / 2).sum())
    if pairs < PAIRS or rows < SHARE * len(data) or (times > MOST).sum() > RARELY * few.sum():
        return []
    # The grid on which scores lie, if any: their least difference, or a part of it.
    offsets, least = values - values[0], float(np.diff(values).min())
    steps = (offsets / (least / parts) for parts in range(1, GRID + 1))
    grid = next((int(each[-1]) + 1 for each in steps if np.allclose(each, np.round(each), rtol=0, atol=1e-3)), np.inf)
    expected = len(data) ** 2 / 2 / max(grid / PEAKED, 1.0)
    if pairs < PAIRS * expected:
        return []
    return [
        f"{rows:,} of {len(data):,} rows have exactly the score of another one, such as {values[few][0]:.6g}: if they are one "
        "measurement, written down for several designs, name the column that tells which are (--groups)"
    ]


def noise_beyond(data: "Designs") -> float:
    """Standard deviation of the noise of one measurement in addition to that of a usual row, if rows are means of several.

    The mean of m measurements has the standard error e if each has the variance m e^2, which is (m - 1) e^2 more than that of
    the row; the result is the root of the mean of this over rows, weighted by `row_weights`. It is estimated from replicates
    and not by a model, because a model that fits noise underestimates it.
    """
    if data.replicates is None or data.std_error is None:
        return 0.0
    beyond = (data.replicates - 1.0) * np.square(data.std_error)
    return float(np.sqrt(np.average(beyond, weights=row_weights(data))))


def row_weights(data: "Designs") -> np.ndarray:
    """(rows,) weights of rows in means over all of them: (v / (v + e^2))^2, where e is the standard error of a row and v the
    variance of the scores with these weights, or the median of e^2 if that is larger; 1 where no errors are known.

    They are inversely proportional to the variances of squared deviations, if scores scatter by v beside their errors. A row
    whose error is far larger than the spread of the scores counts for almost nothing. Errors far smaller than that spread all
    weigh alike, so that a few very exact rows do not decide alone; this is also why v is at least the median of e^2.
    """
    weight = np.ones(len(data))
    if data.std_error is None:
        return weight
    square = np.square(data.std_error)
    for _ in range(ROUNDS):
        mean = np.average(data.y, weights=weight)
        v = max(float(np.average(np.square(data.y - mean), weights=weight)), float(np.median(square)))
        weight = np.square(v / (v + square))
    return weight


def errors_of(name: str, table: pa.Table, column: str, rows: np.ndarray) -> tuple[np.ndarray | None, list[str]]:
    """(rows,) standard errors, all above 0, as `numbers_of` gives numbers, and what was done with zeros, a line or none.

    No measurement is exact: 0 is what a spreadsheet computes as the scatter of a single one, and is taken for unknown. A single
    measurement is less exact than most means of several, whose errors are scattered themselves: the quantile `UNKNOWN` of the
    others is used, because the median is too small and a single wrong row may be the largest. If all are 0, none is known.

    Raises:
        UserError: one of them is negative, or no finite number.
    """
    error = numbers_of(name, table, column, rows)
    if (error < 0).any():
        row = int(error.argmin())
        raise UserError(f"{name}: column {column} is {error[row]:g} in row {rows[row]}, standard errors are 0 or more")
    zero = error == 0
    if zero.all():
        return None, [f"column {column} is 0 in all rows: no standard errors are known"]
    if not zero.any():
        return error, []
    used, count = float(np.quantile(error[~zero], UNKNOWN, method="lower")), int(zero.sum())
    told = f"column {column} is 0 in {count:,} row{'s' * (count > 1)}, which is taken for unknown: {used:.3g} is used instead, "
    return np.where(zero, used, error), [f"{told}the {UNKNOWN:.0%} quantile of the other standard errors"]
