"""How far designs lie from those that have a score: what a model says of far ones rests on nothing."""

import numpy as np

from deadreckon.mbo.designs import Designs

SAMPLE = 1000  # designs of the data whose neighbours tell what near is


def nn_distance(data: Designs, x: np.ndarray) -> np.ndarray:
    """Distance of designs to the nearest scored one (`Coordinates.place`), in units of what is usual among the data.

    Args:
        data: scored designs.
        x: (n, variables) designs.

    Returns:
        (n,) distances over the typical one (`usual_distance`): 1 is as near as the data's own neighbours are, 10 is far out.
    """
    return nearest_scored(data, x)[0] / usual_distance(data)


def distance_to_others(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) distance of each of two or more designs to the nearest other one, in the same units."""
    z = data.coordinates.place(x)
    return _nearest(z, z, np.arange(len(z)))[0] / usual_distance(data)


def usual_distance(data: Designs) -> float:
    """Median distance of a scored design to the nearest one of another recipe, by their places; 1 where all are repeated.

    Settings that are logged differ a little between runs of one recipe, which says nothing of how far recipes lie apart.
    """
    z = data.coordinates.place(data.x)
    rows = np.random.default_rng(0).permutation(len(z))[:SAMPLE]
    usual = _nearest(z, z[rows], rows)[0]
    if (alike := data.recipes).max() + 1 < len(z):
        usual[usual > 0] = _nearest(z, z[rows[usual > 0]], rows[usual > 0], alike)[0]
    return float(np.median(usual[usual > 0])) if (usual > 0).any() else 1.0


def nearest_scored(data: Designs, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distances of designs to the nearest scored one, by their places, and (n,) the rows of these."""
    return _nearest(data.coordinates.place(data.x), data.coordinates.place(x))


def neighbours(data: Designs, x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The scored designs that are nearest to each of (n, variables) designs, the nearest first.

    Returns:
        (n, count) distances, in typical distances as `nn_distance` has them, and (n, count) rows of the data; fewer columns
        where the data has fewer designs.
    """
    z, points = (data.coordinates.place(each) for each in (data.x, x))
    count, out = min(count, len(z)), []
    for point in points:
        distance = np.linalg.norm(z - point, axis=1)
        some = np.argpartition(distance, count - 1)[:count]
        some = some[np.lexsort((some, distance[some]))]
        out.append((distance[some], some))
    far, rows = (np.stack(each) for each in zip(*out))
    return far / usual_distance(data), rows


def _nearest(
    z: np.ndarray, points: np.ndarray, own: np.ndarray | None = None, alike: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distances of points to the nearest row of `z`, and (n,) these rows.

    Args:
        z: (rows, features) places.
        points: (n, features) places.
        own: (n,) the row that each point is, which does not count; None: points are others.
        alike: (rows,) recipe of each row; those of the own row's do not count either. None: its own alone.
    """
    squares, out, rows = np.square(z).sum(1), np.empty(len(points)), np.empty(len(points), int)
    alike = np.arange(len(z)) if alike is None else alike
    for i in range(0, len(points), 64):
        block = points[i : i + 64]
        distance = np.square(block).sum(1)[:, None] + squares - 2 * block @ z.T
        if own is not None:
            distance[alike[own[i : i + 64], None] == alike] = np.inf
        # The difference of large numbers is not exact: the nearest one's distance is taken anew.
        rows[i : i + 64] = nearest = distance.argmin(1)
        out[i : i + 64] = np.linalg.norm(block - z[nearest], axis=1)
    return out, rows
