"""Proposals in regions where runs have no score, which may be because they failed: models know nothing of failures.

Two rules say that failures prevail around a proposal: by the designs of the table that are nearest to it, and by a regression
of failures on the inputs, which shows a direction in which they become more frequent, as towards the highest temperatures.
"""

import numpy as np
from scipy.special import bdtrc, fdtrc

from deadreckon.mbo.designs import Designs

NEAREST = 5  # designs of the table around a proposal
LEVEL = 0.01  # probability that as many of them have no score, if rows without one lie anywhere
MANY = 0.1  # share of the proposals from which on it is told of them together
SURE = 0.01  # error probability of the regression
TIMES, OFTEN = 3.0, 0.2  # how many times as frequent as in the table failures must be by it, and the least share
ROWS = 5  # least rows for each regressor


def failures(data: Designs) -> np.ndarray:
    """(k, variables) different designs whose runs may have failed: those without any score that are not planned."""
    if data.unscored is None:
        return data.x[:0]
    some = np.unique(data.unscored if data.passed is None else data.unscored[data.passed], axis=0)
    known = {row.tobytes() for row in data.x}
    return some[[row.tobytes() not in known for row in some]] if len(some) else some


def missing_near(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) how many of the `NEAREST` scored designs and `failures` nearest to each of (n, variables) designs are failures."""
    if not len(others := failures(data)):
        return np.zeros(len(x), int)
    with np.errstate(divide="ignore", invalid="ignore"):
        z, points = data.coordinates.place(np.concatenate([data.x, others])), data.coordinates.place(x)
    z[~np.isfinite(z).all(1)] = np.inf  # a run may have 0 on a log scale
    missing = np.arange(len(z)) >= len(data)
    return np.array([missing[np.argsort(np.linalg.norm(z - point, axis=1), kind="stable")[:NEAREST]].sum() for point in points])


def prevail(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) bool: whether failures are more frequent around each of (n, variables) designs than in the table."""
    near, count = missing_near(data, x), len(failures(data))
    share = count / (len(data) + count)
    around = (near > 1) & ((bdtrc(near - 1, NEAREST, share) < LEVEL) | (near == NEAREST))
    return around | (_expected(data, x) >= max(TIMES * share, OFTEN))


def _expected(data: Designs, x: np.ndarray) -> np.ndarray:
    """(n,) share of failures at (n, variables) designs by linear regression on the coordinates; 0 if that explains nothing."""
    others = failures(data)
    with np.errstate(divide="ignore", invalid="ignore"):
        z, points = (data.coordinates.place(each) for each in (np.concatenate([data.x, others]), x))
    missing = np.arange(len(z)) >= len(data)
    known = np.isfinite(z).all(1)
    z, missing = z[known], missing[known].astype(np.float64)
    varied = np.ptp(z, axis=0) > 0
    z, points = z[:, varied], points[:, varied]
    rows, size = z.shape
    if missing.sum() < 2 or rows < ROWS * (size + 1):
        return np.zeros(len(x))
    weights = np.linalg.lstsq(np.column_stack([np.ones(rows), z]), missing, rcond=None)[0]
    left = np.square(missing - weights[0] - z @ weights[1:]).sum()
    explained = np.square(missing - missing.mean()).sum() - left
    freedom = rows - size - 1
    if left > 0 and fdtrc(size, freedom, explained / size / (left / freedom)) >= SURE:
        return np.zeros(len(x))
    return weights[0] + points @ weights[1:]


def unscored_told(data: Designs, x: np.ndarray) -> list[str]:
    """A message if many of (n, variables) proposals lie where rows without a score prevail."""
    count = int(prevail(data, x).sum())
    if count <= MANY * (len(x) - 1):
        return []
    return [
        f"{count:,} of {len(x):,} proposals {'lies' if count == 1 else 'lie'} where rows without {data.target} prevail: if "
        "these runs failed, proposals there may fail, too; give failed runs a score, such as the worst one, as models know "
        "nothing of rows without one"
    ]
