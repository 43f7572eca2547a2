"""Proposals at the edge of what is allowed: at the ends of variables, at constraints and at forbidden combinations."""

import numpy as np

from deadreckon.mbo.constraints import Forbidden, Linear
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.program import ends_of
from deadreckon.mbo.variables import Variable

NEAR = 1e-3  # of the range of the data within which a proposal stands at the edge of a rule
SHOWN = 5  # ends and rules at most that are told of


def shown_value(value: object) -> str:
    """A value of a variable as it is set: with the seven digits that 32 bits hold, of which a score is shown with fewer."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    text = str(value) if isinstance(value, int) else f"{value:.7g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
    return text.replace("-", "\N{MINUS SIGN}")


def placed(v: Variable, values: np.ndarray | float) -> np.ndarray:
    """Numbers of a variable as they are compared: logarithms of one that is seen so, in each of whose decades a step counts."""
    found = np.asarray(values, np.float64)
    return np.log(np.maximum(found, np.finfo(np.float32).tiny)) if v.log else found


def data_value(v: Variable, value: float) -> object:
    """A value that a design holds as tables have it: of a variable with levels its level."""
    return v.levels[int(value)] if v.levels else int(value) if v.kind == "integer" else float(value)


def at_ends(data: Designs, x: np.ndarray, idle: set[int]) -> list[str]:
    """Variables that stand at an end of what is allowed in half or more of (n, variables) designs; `idle` do not count."""
    found = []
    for i, v in enumerate(data.variables):
        if i in idle or v.low == v.high or v.kind == "categorical":
            continue
        slack, at = 1e-5 * max(float(np.ptp(placed(v, data.x[:, i]))), 1e-30), placed(v, x[:, i])
        for end, name in zip(ends_of(v), ("lower", "upper")):
            count = int((np.abs(at - placed(v, float(np.float32(end)))) <= slack).sum()) if np.isfinite(end) else 0
            if 2 * count >= len(x):
                found.append((count, f"in {count:,} {v.name} is at its {name} end ({shown_value(data_value(v, end))})"))
    return [text for _, text in sorted(found, key=lambda each: -each[0])[:SHOWN]]


def at_rules(data: Designs, x: np.ndarray) -> list[str]:
    """Inequalities and forbidden combinations at whose edge half or more of (n, variables) designs stand."""
    fixed = {column for column, _ in data.rules.fixed}
    found = []
    for each in data.rules.linear:
        if not each.equal and not {column for column, _ in each.weights} <= fixed:
            found.append((int(_at_linear(data, each, x, fixed).sum()), f"always {each.text}"))
    for each in data.rules.forbidden:
        found.append((int(_at_forbidden(data, each, x, fixed).sum()), f"never {each.text}"))
    found = sorted((each for each in found if 2 * each[0] >= len(x)), key=lambda each: -each[0])
    return [f'{count:,} stand at the edge of the rule "{text}"' for count, text in found[:SHOWN]]


def _at_linear(data: Designs, rule: Linear, x: np.ndarray, fixed: set[int]) -> np.ndarray:
    """(n,) which designs cannot come nearer to the bound of an inequality, but for `NEAR` of its range or a step."""
    seen, sums = (sum(float(w) * data.repair.measured(of)[:, c] for c, w in rule.weights) for of in (data.x, x))
    free = [(data.variables[c], x[:, c], float(w)) for c, w in rule.weights if c not in fixed]
    step = np.min([abs(w) * _next(v, values, up=w > 0) for v, values, w in free], axis=0)
    step = np.where(np.isfinite(step), step, 0.0)  # what stands at the ends of its levels is held by these
    return np.asarray(float(rule.bound) - sums) < np.maximum(NEAR * float(np.ptp(seen)), (1 - NEAR) * step)


def _next(v: Variable, values: np.ndarray, *, up: bool) -> np.ndarray:
    """(n,) distances of values to the next one that may be proposed; of levels that are numbers to the next level above or
    below, infinite where there is none."""
    if not v.leveled:
        return np.full(len(values), _step(v))
    levels = np.sort(np.array(v.levels, np.float64))
    here = np.searchsorted(levels, np.array(v.levels, np.float64)[values.astype(int)])
    there = here + (1 if up else -1)
    inside = (there >= 0) & (there < len(levels))
    return np.where(inside, np.abs(levels[there.clip(0, len(levels) - 1)] - levels[here]), np.inf)


def _at_forbidden(data: Designs, rule: Forbidden, x: np.ndarray, fixed: set[int]) -> np.ndarray:
    """(n,) which designs are kept out of a forbidden combination by one number alone that stands at its threshold."""
    met = np.stack([each.met(x[:, each.column]) for each in rule.clauses])
    at = np.zeros(len(x), bool)
    for k, each in enumerate(rule.clauses):
        if each.levels is not None or each.column in fixed:
            continue
        v, values, threshold = data.variables[each.column], x[:, each.column], float(each.value)
        # The nearest value that is allowed is the threshold itself, or a step beside it where that is forbidden.
        near = np.abs(values - threshold) < _step(v) * (1 + NEAR if "=" in each.relation else 1 - NEAR)
        near |= np.abs(placed(v, values) - placed(v, threshold)) < NEAR * np.ptp(placed(v, data.x[:, each.column]))
        at |= np.delete(met, k, 0).all(0) & ~met[k] & near
    return at


def _step(v: Variable) -> float:
    """Between values that may be proposed; 0 where all may."""
    return 0.0 if v.leveled else float(v.step or v.kind == "integer")
