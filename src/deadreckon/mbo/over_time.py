"""Whether scores changed along a table for other reasons than the inputs, which makes inputs that changed with them look good.

In a campaign whose settings move from run to run, a drift of the process or of the instrument seems to be the effect of these
settings. The test asks whether scores go with slow waves of the row's number beyond what the inputs explain: both sides are
predicted from the inputs, each recipe by the others, and the residuals should not go together (the partially linear model of
Robinson 1988; Chernozhukov et al. 2018). Predictions are by kernel ridge regression, whose residuals of left-out rows have a
closed form.
"""

from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.distance import pdist, squareform

from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words
from deadreckon.stats.products import p_of_products
from deadreckon.stats.ranks import sorted_by, spearman_of_each

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

LEVEL = 0.01  # probability of a message if nothing changed
LEAST, MOST = 30, 500  # fewest rows for a test, and most that are tested
GROUPS = 8  # fewest groups, whose rows are not independent
WAVES = 2  # half a period over the table, and one: with few rows, more would cost power
EXPLAINED = 0.95  # share of a wave that inputs explain, above which the table is in their order
MOVED = 0.01  # error probability of the tests whether any input changed along the table (Bonferroni)
NAMED = 3  # inputs named
_SCALES = (0.5, 1.0, 2.0, 4.0)  # length scales of the kernel, in median distances
_RIDGES = np.geomspace(1e-5, 1.0, 11)  # for each row


def about_order(data: "Designs") -> list[str]:
    """A message if scores and inputs changed along the table together, but not because of each other.

    Args:
        data: designs in the order of their table, replicates not pooled.
    """
    if len(data) < LEAST or sorted_by(data.y):
        return []
    moved = _moved(data)
    if not len(moved) or (p_value := p_of_change(data, moved)) >= LEVEL:
        return []
    names = [data.variables[i].name for i in moved[:NAMED]]
    which = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return [
        f"{data.target} changed along the table beyond what the inputs explain ({p_in_words(p_value)}), and so did {which}: if "
        "rows are in the order of time, such an input may only seem to matter; give the number or time of the run as another "
        "input, and fix it at its latest value (--fix COLUMN=VALUE)"
    ]


def p_of_change(data: "Designs", moved: np.ndarray) -> float:
    """The p-value of no change of the scores along the table beyond what inputs explain; 1 if the inputs tell the order, or if
    there are too few groups.

    Args:
        data: designs in the order of their table.
        moved: indices of the variables that changed along it.
    """
    rows, z, units = sampled(data, MOST, "order")
    # Errors of replicates in a row are alike, as predictions leave them all out.
    cluster = np.cumsum(np.append(0, np.diff(units) != 0)) if data.groups is None else data.groups[rows]
    y = data.y[rows] - data.y[rows].mean()
    if len(np.unique(cluster)) < GROUPS or units.max() < 1 or not y.std():
        return 1.0
    # With many inputs, distances hardly depend on those that changed along the table: these count more in further kernels.
    counts = np.isin(data.coordinates.place_owners, moved)
    views = [z]
    if 0 < counts.sum() < len(counts):
        alike = np.sqrt((~counts).sum() / counts.sum())
        views += [z * np.where(counts, factor * alike, 1.0) for factor in (1.0, 3.0)]
    waves = _waves(data)[rows]
    left = left_out(views, np.column_stack([y / y.std(), waves]), units)
    unexplained = np.square(left[:, 1:]).mean(0) / waves.var(0)
    return p_of_products(left[:, :1], left[:, 1:][:, unexplained > 1.0 - EXPLAINED], cluster, centred=True)


def sampled(data: "Designs", most: int, purpose: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) rows of the data, at most `most`, their (n, features) standardised coordinates, and (n,) their units, 0, 1, ...; the
    rows are drawn for a purpose of randomness."""
    rows = np.arange(len(data))
    if len(data) > most:
        rows = np.sort(generator(0, purpose).choice(len(data), most, replace=False))
    z = data.coordinates.place(data.x[rows])
    z = (z - z.mean(0)) / np.where(z.std(0) > 0, z.std(0), 1.0)
    return rows, z, np.unique(data.units[rows], return_inverse=True)[1]


def _waves(data: "Designs") -> np.ndarray:
    """(rows, WAVES) cosines along the table."""
    return np.cos(np.pi * ((np.arange(len(data)) + 0.5) / len(data))[:, None] * np.arange(1, WAVES + 1))


def left_out(views: Sequence[np.ndarray], targets: np.ndarray, units: np.ndarray) -> np.ndarray:
    """(rows, k) errors of predictions of the rows of each unit, such as replicates, from all others: by the mean, or by the
    kernel and ridge with the least errors of a target.

    Args:
        views: (rows, features) each, of which distances are measured.
        targets: (rows, k).
        units: (rows,) 0, 1, ..., the unit of each row; two at least.
    """
    count, size = len(targets), np.bincount(units)[:, None]
    own = np.stack([np.bincount(units, each) for each in targets.T], 1)
    best = targets - ((targets.sum(0) - own) / (count - size))[units]
    least = np.square(best).mean(0)
    several = [np.flatnonzero(units == each) for each in np.flatnonzero(size[:, 0] > 1)]
    for view in views:
        apart = pdist(view, "sqeuclidean")
        square, usual = squareform(apart), float(np.median(apart)) or 1.0
        linear = 1.0 + 0.3 * view @ view.T / max(float(np.square(view).sum(1).mean()), 1e-300)
        for scale in _SCALES:
            values, vectors = np.linalg.eigh(np.exp(-square / (2.0 * scale**2 * usual)) + linear)
            values, turned = np.maximum(values, 0.0), vectors.T @ targets
            for ridge in _RIDGES:
                kept = values / (values + ridge * count)
                fitted = targets - vectors @ (kept[:, None] * turned)
                errors = fitted / np.maximum(1.0 - np.square(vectors) @ kept, 1e-9)[:, None]
                for rows in several:
                    part = np.eye(len(rows)) - (vectors[rows] * kept) @ vectors[rows].T
                    errors[rows] = np.linalg.solve(part, fitted[rows])
                found = np.square(errors).mean(0)
                better = found < least
                least = np.where(better, found, least)
                best[:, better] = errors[:, better]
    return best


def _moved(data: "Designs") -> np.ndarray:
    """Variables that changed along the table: a feature of theirs goes with a wave, by ranks; the most related first."""
    features, found = data.coordinates.place(data.x).T, np.zeros(len(data.variables))
    for wave in _waves(data).T:
        related = spearman_of_each(features, np.broadcast_to(wave, features.shape))
        np.maximum.at(found, data.coordinates.place_owners, np.abs(np.nan_to_num(related)))
    limit = NormalDist().inv_cdf(1 - MOVED / (2 * WAVES * len(features))) / np.sqrt(len(data) - 3)
    order = np.argsort(-found, kind="stable")
    return order[found[order] > limit]
