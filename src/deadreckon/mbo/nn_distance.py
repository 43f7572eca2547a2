"""Distances of designs from scored ones: for distant designs, no data supports a model's predictions."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

SAMPLE = 1000  # largest number of designs of the data from which the typical distance is computed


def nn_distance(data: "Designs", x: np.ndarray) -> np.ndarray:
    """Distance of designs to the nearest scored one (`Coordinates.place`), in typical distances.

    Args:
        data: scored designs.
        x: (n, variables) designs.

    Returns:
        (n,) distances divided by `Designs.usual_distance`: 1 is typical of neighbours in the data, 10 is far away.
    """
    return nearest_scored(data, x)[0] / data.usual_distance


def distance_to_others(data: "Designs", x: np.ndarray) -> np.ndarray:
    """(n,) distance of each of two or more designs to the nearest other one, in the same units."""
    z = data.coordinates.place(x)
    return _nearest(z, z, np.arange(len(z)))[0] / data.usual_distance


def usual_distance(data: "Designs") -> float:
    """The typical distance: median distance of a scored design to the nearest one of another recipe; 1 if all are the same.

    It is measured in the space of `Coordinates.place`. Logged settings differ a little between runs of one recipe, and these
    differences are not those between recipes.
    """
    z = data.coordinates.place(data.x)
    rows = np.random.default_rng(0).permutation(len(z))[:SAMPLE]
    usual = _nearest(z, z[rows], rows)[0]
    if (alike := data.recipes).max() + 1 < len(z):
        usual[usual > 0] = _nearest(z, z[rows[usual > 0]], rows[usual > 0], alike)[0]
    return float(np.median(usual[usual > 0])) if (usual > 0).any() else 1.0


def tried(data: "Designs") -> np.ndarray:
    """(rows, variables) all complete designs of the table: scored ones, and tried or planned ones without a score."""
    return data.x if data.unscored is None else np.concatenate([data.x, data.unscored])


def distance_to_tried(data: "Designs", x: np.ndarray) -> np.ndarray:
    """(n,) distances of designs to the nearest complete one of the table, scored or not (`Coordinates.place`)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = data.coordinates.place(tried(data))
    z = z[np.isfinite(z).all(1)]  # a planned run may have 0 on a log scale
    return _nearest(z, data.coordinates.place(x))[0]


def nearest_scored(data: "Designs", x: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distances of designs to the nearest scored one (`Coordinates.place`), and (n,) its row.

    Args:
        data: scored designs.
        x: (n, variables) designs.
        among: (k,) rows of the data that count, at least one; None: all.
    """
    among = np.arange(len(data)) if among is None else among
    far, nearest = _nearest(data.coordinates.place(data.x[among]), data.coordinates.place(x))
    return far, among[nearest]


def neighbours(data: "Designs", x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The scored designs that are nearest to each of (n, variables) designs, the nearest first.

    Returns:
        (n, count) distances, in typical distances like `nn_distance`, and (n, count) rows of the data; fewer columns if the
        data has fewer designs.
    """
    z, points = (data.coordinates.place(each) for each in (data.x, x))
    count, out = min(count, len(z)), []
    for point in points:
        distance = np.linalg.norm(z - point, axis=1)
        some = np.argpartition(distance, count - 1)[:count]
        some = some[np.lexsort((some, distance[some]))]
        out.append((distance[some], some))
    far, rows = (np.stack(each) for each in zip(*out))
    return far / data.usual_distance, rows


def _nearest(
    z: np.ndarray, points: np.ndarray, own: np.ndarray | None = None, alike: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distances of points to the nearest row of `z`, and (n,) these rows.

    Args:
        z: (rows, features) of `Coordinates.place`.
        points: (n, features) likewise.
        own: (n,) the row of `z` that each point is, which is excluded; None: points are not among the rows.
        alike: (rows,) recipe of each row; all rows of the point's recipe are excluded. None: only the point's row is.
    """
    squares, out, rows = np.square(z).sum(1), np.empty(len(points)), np.empty(len(points), int)
    alike = np.arange(len(z)) if alike is None else alike
    for i in range(0, len(points), 64):
        block = points[i : i + 64]
        distance = np.square(block).sum(1)[:, None] + squares - 2 * block @ z.T
        if own is not None:
            distance[alike[own[i : i + 64], None] == alike] = np.inf
        # The difference of large numbers is not exact, so the distance of the nearest one is computed again.
        rows[i : i + 64] = nearest = distance.argmin(1)
        out[i : i + 64] = np.linalg.norm(block - z[nearest], axis=1)
    return out, rows
