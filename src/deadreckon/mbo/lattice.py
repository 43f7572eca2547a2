"""Equalities met in whole numbers of grid steps, near to where they nearly hold.

With n_i the steps of a variable and W_i whole weights, W_1 n_1 + W_2 n_2 + ... = T has solutions near almost every point once
three variables may move: offsets of two of them within a window are tried, and what is left must divide by the weight of the
third, the pivot. Branch and bound takes minutes for weights such as molar masses, whose relaxations are nearly all feasible.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

import numpy as np

MOST = 1_500_000  # offsets of a pair that are tried at once
PAIRS = 4  # of variables that are tried, until one has a solution


@dataclass(frozen=True)
class Equality:
    """A weighted sum of numbers that must equal a bound.

    Attributes:
        columns: of the designs, those that may move.
        weights: of these.
        steps: of their grids.
        rest: (column, weight) of those that stay where they are.
        bound: of the sum.
    """

    columns: tuple[int, ...]
    weights: tuple[Fraction, ...]
    steps: tuple[Fraction, ...]
    rest: tuple[tuple[int, Fraction], ...]
    bound: Fraction


def moved(
    each: Equality, steps: Sequence[int], ends: Sequence[tuple[float, float]], rest: Sequence[Fraction], cost: Sequence[float]
) -> list[int] | None:
    """Steps of the variables that may move, near to the given ones, with which the equality holds; None: none was found.

    Args:
        each: the equality.
        steps: of each variable, where it is.
        ends: first and last step of each; infinite where there is none.
        rest: values of those that stay.
        cost: of a step of each.
    """
    left = each.bound - sum((weight * value for (_, weight), value in zip(each.rest, rest)), Fraction(0))
    units = [weight * step for weight, step in zip(each.weights, each.steps)]
    scale = math.lcm(left.denominator, *(unit.denominator for unit in units))
    whole = [int(unit * scale) for unit in units]
    missing = int(left * scale) - sum(w * n for w, n in zip(whole, steps))
    if missing % math.gcd(*whole) or max(map(abs, [missing, *whole])) >= 2**40:
        return None
    pivot = min(range(len(whole)), key=lambda i: abs(whole[i]))
    others = [i for i in range(len(whole)) if i != pivot]
    pairs = [*combinations(others, 2)][:PAIRS] or [(i,) for i in others] or [()]
    for pair in pairs:
        window = int(min(64 * abs(whole[pivot]) + 1000, MOST) ** (1 / max(len(pair), 1))) + 1
        offsets = np.meshgrid(*(_around(steps[i], window, ends[i]) for i in pair), indexing="ij")
        offsets = [offset.reshape(-1) for offset in offsets]
        over = missing - sum((whole[i] * offset for i, offset in zip(pair, offsets)), np.zeros(1, np.int64))
        turn = over // whole[pivot]
        there = steps[pivot] + turn
        good = (over % whole[pivot] == 0) & (there >= ends[pivot][0]) & (there <= ends[pivot][1])
        price = np.abs(turn) * cost[pivot] + sum((np.abs(o) * cost[i] for i, o in zip(pair, offsets)), np.zeros(1))
        price = np.where(good, price, math.inf)
        at = int(price.argmin())
        if math.isfinite(price[at]):
            found = list(steps)
            found[pivot] += int(turn[at])
            for i, offset in zip(pair, offsets):
                found[i] += int(offset[at])
            return found
    return None


def _around(here: int, window: int, ends: tuple[float, float]) -> np.ndarray:
    """Offsets of at most half a window that stay within bounds."""
    low, high = max(-(window // 2), ends[0] - here), min(window // 2, ends[1] - here)
    return np.arange(int(low), int(high) + 1, dtype=np.int64)
