"""The grids of values on which variables in rules are proposed."""

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from deadreckon.mbo.constraints import Linear
from deadreckon.mbo.rules import Rules
from deadreckon.mbo.variables import Variable

FINE = 4  # decimal digits, below those of its range, to which a constrained variable is rounded, so that sums are exact
OF_LOGS = 2  # the same below those of the least value of a variable on a log scale, as its values may span decades
LEAST = 100  # least number of values that a shared grid has for each variable
COARSER = (0, 1, 2, 3, 4, -1, -2, -3)  # digits by which the alternative grids are coarser than the usual one


def grids(variables: Sequence[Variable], rules: Rules, decimals: Sequence[int], x: np.ndarray) -> list[list[Fraction | None]]:
    """Steps of each variable on several alternative grids, the usual ones first; None: any number, or a level.

    The variables of an equality share one grid, because a sum can only be satisfied by multiples of its coarsest step: the
    finest grid that any of them needs and that 32 bits represent for all, except for a variable that would have fewer than
    `LEAST` values. Coarser grids make programs easier; finer ones are needed for weights such as in 2 a + 4 b = 1.

    Args:
        variables: of the designs.
        rules: that proposals satisfy.
        decimals: `rules.decimals` of each variable.
        x: (rows, variables) designs of the data, for ranges where there are no bounds.
    """
    touched = rules.touched
    plain: list[Fraction | None] = [None] * len(variables)
    wanted: dict[int, int] = {}  # exponent of ten of the step, for variables without a given one
    held: dict[int, int] = {}  # the same for the finest step that 32 bits represent
    reach: dict[int, float] = {}
    for i, v in enumerate(variables):
        if v.step is not None:
            plain[i] = Fraction(str(v.step))
        elif v.kind == "integer" and i in touched:
            plain[i] = Fraction(1)
        elif v.kind == "continuous" and i in touched and v.low < v.high:
            seen = x[:, i]
            low, high = (b if math.isfinite(b) else float(s) for b, s in ((v.low, seen.min()), (v.high, seen.max())))
            largest = max(abs(low), abs(high), 1e-30)
            reach[i] = max(high - low, 1e-7 * largest)
            usual = math.floor(math.log10(reach[i])) - FINE
            fine = min(usual, math.floor(math.log10(low)) - OF_LOGS) if v.log else usual
            wanted[i] = min(fine, -decimals[i])
            # The distance between neighbouring 32-bit numbers is greatest at the largest value.
            held[i] = math.ceil(math.log10(np.spacing(np.nextafter(np.float32(largest), np.float32(0)))))
    shared = _shared(rules, set(wanted))
    out: list[list[Fraction | None]] = []
    for coarser in COARSER:
        digits = {i: max(count, held[i]) for i, count in wanted.items()}
        for group in shared:
            fewest = -max(decimals[i] for i in group)
            common = max(min(wanted[i] for i in group), *(held[i] for i in group))
            if coarser < 0:
                common = max(common + coarser, *(held[i] for i in group))
            else:
                common = max(common, min(common + coarser, fewest))
            for i in group:
                enough = reach[i] >= LEAST * 10.0**common
                digits[i] = max(common if enough else min(common, wanted[i]), held[i])
        steps = [Fraction(10) ** digits[i] if i in digits else step for i, step in enumerate(plain)]
        out += [] if steps in out else [steps]
    return out


def _shared(rules: Rules, columns: set[int]) -> list[list[int]]:
    """Groups of the given columns that equalities connect, directly or through other columns."""
    free = {c for each in rules.linear for c, _ in each.weights} - {column for column, _ in rules.fixed}
    groups = tied([each for each in rules.linear if each.equal], free)
    shared = [{c for each in group for c, _ in each.weights} & free & columns for group in groups]
    return [sorted(group) for group in shared if group]


def tied(equalities: Sequence[Linear], free: set[int]) -> list[list[Linear]]:
    """Groups of equalities that share `free` columns, directly or through other equalities."""
    groups: list[tuple[set[int], list[Linear]]] = []
    for each in equalities:
        columns = {column for column, _ in each.weights} & free
        near = [group for group in groups if group[0] & columns]
        groups = [group for group in groups if not group[0] & columns]
        groups.append((columns.union(*(c for c, _ in near)), [*(e for _, part in near for e in part), each]))
    return [part for _, part in groups]
