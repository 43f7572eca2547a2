"""Proposals in regions where runs have no score, which may be because they failed: models know nothing of failures."""

import numpy as np
from scipy.special import bdtrc

from deadreckon.mbo.designs import Designs

NEAREST = 5  # designs of the table around a proposal
LEVEL = 0.05  # probability that as many of them have no score, if rows without one lie anywhere


def failures(data: Designs) -> np.ndarray:
    """(k, variables) complete designs whose runs may have failed: those without a score that are not planned."""
    if data.unscored is None:
        return data.x[:0]
    return data.unscored if data.passed is None else data.unscored[data.passed]


def missing_near(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) how many of the `NEAREST` scored designs and `failures` nearest to each of (n, variables) designs are failures."""
    if not len(others := failures(data)):
        return np.zeros(len(x), int)
    with np.errstate(divide="ignore", invalid="ignore"):
        z, points = data.coordinates.place(np.concatenate([data.x, others])), data.coordinates.place(x)
    z[~np.isfinite(z).all(1)] = np.inf  # a run may have 0 on a log scale
    missing = np.arange(len(z)) >= len(data)
    return np.array([missing[np.argsort(np.linalg.norm(z - point, axis=1), kind="stable")[:NEAREST]].sum() for point in points])


def prevail(data: Designs, near: np.ndarray) -> np.ndarray:
    """(n,) bool: whether failures are more frequent there than in the table, from the numbers of `missing_near`."""
    count = len(failures(data))
    share = count / (len(data) + count)
    return (near > 1) & ((bdtrc(near - 1, NEAREST, share) < LEVEL) | (near == NEAREST))


def unscored_told(data: Designs, x: np.ndarray) -> list[str]:
    """A message if many of (n, variables) proposals lie where rows without a score prevail."""
    count = int(prevail(data, missing_near(data, x)).sum())
    if not count:
        return []
    return [
        f"{count:,} of {len(x):,} proposals {'lies' if count == 1 else 'lie'} where rows without {data.target} prevail: if "
        "these runs failed, proposals there may fail, too; give failed runs a score, such as the worst one, as models know "
        "nothing of rows without one"
    ]
