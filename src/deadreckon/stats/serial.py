"""Whether values in an order depend on those before them. Tests that exchange values are wrong for such values."""

import numpy as np
from scipy.special import chdtrc

from deadreckon.stats.ranks import spearman

LEAST = 100  # values below which nothing is said of dependence
ALIKE, ERRORS = 0.2, 5.0  # by which a rank correlation must be above 0: in itself, and in standard errors
SOON = 2.0  # standard errors from which on `follows` says so: a wrong answer only delays a test
SHORT = 10  # values below which they are not said to follow each other
FADED = 0.1  # share of the correlation of neighbours below which values no longer depend on each other
RARE = 0.98  # probability that two values are equal, from which on there are too few others
PARTS = 20  # parts of a sequence whose mean ranks are compared
EVENTS = 5  # least expected number of values other than the most frequent one in each part
LEVEL, SHARE = 0.001, 0.01  # error probability, and least share of the variance between parts, of that comparison


def _ranks(values: np.ndarray) -> np.ndarray:
    from scipy.stats import rankdata  # slow to import, and few need it

    return rankdata(values)


def several(values: np.ndarray) -> bool:
    """Whether (n,) values differ often enough for a correlation: of a rare one, two neighbours that are alike suffice."""
    shares = np.unique(values, return_counts=True)[1] / len(values)
    return bool(np.square(shares).sum() <= RARE)


def depends(values: np.ndarray) -> bool:
    """Whether (n,) values depend on those before: neighbours are alike, or parts of the sequence differ more than by chance.

    The second finds a slow dependence that noise hides from neighbours. It is the test of Kruskal and Wallis (1952) of up to
    `PARTS` parts of equal length. A change of level counts as dependence, too.
    """
    n = len(values)
    if n < LEAST or not several(values):
        return False
    return spearman(values[:-1], values[1:]) > max(ALIKE, ERRORS / np.sqrt(n)) or _parts_differ(values)


def _parts_differ(values: np.ndarray) -> bool:
    n = len(values)
    others = n - int(np.unique(values, return_counts=True)[1].max())
    count = min(PARTS, others // EVENTS)
    if count < 2:
        return False
    ranks, part = _ranks(values), np.arange(n) * count // n
    sizes = np.bincount(part)
    between = float((sizes * np.square(np.bincount(part, ranks) / sizes - ranks.mean())).sum() / ranks.var(ddof=1))
    share = (between - (count - 1)) / (n - 1)
    return share > SHARE and float(chdtrc(count - 1, between)) < LEVEL


def together(values: np.ndarray) -> int:
    """The number of successive (n,) values that depend on those before to take as one: twice the lag at which their rank
    correlation has fallen to a tenth of that of neighbours, or to two standard errors, as a power of two, so that columns that
    are alike are compared together. At most n / `PARTS`, also where noise hides how far the dependence reaches."""
    n = len(values)
    most = max(-(-n // PARTS), 1)
    ranks = _ranks(values) - (n + 1) / 2
    correlation = np.fft.irfft(np.abs(np.fft.rfft(ranks, 2 * n)) ** 2)[:n]
    near = correlation[1] / correlation[0]
    if near < max(ALIKE, ERRORS / np.sqrt(n)):
        return most
    faded = np.flatnonzero(correlation[1:] / correlation[0] < max(FADED * near, 2 / np.sqrt(n)))
    return min(2 ** int(np.ceil(np.log2(2 * (faded[0] + 1)))), most) if len(faded) else most


def follows(values: np.ndarray, errors: float = SOON) -> bool:
    """Whether neighbours of (n,) values are alike beyond what changes of their level explain.

    By the correlation r of successive differences of ranks: 1 + 2 r estimates the correlation of neighbours, also if the level
    changes now and then, because a change is in one difference only. Its standard error is sqrt(2 / n) for independent values.
    """
    n = len(values)
    if n < SHORT or not several(values):
        return False
    steps = np.diff(_ranks(values))
    steps = steps - steps.mean()
    if not steps.any():  # in order, one after the other
        return True
    return 1.0 + 2.0 * float((steps[1:] * steps[:-1]).mean() / np.square(steps).mean()) > max(ALIKE, errors * np.sqrt(2 / n))
