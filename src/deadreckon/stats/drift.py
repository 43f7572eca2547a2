"""Whether new samples are distributed as earlier ones: permutation tests over whole units, for many columns at once.

Rows of an episode are not independent, so whole units (episodes, or clusters of them) are exchanged and never rows. Each column
is described by 0/1 features of its rows (is the value at most a quantile; is it this level), of which a unit has the sum. The
statistic of a column is the largest studentised difference of its features' means, and a column is compared with the largest
statistic of *all* columns under a permutation (maxT: Westfall and Young 1993). So the probability that any column is reported
is at most alpha if units are exchangeable, whatever the dependence between columns.

**Repeated looks** are valid because tests are made only at fixed numbers of units: after 20, 40, 80, ... new units (`epochs`),
of which the k-th has the share 1 / (k (k + 1)) of alpha. All are computed again from the whole log at each look, so results do
not depend on how often and when one looks.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

FIRST = 20  # new units before the first test
MOST = 4_000  # most units of either sample in a test; of more, a random sample is used
THRESHOLDS = 16  # quantiles at which the distribution of numbers is compared
ENOUGH = 20  # permutations at least as extreme after which sampling stops (Besag and Clifford 1991)
BLOCK = 256  # permutations at a time
# Differences that are none: the same numbers may come with fewer decimals (a ten-thousandth of the shortest range of nine
# tenths, but no more than a thousandth of their own size), or from another order of operations in 32 bits.
SAME, OWN, ROUNDING = 1e-4, 1e-3, 5e-7


class Epoch(NamedTuple):
    """A test that is made once there are `stop` new units.

    Attributes:
        start, stop: the new units that are compared.
        alpha: its probability of a false alarm.
    """

    start: int
    stop: int
    alpha: float


def epochs(units: int, alpha: float) -> list[Epoch]:
    """The tests that are due after so many new units: at each size one of all new units, and one of their newer half.

    The latter detect late changes. The probabilities of a false alarm of all possible tests add up to `alpha`.
    """
    out, stop, k = [], FIRST, 1
    while stop <= units:
        share = alpha / (k * (k + 1))
        if k == 1:
            out.append(Epoch(0, stop, share))
        else:
            out += [Epoch(0, stop, share / 2), Epoch(stop // 2, stop, share / 2)]
        stop, k = 2 * stop, k + 1
    return out


def number_features(reference: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rows, thresholds) 0/1 features of numbers: whether each is at most a quantile of both samples together.

    Numbers just above a quantile count as equal to it: without that, an atom (a bound at which actions saturate) that one
    sample holds with fewer decimals than the other would be on both sides of a threshold.
    """
    reference, new = np.asarray(reference, np.float64), np.asarray(new, np.float64)
    pooled = np.concatenate([reference, new])
    cuts = np.unique(np.quantile(pooled, np.linspace(0, 1, THRESHOLDS + 2)[1:-1], method="inverted_cdf"))
    inner, ordered = int(0.9 * len(pooled)), np.sort(pooled)
    usual = (ordered[inner:] - ordered[: len(ordered) - inner]).min()
    cuts = np.unique(cuts + np.abs(cuts) * ROUNDING + np.minimum(SAME * usual, OWN * np.abs(cuts)))
    cuts = cuts[cuts < pooled.max()]
    return (reference[:, None] <= cuts).astype(np.float32), (new[:, None] <= cuts).astype(np.float32)


def test(
    reference: Sequence[np.ndarray], new: Sequence[np.ndarray], sizes: tuple[np.ndarray, np.ndarray], alpha: float,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """p-values of columns, corrected for their number: without a change, any is at most alpha with probability alpha or less.

    Args:
        reference: for each column (units, features) sums of its features over the rows of each unit.
        new: the same of the new units.
        sizes: (units,) rows of each unit of the reference, and of the new ones.
        alpha: level of the test, which determines the largest number of permutations.
        rng: generator of the permutations.

    Returns:
        (columns,) p-values.
    """
    few, many = len(sizes[1]), len(sizes[0]) + len(sizes[1])
    rows = np.concatenate(sizes).astype(np.float64)
    parts, owner = [], []
    for which, (a, b) in enumerate(zip(reference, new)):
        sums = np.concatenate([a, b]).astype(np.float64)
        # Sums of a unit minus those that are expected for its number of rows; these differences add up to zero.
        rest = sums - rows[:, None] * (sums.sum(0) / rows.sum())
        spread = np.sqrt(few * (many - few) / (many * (many - 1)) * np.square(rest).sum(0))
        varies = spread > 1e-9
        parts.append((rest[:, varies] / spread[varies]).astype(np.float32))
        owner += [which] * int(varies.sum())
    table, owners = np.concatenate(parts, 1), np.array(owner, int)
    found = np.zeros(len(reference))
    np.maximum.at(found, owners, np.abs(table[many - few :].sum(0)))
    if not table.shape[1]:
        return np.ones(len(reference))
    beyond, done, most = np.zeros(len(reference)), 0, int(np.ceil(2 / alpha))
    while done < most and beyond[np.argmax(found)] < ENOUGH:
        chosen = np.zeros((BLOCK, many), np.float32)
        for row in chosen:
            row[rng.choice(many, few, replace=False)] = 1.0
        largest = np.abs(chosen @ table).max(1)
        beyond += (largest[:, None] >= found[None] - 1e-5).sum(0)
        done += BLOCK
    return (beyond + 1) / (done + 1)


def beyond(reference: np.ndarray, new: np.ndarray) -> np.ndarray:
    """(columns,) probabilities that, without a change, so many new units lie beyond all of the reference.

    The k largest of exchangeable units are all new with probability prod_i (m - i) / (m + n - i): m new ones, n others.

    Args:
        reference: (n, columns) the largest value of each unit.
        new: (m, columns) the same of new units.
    """
    m, n = len(new), len(reference)
    counts = (new > reference.max(0)).sum(0)
    steps = np.arange(m)
    chances = np.concatenate([[1.0], np.cumprod((m - steps) / (m + n - steps))])
    return chances[counts]
