"""Many designs at once moved onto linear constraints, in floating point: by projections, and by steps of numbers in steps."""

from typing import TYPE_CHECKING

import numpy as np

from deadreckon.mbo.variables import Variable

if TYPE_CHECKING:
    from deadreckon.mbo.repair import Repair

SWEEPS = 60  # largest number of iterations of Dykstra's algorithm
PASSES = 64  # largest number of its runs, each of which at most halves or doubles a variable on a log scale
MOVES = 40  # largest number of steps by which a design is moved
CLOSE = 1e-6  # tolerance of a constraint for rounding errors, relative to its terms


def in_steps(variable: Variable) -> bool:
    """Whether a variable is discrete: whole numbers, levels, or numbers in steps."""
    return variable.kind != "continuous" or variable.step is not None


def projected(repair: "Repair", x: np.ndarray, moved: list[int]) -> np.ndarray:
    """(rows, variables) designs projected, in place, onto bounds and linear constraints by changes of the variables `moved`
    (Dykstra's algorithm).

    Distances have the units of `Repair.scales`, which are valid near a design only: if a variable on a log scale would change
    by more than a factor of two, the design is moved part of the way and projected again from there.
    """
    measured = repair.measured(x)
    rest = [i for i in range(x.shape[1]) if i not in moved]
    planes = []
    for each in repair.rules.linear:
        weights = _weights(each, x.shape[1])
        if weights[moved].any():
            planes.append((weights[moved], float(each.bound) - measured[:, rest] @ weights[rest], each.equal))
    if not planes:
        return x
    logs = [k for k, i in enumerate(moved) if repair.variables[i].log]
    for i in range(PASSES):
        here = x[:, moved]
        change = _dykstra(repair, here, planes, moved, repair.scales(x)[:, moved]) - here
        far = np.maximum(change[:, logs] / here[:, logs], -2 * change[:, logs] / here[:, logs]).max(1, initial=1.0)
        share = 1.0 / far[:, None] if i < PASSES - 1 else 1.0
        x[:, moved] = here + share * change
        if (far <= 1.0).all():
            break
    return x


def _dykstra(repair: "Repair", x: np.ndarray, planes: list, moved: list[int], scale: np.ndarray) -> np.ndarray:
    """Numbers (rows, moved) projected onto bounds and `planes`: of each the weights (moved,), the bound and whether it is an
    equality. `scale` (rows, moved) has the units of distances."""
    low, high = (np.array([getattr(repair.variables[i], end) for i in moved]) / scale for end in ("low", "high"))
    planes = [(weights * scale, bound, equal) for weights, bound, equal in planes]
    z = x / scale
    errors = [np.zeros_like(z) for _ in range(len(planes) + 1)]
    for _ in range(SWEEPS):
        before = z
        for k, (normal, bound, equal) in enumerate(planes):
            y = z + errors[k]
            over = ((y * normal).sum(1) - bound) / np.square(normal).sum(1)
            z = y - (over if equal else np.maximum(over, 0.0))[:, None] * normal
            errors[k] = y - z
        y = z + errors[-1]
        z = y.clip(low, high)
        errors[-1] = y - z
        if np.abs(z - before).max(initial=0.0) < 1e-7:
            break
    return z * scale


def stepwise(repair: "Repair", x: np.ndarray, stepped: list[int]) -> np.ndarray:
    """(rows, variables) designs moved by steps of the variables `stepped` until linear constraints hold: always by the step
    that leaves the least violation."""
    x = x.copy()
    size = np.array([float(repair.variables[c].step or 1) for c in stepped])
    low, high = (np.array([float(getattr(repair.variables[c], end)) for c in stepped]) for end in ("low", "high"))
    moves = np.concatenate([np.diag(size), -np.diag(size)])  # (moves, stepped)
    weights, bound, equal, scale = _rules(repair, x)
    for _ in range(MOVES):
        missed = _missed(repair.measured(x) @ weights.T - bound, equal) / scale  # (rows, rules)
        open_ = np.flatnonzero(missed.max(1) > CLOSE)
        if not len(open_):
            break
        now = x[open_][:, stepped]
        new = now[:, None] + moves  # (open, moves, stepped)
        possible = ((new >= low - 1e-9) & (new <= high + 1e-9)).all(2)
        sums = (repair.measured(x[open_]) @ weights.T)[:, None] + moves @ weights[:, stepped].T
        left = np.where(possible, (_missed(sums - bound, equal) / scale).sum(2), np.inf)
        best = left.argmin(1)
        better = left[np.arange(len(open_)), best] < missed[open_].sum(1) - 1e-12
        if not better.any():
            break
        rows = open_[better]
        x[rows[:, None], stepped] = new[better, best[better]]
    return x


def satisfied(repair: "Repair", x: np.ndarray) -> np.ndarray:
    """(rows,) bool: which designs satisfy all linear constraints, up to rounding errors."""
    weights, bound, equal, scale = _rules(repair, x)
    return np.all(_missed(repair.measured(x) @ weights.T - bound, equal) <= CLOSE * scale, 1)


def _weights(rule, count: int) -> np.ndarray:
    weights = np.zeros(count)
    weights[[c for c, _ in rule.weights]] = [float(w) for _, w in rule.weights]
    return weights


def _rules(repair: "Repair", x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(rules, variables) weights, and (rules,) bounds, whether it is an equality, and the size of the terms."""
    rules = repair.rules.linear
    weights = np.array([_weights(each, x.shape[1]) for each in rules])
    bound = np.array([float(each.bound) for each in rules])
    return weights, bound, np.array([each.equal for each in rules]), np.abs(weights) @ repair.scale + np.abs(bound)


def _missed(over: np.ndarray, equal: np.ndarray) -> np.ndarray:
    return np.where(equal, np.abs(over), np.maximum(over, 0.0))
