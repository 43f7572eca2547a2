"""Whether scores changed along a table for other reasons than the inputs, which makes inputs that changed with them look good.

In a campaign whose settings move from run to run, a drift of the process or of the instrument seems to be the effect of these
settings. The test asks whether scores go with slow waves of the row's number beyond what the inputs explain: both sides are
predicted from the inputs, each row by the others, and the residuals should not go together (the partially linear model of
Robinson 1988; Chernozhukov et al. 2018). Predictions are by kernel ridge regression, whose residuals of left-out rows have a
closed form.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.distance import pdist, squareform

from deadreckon.randomness import generator
from deadreckon.stats.interval import p_in_words
from deadreckon.stats.products import p_of_products
from deadreckon.stats.ranks import spearman

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

LEVEL = 0.01  # probability of a message if nothing changed
LEAST, MOST = 30, 500  # fewest rows for a test, and most that are tested
WAVES = 2  # half a period over the table, and one: with few rows, more would cost power
SORTED = 0.98  # rank correlation with the row's number above which a table is in the order of its scores
EXPLAINED = 0.95  # share of a wave that inputs explain, above which the table is in their order
NAMED = 3  # inputs named
_SCALES = (0.5, 1.0, 2.0, 4.0)  # length scales of the kernel, in median distances
_RIDGES = np.geomspace(1e-5, 1.0, 11)  # for each row


def about_order(data: "Designs") -> list[str]:
    """A message if scores and inputs changed along the table together, but not because of each other.

    Args:
        data: designs in the order of their table, replicates not pooled.
    """
    if len(data) < LEAST or abs(spearman(data.y, np.arange(float(len(data))))) > SORTED:
        return []
    moved = _moved(data)
    if not moved or (p_value := p_of_change(data)) >= LEVEL:
        return []
    which = ", ".join(f"{name} (rank correlation with the row {one:.2f})" for name, one in moved)
    return [
        f"{data.target} changed along the table beyond what the inputs explain ({p_in_words(p_value)}), and so did {which}: if "
        "rows are in the order of time, such an input may only seem to matter; give the number or time of the run as another "
        "input, and fix it at its latest value (--fix COLUMN=VALUE)"
    ]


def p_of_change(data: "Designs") -> float:
    """The p-value of no change of the scores along the table beyond what inputs explain; 1 if the inputs tell the order."""
    rows = np.arange(len(data))
    if len(data) > MOST:
        rows = np.sort(generator(0, "order").choice(len(data), MOST, replace=False))
    z = data.coordinates.place(data.x[rows])
    z = (z - z.mean(0)) / np.where(z.std(0) > 0, z.std(0), 1.0)
    waves = np.cos(np.pi * ((rows + 0.5) / len(data))[:, None] * np.arange(1, WAVES + 1))
    left = left_out(z, np.column_stack([data.y[rows] / max(float(data.y[rows].std()), 1e-300), waves]))
    unexplained = np.square(left[:, 1:]).mean(0) / waves.var(0)
    return p_of_products(left[:, :1], left[:, 1:][:, unexplained > 1.0 - EXPLAINED], data.units[rows])


def left_out(z: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(rows, k) errors of predictions of each row from all others, by the kernel and ridge with the least errors of a target.

    Args:
        z: (rows, features), standardised.
        targets: (rows, k).
    """
    count = len(z)
    best = (targets - targets.mean(0)) * count / (count - 1)  # of the mean of the others
    least = np.square(best).mean(0)
    apart = pdist(z, "sqeuclidean")
    square, usual = squareform(apart), float(np.median(apart)) or 1.0
    linear = 1.0 + 0.3 * z @ z.T / max(float(np.square(z).sum(1).mean()), 1e-300)
    for scale in _SCALES:
        values, vectors = np.linalg.eigh(np.exp(-square / (2.0 * scale**2 * usual)) + linear)
        values, turned = np.maximum(values, 0.0), vectors.T @ targets
        for ridge in _RIDGES:
            kept = values / (values + ridge * count)
            errors = (targets - vectors @ (kept[:, None] * turned)) / np.maximum(1.0 - np.square(vectors) @ kept, 1e-9)[:, None]
            found = np.square(errors).mean(0)
            better = found < least
            least = np.where(better, found, least)
            best[:, better] = errors[:, better]
    return best


def _moved(data: "Designs") -> list[tuple[str, float]]:
    """Inputs that changed along the table, and their rank correlations with the row's number; the largest first."""
    found = []
    for v, values in zip(data.variables, data.x.T):
        if v.kind != "categorical" and np.ptp(values) > 0:
            found.append((v.name, spearman(values.astype(float), np.arange(float(len(data))))))
    # A normal approximation, by Bonferroni; the alternative that matters is far away.
    limit = 3.0 / np.sqrt(len(data) - 3)
    moved = sorted((each for each in found if abs(each[1]) > limit), key=lambda each: -abs(each[1]))
    return moved[:NAMED]
