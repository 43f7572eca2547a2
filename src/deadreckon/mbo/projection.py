"""Many candidates at once on linear constraints, in floating point: projections, and steps where numbers have these."""

from typing import TYPE_CHECKING

import numpy as np

from deadreckon.mbo.variables import Variable

if TYPE_CHECKING:
    from deadreckon.mbo.repair import Repair

SWEEPS = 60  # of Dykstra's algorithm
MOVES = 40  # whole steps by which a design is moved at most
CLOSE = 1e-6  # share of a constraint's terms by which it may be missed: rounding errors


def in_steps(variable: Variable) -> bool:
    """Whether values lie apart: whole numbers, levels and steps."""
    return variable.kind != "continuous" or variable.step is not None


def projected(repair: "Repair", x: np.ndarray, moved: list[int]) -> np.ndarray:
    """(rows, variables) designs projected on bounds and linear constraints by moving some of the variables (Dykstra)."""
    low, high = (np.array([getattr(repair.variables[i], end) for i in moved]) for end in ("low", "high"))
    scale, measured = repair.scale[moved], repair.measured(x)
    rest = [i for i in range(x.shape[1]) if i not in moved]
    planes = []
    for each in repair.rules.linear:
        weights = _weights(each, x.shape[1])
        normal = weights[moved] * scale
        if normal.any():
            planes.append((normal, float(each.bound) - measured[:, rest] @ weights[rest], each.equal))
    if not planes:
        return x
    z = x[:, moved] / scale
    errors = [np.zeros_like(z) for _ in range(len(planes) + 1)]
    for _ in range(SWEEPS):
        before = z
        for k, (normal, bound, equal) in enumerate(planes):
            y = z + errors[k]
            over = (y @ normal - bound) / (normal @ normal)
            z = y - (over if equal else np.maximum(over, 0.0))[:, None] * normal
            errors[k] = y - z
        y = z + errors[-1]
        z = y.clip(low / scale, high / scale)
        errors[-1] = y - z
        if np.abs(z - before).max(initial=0.0) < 1e-7:
            break
    x[:, moved] = z * scale
    return x


def stepwise(repair: "Repair", x: np.ndarray, stepped: list[int]) -> np.ndarray:
    """Designs moved by whole steps until linear constraints hold: always by the one that leaves the least of what is missed."""
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
    """(rows,) which designs satisfy all linear constraints to rounding errors."""
    weights, bound, equal, scale = _rules(repair, x)
    return np.all(_missed(repair.measured(x) @ weights.T - bound, equal) <= CLOSE * scale, 1)


def _weights(rule, count: int) -> np.ndarray:
    weights = np.zeros(count)
    weights[[c for c, _ in rule.weights]] = [float(w) for _, w in rule.weights]
    return weights


def _rules(repair: "Repair", x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(rules, variables) weights, (rules,) bounds, which are equalities, and the size of their terms."""
    rules = repair.rules.linear
    weights = np.array([_weights(each, x.shape[1]) for each in rules])
    bound = np.array([float(each.bound) for each in rules])
    return weights, bound, np.array([each.equal for each in rules]), np.abs(weights) @ repair.scale + np.abs(bound)


def _missed(over: np.ndarray, equal: np.ndarray) -> np.ndarray:
    return np.where(equal, np.abs(over), np.maximum(over, 0.0))
