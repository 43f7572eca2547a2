"""Whether values in an order depend on those before them. Tests that exchange values are wrong for such values."""

import numpy as np
from scipy.special import chdtrc

from deadreckon.stats.ranks import spearman

LEAST = 100  # values below which nothing is said of dependence
ALIKE, ERRORS = 0.2, 5.0  # by which a rank correlation must be above 0: in itself, and in standard errors
SOON = 3.0  # standard errors, where a wrong answer only delays a test
RARE = 0.98  # probability that two values are equal, from which on there are too few others
PARTS = 20  # parts of a sequence whose mean ranks are compared
EVENTS = 5  # least expected number of values other than the most frequent one in each part
LEVEL, SHARE = 0.001, 0.01  # error probability, and least share of the variance between parts, of that comparison


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
    from scipy.stats import rankdata  # slow to import, and few need it

    n = len(values)
    others = n - int(np.unique(values, return_counts=True)[1].max())
    count = min(PARTS, others // EVENTS)
    if count < 2:
        return False
    ranks, part = rankdata(values), np.arange(n) * count // n
    sizes = np.bincount(part)
    between = float((sizes * np.square(np.bincount(part, ranks) / sizes - ranks.mean())).sum() / ranks.var(ddof=1))
    share = (between - (count - 1)) / (n - 1)
    return share > SHARE and float(chdtrc(count - 1, between)) < LEVEL


def follows(values: np.ndarray) -> bool:
    """Whether neighbours of (n,) values are alike beyond what changes of their level explain.

    By the correlation r of successive differences of ranks: 1 + 2 r estimates the correlation of neighbours, also if the level
    changes now and then, because a change is in one difference only. Its standard error is sqrt(2 / n) for independent values.
    """
    from scipy.stats import rankdata  # slow to import, and few need it

    n = len(values)
    if not several(values):
        return False
    steps = np.diff(rankdata(values))
    steps = steps - steps.mean()
    return 1.0 + 2.0 * float((steps[1:] * steps[:-1]).mean() / np.square(steps).mean()) > max(ALIKE, SOON * np.sqrt(2 / n))
