"""Designs moved to the nearest ones that satisfy all rules, or refused where none does.

Two means: in floating point, projections on one constraint after the other (Dykstra's algorithm), for many candidates at once;
and for what is proposed a mixed-integer linear program on the grid of each variable (HiGHS), whose solution is checked exactly.
"""

import math
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.constraints import Forbidden, Linear, places
from deadreckon.mbo.program import Program, ends
from deadreckon.mbo.rules import Rules, written

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

FINE = 4  # digits below the range of a constrained variable to which proposals are rounded, so that sums are exact
SWEEPS = 60  # of Dykstra's algorithm


class Repair:
    """Moves designs of some data to where all rules hold.

    Args:
        data: with variables and rules.
    """

    def __init__(self, data: "Designs"):
        self.data, self.rules, self.variables = data, data.rules, data.variables
        touched, self.decimals = self.rules.touched, self.rules.decimals(data.variables)
        self.steps = [self._step(i) if v.step or i in touched else None for i, v in enumerate(self.variables)]
        spread = data.x.astype(np.float64).std(0)
        self.scale = np.where(spread > 0, spread, np.maximum(1e-3 * np.abs(data.x).max(0), 1e-3))
        self.free = not (touched or self.rules.fixed or any(self.steps))

    def _step(self, i: int) -> Fraction | None:
        """Of the grid on which a variable is proposed."""
        v, seen = self.variables[i], self.data.x[:, i]
        if v.step is not None:
            return Fraction(str(v.step))
        if v.kind != "continuous":
            return Fraction(1) if v.kind == "integer" else None
        low, high = (b if math.isfinite(b) else float(s) for b, s in ((v.low, seen.min()), (v.high, seen.max())))
        largest = max(abs(low), abs(high), 1e-30)
        digits = min(math.floor(math.log10(max(high - low, 1e-7 * largest))) - FINE, -self.decimals[i])
        apart = np.spacing(np.nextafter(np.float32(largest), np.float32(0)))  # of the largest numbers of 32 bits
        return Fraction(10) ** max(digits, math.ceil(math.log10(apart)))

    def good(self, x: np.ndarray) -> np.ndarray:
        """(rows,) which designs satisfy all rules exactly as they are written."""
        return np.array([self.rules.broken(self.variables, row) is None for row in written(self.variables, x)], bool)

    def relaxed(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) designs projected on bounds, fixed values and linear constraints, to rounding errors.

        Whole numbers, levels and steps are rounded first and kept; forbidden combinations are not looked at.
        """
        x = self._snapped(np.array(x, np.float64))
        if not self.rules.linear:
            return x
        fixed = {column for column, _ in self.rules.fixed}
        moved = [i for i, v in enumerate(self.variables) if v.kind == "continuous" and v.step is None and i not in fixed]
        low, high = (np.array([getattr(self.variables[i], end) for i in moved]) for end in ("low", "high"))
        scale = self.scale[moved]
        measured = self._measured(x)
        rest = [i for i in range(x.shape[1]) if i not in moved]
        planes = []
        for each in self.rules.linear:
            weights = np.zeros(x.shape[1])
            weights[[c for c, _ in each.weights]] = [float(w) for _, w in each.weights]
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

    def allowed(self, x: np.ndarray) -> np.ndarray:
        """(rows,) which designs are no forbidden combination, in floating point."""
        out = np.ones(len(x), bool)
        for each in self.rules.forbidden:
            out &= ~np.all([clause.met(x[:, clause.column]) for clause in each.clauses], 0)
        return out

    def exact(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Designs near to these that satisfy all rules exactly.

        Returns:
            (rows, variables) float32 designs, and (rows,) which of them satisfy the rules: all, but where a program ran out of
            time.
        """
        x = np.asarray(x, np.float32)
        if self.free:
            return x, np.ones(len(x), bool)
        x = self._snapped(self.relaxed(x)).astype(np.float32)
        good = self.good(x)
        for i in np.flatnonzero(~good):
            found = self._program.nearest(x[i])
            if found is not None:
                x[i] = found
        return x, self.good(x)

    def _snapped(self, x: np.ndarray) -> np.ndarray:
        """Within bounds, on grids, with fixed values."""
        x = np.array(x, np.float64)
        for i, (v, step) in enumerate(zip(self.variables, self.steps)):
            if step is not None:
                first, last = ends(v.low, v.high, step)
                each = np.round(x[:, i] / float(step)).clip(first, last)
                x[:, i] = each * step.numerator / step.denominator
            elif v.kind == "continuous":
                x[:, i] = x[:, i].clip(v.low, v.high)
            else:
                x[:, i] = np.round(x[:, i]).clip(0 if v.leveled else v.low, len(v.levels) - 1 if v.leveled else v.high)
        for column, value in self.rules.fixed:
            x[:, column] = value
        return x

    def _measured(self, x: np.ndarray) -> np.ndarray:
        """Designs with the numbers that indices of ordinal levels stand for."""
        x = np.array(x, np.float64)
        for i, v in enumerate(self.variables):
            if v.numeric_levels:
                x[:, i] = np.array(v.levels, np.float64)[x[:, i].astype(int)]
        return x

    @cached_property
    def _program(self) -> Program:
        return Program(self.variables, self.rules, self.steps, self.scale, self.data.name)

    def _too_fine(self, each: Linear) -> bool:
        """Whether an equality needs more decimals than the grids of its variables have, or weights on top of theirs."""
        steps = [(self.decimals[c], step) for c, _ in each.weights if (step := self.steps[c]) is not None]
        fine = any(Fraction(1, 10**count) < step for count, step in steps)
        return fine or any(places(weight) >= FINE for _, weight in each.weights)

    def check_possible(self) -> None:
        """Refuses rules that no design satisfies.

        Raises:
            UserError: one line, which names a rule without which there would be one, if there is a single such rule.
        """
        name = self.data.name
        for v, step in zip(self.variables, self.steps):
            if step is not None and np.greater(*ends(v.low, v.high, step)):
                raise UserError(f"{name}: {v.name} has no multiple of {float(step):g} in [{v.low:g}, {v.high:g}]")
        for column, value in self.rules.fixed:
            v = self.variables[column]
            if v.step is not None and Fraction(str(np.float32(value))) % Fraction(str(v.step)):
                raise UserError(f"{name}: {v.name} is fixed at {value:g}, which is no multiple of its step {v.step:g}")
        if self.free or self._program.possible():
            return
        def without(rules: Rules) -> bool:
            return Program(self.variables, rules, self.steps, self.scale, name).possible()

        rules, blamed = self.rules, []
        for kind in ("linear", "forbidden"):
            for each in getattr(rules, kind):
                if without(replace(rules, **{kind: tuple(e for e in getattr(rules, kind) if e is not each)})):
                    blamed.append(each)
        names = [f"forbidding {each.text}" if isinstance(each, Forbidden) else each.text for each in blamed]
        told = f"; without {' or without '.join(map(repr, names))} there would be some" if blamed else ""
        if any(isinstance(each, Linear) and each.equal and self._too_fine(each) for each in blamed or rules.linear):
            told += "; numbers have seven digits (32 bits): round them, and write ratios in whole numbers, such as 3 a - b = 0"
        raise UserError(f"{name}: no design within the bounds satisfies all constraints{told}")
