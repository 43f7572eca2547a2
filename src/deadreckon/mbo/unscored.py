"""Proposals in regions where runs have no score, which may be because they failed: models know nothing of failures."""

import numpy as np
from scipy.special import bdtrc

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import tried

NEAREST = 5  # designs of the table around a proposal
LEVEL = 0.05  # probability that as many of them have no score, if rows without one lie anywhere


def missing_near(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) how many of the `NEAREST` complete designs of the table nearest to each of (n, variables) designs have no score."""
    if data.unscored is None:
        return np.zeros(len(x), int)
    with np.errstate(divide="ignore", invalid="ignore"):
        z, points = data.coordinates.place(tried(data)), data.coordinates.place(x)
    z[~np.isfinite(z).all(1)] = np.inf  # a planned run may have 0 on a log scale
    missing = np.arange(len(z)) >= len(data)
    return np.array([missing[np.argsort(np.linalg.norm(z - point, axis=1), kind="stable")[:NEAREST]].sum() for point in points])


def prevail(data: Designs, near: np.ndarray) -> np.ndarray:
    """(n,) bool: whether rows without a score are more frequent there than in the table, from the numbers of `missing_near`."""
    if data.unscored is None:
        return np.zeros(len(near), bool)
    share = len(data.unscored) / (len(data) + len(data.unscored))
    return (near > 1) & ((bdtrc(near - 1, NEAREST, share) < LEVEL) | (near == NEAREST))


def unscored_told(data: Designs, x: np.ndarray) -> list[str]:
    """A message if many of (n, variables) proposals lie where rows without a score prevail."""
    count = int(prevail(data, missing_near(data, x)).sum())
    if not count:
        return []
    return [
        f"{count:,} of {len(x):,} proposals {'lies' if count == 1 else 'lie'} where rows without {data.target} prevail: if "
        "these runs failed, proposals there may fail, too; give failed runs a score that says so, as models know nothing of "
        "rows without one"
    ]
