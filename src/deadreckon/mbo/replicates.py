"""Rows of the same design as one row, with the mean score and its standard error."""

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist, squareform

from deadreckon.errors import UserError
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.variables import FEWEST

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

GAP, LEAST = 10.0, 3.0  # times by which designs of two recipes lie farther apart than those of one: usually, and at least
CHANCE = 1e-4  # of a gap that means nothing
APART = 3  # distances between recipes at least
LINKED = 3_000  # different designs beyond which nobody looks


def pooled(data: "Designs") -> "Designs":
    """The same data with one row a design; how many were pooled, and how far they scatter, is told in a warning.

    A pooled score is the mean of its rows; where these have standard errors above 0, the mean weighed by their inverse squares.
    Its standard error follows from those of the rows where they are given, else from the scatter within designs, pooled over
    all designs (the pooled variance of one-way analysis of variance): s / sqrt(measurements), for unreplicated designs too.
    Data without replicates is given back as it is, and so is data of fewer than `FEWEST` different designs. Where all
    replicates have the same score to the last digit, and the same standard error, nothing is learned of the noise: of each
    design one row is kept.
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
    weight = np.ones(len(data)) if given is None or not (given > 0).all() else 1.0 / np.square(given)
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
    if given is None:
        error = scatter / np.sqrt(count)
    else:
        error = np.sqrt(np.bincount(which, np.square(weight * given))) / np.bincount(which, weight)
    told += f" and are pooled; the standard deviation of {data.target} between replicates is {scatter:.3g}"
    warnings.warn(f"{data.name}: {told}", stacklevel=3)
    return replace(
        data, x=data.x[first], y=y, pooling=told,
        replicates=count, std_error=error, table_rows=data.numbered(first), groups=groups,
    )  # fmt: skip


def recipes(data: "Designs") -> np.ndarray:
    """(rows,) number 0, 1, ... of the recipe of each row, in the order of the table.

    Rows are of one recipe if they are the same design, or if their designs differ by no more than what settings are measured or
    logged with: the sorted distances of single linkage have a gap, and the rows of any recipe lie `GAP` times nearer together
    than recipes usually are to the next one, of four recipes or more. Of k distances below it the gap is at least a factor of
    `CHANCE` ^ (-1 / k), which the smallest of designs that are spread by chance reach with probability `CHANCE` on a line and
    less in a plane, and `LEAST` in any case. Of more than `LINKED` different designs nobody looks.
    """
    designs, which = np.unique(data.x, axis=0, return_inverse=True)
    which = which.reshape(-1)
    found = np.arange(len(designs)) if not FEWEST < len(designs) <= LINKED else _linked(data.coordinates.place(designs))
    return _numbered(found[which])


def units(data: "Designs") -> np.ndarray:
    """(rows,) number 0, 1, ... of what each row is held out with, in the order of the table: its group, or its recipe where
    there are no groups or where the recipe stands in several, as a control in all batches does."""
    alike = data.recipes
    return alike if data.groups is None else _numbered(common(data.groups, alike)[alike])


def common(groups: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The group of each of the designs or recipes `which` (rows,), by those of their rows; one of its own where it stands in
    several."""
    low, high = (np.full(which.max() + 1, fill) for fill in (groups.max(), 0))
    np.minimum.at(low, which, groups)
    np.maximum.at(high, which, groups)
    return np.where(low == high, low, groups.max() + 1 + np.arange(len(low)))


def _numbered(codes: np.ndarray) -> np.ndarray:
    """(rows,) the same as numbers 0, 1, ... in the order of their first rows."""
    _, first, which = np.unique(codes, return_index=True, return_inverse=True)
    return first.argsort().argsort()[which.reshape(-1)]


def _linked(z: np.ndarray) -> np.ndarray:
    """(designs,) number of the recipe of each of different designs, by their places."""
    distance, tree = _joined(z)
    edges = tree[:, 2]
    wide = np.maximum(CHANCE ** (-1.0 / np.arange(1, len(edges))), LEAST)
    gaps = edges[1:] / np.maximum(edges[:-1], 1e-300) / wide
    if gaps.max() >= 1.0:
        last = int(gaps.argmax())
        group = fcluster(tree, edges[last], "distance") - 1
        # One row far away, or two regions, are no recipes.
        several = (np.bincount(group) > 1).sum() > 1 and len(edges) - last > APART
        if several and GAP * distance[group[:, None] == group].max() < np.median(edges[last + 1 :]):
            return group
    return np.arange(len(z))


def _joined(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) distances of points, and SciPy's tree (n - 1, 4) of their single linkage, the distances of which are sorted.

    Points at one place are joined by way of others: no two different designs have the distance of a recipe's runs for certain.
    """
    far = pdist(z)
    return squareform(far), linkage(np.where(far > 0, far, 2.0 * far.max()), "single")


def units_told(data: "Designs", groups: str | None) -> list[str]:
    """Lines on rows that are held out together: the groups of a column, and rows that are taken for replicates."""
    told = f"rows with the same {groups} are held out together where predictions of unseen designs are tested"
    lines = [] if groups is None else [f"{told} ({int(data.units.max()) + 1:,} parts)"]
    count, designs = int(data.recipes.max()) + 1, len(np.unique(data.x, axis=0))
    return lines if count == designs else [*lines, (
        f"{designs:,} different designs are {count:,} recipes whose settings differ slightly from row to row: a recipe is held "
        "out as a whole where predictions of unseen designs are tested; write its settings alike to have its rows pooled"
    )]  # fmt: skip


def noise_beyond(data: "Designs") -> float:
    """Standard deviation of the noise that one measurement has beyond that of a usual row, where rows are means of several.

    The mean of m measurements has the standard error e if each has the variance m e^2, of which (m - 1) e^2 is beyond that of
    the row; the root of its mean over rows. It is known from replicates, and no model's guess: a model that takes noise for
    signal believes that there is none.
    """
    if data.replicates is None or data.std_error is None:
        return 0.0
    return float(np.sqrt(((data.replicates - 1.0) * np.square(data.std_error)).mean()))


def errors_of(name: str, table: pa.Table, column: str, rows: np.ndarray) -> np.ndarray:
    """(rows,) standard errors, as `numbers_of` gives numbers.

    Raises:
        UserError: one of them is negative, or no finite number.
    """
    error = numbers_of(name, table, column, rows)
    if (error < 0).any():
        row = int(error.argmin())
        raise UserError(f"{name}: column {column} is {error[row]:g} in row {rows[row]}, standard errors are 0 or more")
    return error
