"""Solutions of equalities in whole numbers of grid steps, near a point that nearly satisfies them.

With n_i the value of a variable in steps and W_i integer weights, W_1 n_1 + W_2 n_2 + ... = T has solutions near almost every
point if at least three variables may change: offsets of two of them within a window are tried, and the remainder must be
divisible by the weight of the third, the pivot. Two equalities at once have two pivots, with their determinant in place of the
weight. Branch and bound takes minutes for weights such as molar masses, for which nearly all relaxations are feasible.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

import numpy as np

MOST = 1_500_000  # largest number of combinations of a pair's offsets
PAIRS = 4  # largest number of pairs of variables that are tried until one has a solution
AT_ONCE = 2  # largest number of equalities that are solved together
_LARGEST = 2**62


@dataclass(frozen=True)
class System:
    """Equalities of weighted sums of the same variables.

    Attributes:
        columns: (n,) columns of the designs that may change.
        steps: (n,) steps of their grids.
        weights: (m, n) of these columns in each sum.
        rest: (m,) for each sum, (column, weight) of the variables that stay fixed.
        bounds: (m,) values that the sums must have.
    """

    columns: tuple[int, ...]
    steps: tuple[Fraction, ...]
    weights: tuple[tuple[Fraction, ...], ...]
    rest: tuple[tuple[tuple[int, Fraction], ...], ...]
    bounds: tuple[Fraction, ...]


def moved(
    system: System, steps: Sequence[int], ends: Sequence[tuple[float, float]], values: Sequence[Fraction], cost: Sequence[float]
) -> list[int] | None:
    """Values, in steps, of the variables that may change that satisfy the equalities near the given ones; None: not found.

    Args:
        system: one equality, or `AT_ONCE`.
        steps: (n,) current value of each variable, in steps.
        ends: (n,) least and greatest value of each, in steps; infinite if there is none.
        values: of all columns of the design, for those that stay fixed.
        cost: (n,) of one step of each; the solution with the least cost is taken.
    """
    weights: list[list[int]] = []
    missing: list[int] = []
    for row, rest, bound in zip(system.weights, system.rest, system.bounds):
        left = bound - sum((weight * values[column] for column, weight in rest), Fraction(0))
        units = [weight * step for weight, step in zip(row, system.steps)]
        scale = math.lcm(left.denominator, *(unit.denominator for unit in units))
        whole = [int(unit * scale) for unit in units]
        weights.append(whole)
        missing.append(int(left * scale) - sum(w * n for w, n in zip(whole, steps)))
        if missing[-1] % math.gcd(*whole):
            return None
    count = len(weights)
    choices = [(_determinant(weights, at), at) for at in combinations(range(len(steps)), count)]
    choices = [(found, at) for found, at in choices if found]
    if not choices:
        return None
    determinant, pivots = min(choices, key=lambda choice: abs(choice[0]))
    # Variables with many values first: few values have few combinations.
    others = sorted((i for i in range(len(steps)) if i not in pivots), key=lambda i: ends[i][0] - ends[i][1])
    pairs = [*combinations(others, 2)][:PAIRS] or [(i,) for i in others] or [()]
    few = min(8 * abs(determinant) + 1000, MOST)  # about eight solutions are expected among so many
    for pair, total in [*((pair, few) for pair in pairs), (pairs[0], MOST)]:
        offsets = _offsets(pair, steps, ends, total)
        reach = [
            abs(m) + sum(abs(row[i]) * int(np.abs(o).max(initial=0)) for i, o in zip(pair, offsets))
            for m, row in zip(missing, weights)
        ]
        if max(reach) * (1 if count == 1 else 2 * max(abs(w) for row in weights for w in row)) >= _LARGEST:
            return None
        over = [m - sum((row[i] * o for i, o in zip(pair, offsets)), np.zeros(1, np.int64)) for m, row in zip(missing, weights)]
        turns = _cramer(weights, pivots, over)
        good = np.all([turn % determinant == 0 for turn in turns], 0)
        turns = [turn // determinant for turn in turns]
        for i, turn in zip(pivots, turns):
            good = good & (steps[i] + turn >= ends[i][0]) & (steps[i] + turn <= ends[i][1])
        changes = [*zip(pivots, turns), *zip(pair, offsets)]
        price = np.where(good, sum((np.abs(change) * cost[i] for i, change in changes), np.zeros(1)), math.inf)
        at = int(price.argmin())
        if math.isfinite(price[at]):
            found = list(steps)
            for i, change in changes:
                found[i] += int(change[at])
            return found
    return None


def _determinant(weights: list[list[int]], at: tuple[int, ...]) -> int:
    if len(at) == 1:
        return weights[0][at[0]]
    (a, b), (c, d) = ([row[i] for i in at] for row in weights)
    return a * d - b * c


def _cramer(weights: list[list[int]], at: tuple[int, ...], over: list[np.ndarray]) -> list[np.ndarray]:
    """Changes of the pivots that remove the residuals `over`, times the determinant (Cramer's rule)."""
    if len(at) == 1:
        return over
    (a, b), (c, d) = ([row[i] for i in at] for row in weights)
    return [d * over[0] - b * over[1], a * over[1] - c * over[0]]


def _offsets(
    pair: tuple[int, ...], steps: Sequence[int], ends: Sequence[tuple[float, float]], total: int
) -> list[np.ndarray]:  # fmt: skip
    """(k,) offsets of each variable: about `total` combinations within bounds. If one has few values, the others have more."""
    room = {i: (max(ends[i][0] - steps[i], -total), min(ends[i][1] - steps[i], total)) for i in pair}
    found: dict[int, np.ndarray] = {}
    for left, i in zip(range(len(pair), 0, -1), sorted(pair, key=lambda i: room[i][1] - room[i][0])):
        half = int(total ** (1 / left)) // 2 + 1
        low, high = max(room[i][0], -half), min(room[i][1], half)
        found[i] = np.arange(int(low), int(high) + 1, dtype=np.int64)
        total = max(total // max(len(found[i]), 1), 1)
    return [each.reshape(-1) for each in np.meshgrid(*(found[i] for i in pair), indexing="ij")]
