"""Moves designs to the nearest ones that satisfy all rules, and refuses rules that no design satisfies.

There are three means. Many candidates at once are projected onto one constraint after the other in floating point (Dykstra's
algorithm). Proposals are moved by whole steps on the grid of each variable (`mbo.lattice`), and if this violates other rules by
a mixed-integer linear program on the same grids (HiGHS). The results are checked exactly.
"""

import math
import shlex
import time
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo import variables
from deadreckon.mbo.constraints import Forbidden, Linear, places
from deadreckon.mbo.doubts import sum_of
from deadreckon.mbo.grids import FINE, grids, tied
from deadreckon.mbo.lattice import AT_ONCE, System, moved
from deadreckon.mbo.program import SECONDS, Program, ends, possible
from deadreckon.mbo.projection import in_steps, projected, satisfied, stepwise
from deadreckon.mbo.rules import Rules, written
from deadreckon.mbo.variables import Variable

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

TOGETHER = 60.0  # time limit, in seconds, of the programs for all designs of a call
NEAR = 0.05  # change of a variable, in standard deviations, below which two designs are near each other
SOME = 20  # rows of the data near which designs are searched before programs are solved


class Repair:
    """Moves designs to the nearest ones that satisfy all rules.

    Args:
        data: scored designs, with variables and rules.
    """

    def __init__(self, data: "Designs"):
        self.data, self.rules, self.variables = data, data.rules, data.variables
        self.fixed = {column for column, _ in data.rules.fixed}
        self.open = [i for i, v in enumerate(data.variables) if i not in self.fixed and not v.leveled]
        self.stepped = [i for i in self.open if in_steps(data.variables[i])]
        self.tied_steps = any(c in self.stepped for each in data.rules.linear for c, _ in each.weights)
        self.decimals = self.rules.decimals(data.variables)
        self.grids = grids(self.variables, self.rules, self.decimals, data.x)
        self.steps = self.grids[0]
        # No step is small in all decades of a log scale: such a variable is rounded only for an exact sum, or by a program.
        summed = {c for each in self.rules.linear if each.equal for c, _ in each.weights}
        self.loose = {i for i in self.open if data.variables[i].log and i not in {*self.stepped, *summed}}
        x = data.x.astype(np.float64)
        spread = np.where(np.ptp(x, axis=0) > 0, x.std(0), 0.0)  # the std of a constant may be a rounding error
        self.scale = np.where(spread > 0, spread, np.maximum(1e-3 * np.abs(data.x).max(0), 1e-3))
        self.logs = np.array([v.log for v in self.variables], bool)
        ratio = np.log(np.where(self.logs, x, 1.0))
        self.ratio = np.where(np.ptp(ratio, axis=0) > 0, ratio.std(0), 1e-3)  # standard deviation of logarithms
        self.free = not (self.rules.touched or self.rules.fixed or any(self.steps))

    def scales(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) units of distances from these designs: standard deviations of the data.

        On a log scale it is the standard deviation of the logarithm times the value; with that of the values themselves, small
        values would be moved by decades.
        """
        return np.where(self.logs, np.abs(x) * self.ratio, self.scale)

    def good(self, x: np.ndarray) -> np.ndarray:
        """(rows,) bool: which designs satisfy all rules exactly, as they are written."""
        return np.array([self.rules.broken(self.variables, row) is None for row in written(self.variables, x)], bool)

    def relaxed(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) designs projected onto bounds, fixed values and linear constraints, up to rounding errors.

        Whole numbers, levels and numbers in steps are rounded first and then kept; forbidden combinations are ignored.
        """
        x = self._snapped(np.array(x, np.float64))
        if not self.rules.linear:
            return x
        return projected(self, x, [i for i, v in enumerate(self.variables) if i not in self.fixed and not in_steps(v)])

    def nearly(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) designs that satisfy bounds and linear constraints up to rounding errors, also on numbers in steps.

        Whole numbers and numbers in steps are moved, too. Designs for which no solution is found are left out, unless there are
        no others.
        """
        if not self.tied_steps:
            return self.relaxed(x)
        x = np.array(x, np.float64)
        for column, value in self.rules.fixed:
            x[:, column] = value
        x = stepwise(self, self.relaxed(projected(self, x, self.open)), self.stepped)
        good = satisfied(self, x)
        return x[good] if good.any() else x

    def allowed(self, x: np.ndarray) -> np.ndarray:
        """(rows,) bool: which designs have no forbidden combination, in floating point."""
        out = np.ones(len(x), bool)
        for each in self.rules.forbidden:
            out &= ~np.all([clause.met(x[:, clause.column]) for clause in each.clauses], 0)
        return out

    def exact(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Designs near these that satisfy all rules exactly.

        Returns:
            (rows, variables) float32 designs, and (rows,) bool: which of them satisfy the rules; for others time ran out.
        """
        x = np.asarray(x, np.float32)
        if self.free:
            return x, np.ones(len(x), bool)
        x = self._snapped(self.relaxed(x)).astype(np.float32)
        good, spent = self.good(x), 0.0
        for i in np.flatnonzero(~good):
            found = self._by_steps(x[i])
            if found is None and spent < TOGETHER:
                begun = time.monotonic()
                found = self._by_programs(x[i])
                spent += time.monotonic() - begun
            if found is not None:
                x[i] = found
        return x, self.good(x)

    def _by_programs(self, x: np.ndarray) -> np.ndarray | None:
        """The nearest design on the first grid on which one is found, within about `SECONDS`."""
        begun = time.monotonic()
        for program in self._programs:
            found = program.nearest(x, self.scales(x))
            if found is not None and self.good(found[None])[0]:
                return found
            if time.monotonic() - begun > SECONDS:
                break
        return None

    def _by_steps(self, x: np.ndarray) -> np.ndarray | None:
        """A design near this one, moved by steps of the grids so that each equality holds; None: none satisfies all rules."""
        x = np.array(x, np.float64)
        measured = [Fraction(str(np.float32(value))) for value in self.measured(x[None])[0]]
        for systems in self._systems:
            found = self._met(systems, x.copy(), list(measured))
            if found is not None and self.good(found[None])[0]:
                return found
        return None

    def _met(self, systems: list[System], x: np.ndarray, measured: list[Fraction]) -> np.ndarray | None:
        """The design, moved by steps of the grids so that these equalities hold; None: no solution is nearby."""
        for each in systems:
            here = [round(float(x[c]) / float(step)) for c, step in zip(each.columns, each.steps)]
            limits = [ends(self.variables[c].low, self.variables[c].high, step) for c, step in zip(each.columns, each.steps)]
            scale = self.scales(x)
            cost = [float(step) / scale[c] for c, step in zip(each.columns, each.steps)]
            found = moved(each, here, limits, measured, cost)
            if found is None:
                return None
            x[list(each.columns)] = [n * step.numerator / step.denominator for n, step in zip(found, each.steps)]
            for c in each.columns:
                measured[c] = Fraction(str(np.float32(x[c])))
        return x

    @cached_property
    def _systems(self) -> list[list[System]]:
        """The equalities on each grid: those that share variables in one system, or one after the other if too many."""
        out: list[list[System]] = []
        for grid in self.grids:
            free = {c for c, step in enumerate(grid) if step is not None} - self.fixed
            found: list[System] = []
            for group in tied([each for each in self.rules.linear if each.equal], free):
                parts = [group] if len(group) <= AT_ONCE else [[each] for each in group]
                taken: set[int] = set()
                for part in parts:
                    columns = sorted({c for each in part for c, _ in each.weights} & free - taken)
                    if columns:
                        found.append(_system(part, columns, grid))
                        taken |= set(columns)
            out += [found] if found else []
        return out

    def _snapped(self, x: np.ndarray) -> np.ndarray:
        """Designs clipped to bounds and rounded to grids, with fixed values."""
        x = np.array(x, np.float64)
        for i, (v, step) in enumerate(zip(self.variables, self.steps)):
            if step is not None and i not in self.loose:
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

    def measured(self, x: np.ndarray) -> np.ndarray:
        """See `variables.measured`."""
        return variables.measured(self.variables, x)

    @cached_property
    def _programs(self) -> list[Program]:
        return [self._program(steps) for steps in self.grids]

    def _program(self, steps: list[Fraction | None], rules: Rules | None = None) -> Program:
        return Program(self.variables, rules or self.rules, steps, self.scale)

    def _near(self) -> bool:
        """Whether most designs that satisfy the rules up to rounding errors are near one that satisfies them exactly."""
        some = self._snapped(self.relaxed(self.data.x[:SOME]))
        moved, good = self.exact(some)
        away = np.abs(moved - some) / self.scale
        return bool(np.median(np.where(good, away.max(1), math.inf)) <= NEAR)

    def _possible(self) -> bool | None:
        """Whether any design satisfies all rules; None: none was found in time."""
        some = self._snapped(self.relaxed(self.data.x[:SOME])).astype(np.float32)
        if self.good(some).any() or any(self._by_steps(x) is not None for x in some):
            return True
        return possible(self._programs)

    def _too_fine(self, each: Linear) -> bool:
        """Whether an equality needs more decimals than the grids of its variables have, or has weights with many decimals."""
        steps = [(self.decimals[c], step) for c, _ in each.weights if (step := self.steps[c]) is not None]
        fine = any(Fraction(1, 10**count) < step for count, step in steps)
        return fine or _of_fine_weights(each)

    def _hundred(self, rule: Linear | Forbidden) -> str:
        """A hint to require a sum of 100, if the rule requires 1 and the median in the data is 100; else an empty text."""
        if isinstance(rule, Forbidden) or not rule.equal or rule.bound != 1 or {weight for _, weight in rule.weights} != {1}:
            return ""
        total = float(np.median(self.measured(self.data.x)[:, [column for column, _ in rule.weights]].sum(1)))
        if abs(total - 100) > 1:
            return ""
        percent = sum_of([self.variables[column].name for column, _ in rule.weights], 100)
        return f"; in the data they sum to 100, so say --constraints {shlex.quote(percent)} instead"

    def check_possible(self) -> None:
        """Refuses rules that no design satisfies.

        Raises:
            UserError: one line, which names each rule without which, alone, there would be such a design.
        """
        name = self.data.name
        for v, step in zip(self.variables, self.steps):
            if step is not None and np.greater(*ends(v.low, v.high, step)):
                raise UserError(f"{name}: {v.name} has no multiple of {float(step):g} in [{v.low:g}, {v.high:g}]")
        for v, step in zip(self.variables, self.steps):
            if v.step is not None and step is not None and not _held(v, step):
                text = f"most multiples of the step {v.step} of {v.name} have more than the seven digits of 32 bits"
                raise UserError(f"{name}: {text}; round the step, or make the variable ordinal and list its levels")
        for column, value in self.rules.fixed:
            v = self.variables[column]
            if v.step is not None and Fraction(str(np.float32(value))) % Fraction(str(v.step)):
                raise UserError(f"{name}: {v.name} is fixed at {value:g}, which is no multiple of its step {v.step:g}")
        there = True if self.free else self._possible()
        digits = "numbers have seven digits (32 bits): round them, and write ratios in whole numbers, such as 3 a - b = 0"
        if there:
            fine = [each.text for each in self.rules.linear if each.equal and _of_fine_weights(each)]
            if fine and not self._near():
                raise UserError(f"{name}: few designs within the bounds satisfy {fine[0]!r}; {digits}")
            return
        rules, blamed = self.rules, []
        for kind in ("linear", "forbidden"):
            for each in getattr(rules, kind):
                others: dict[str, Any] = {kind: tuple(e for e in getattr(rules, kind) if e is not each)}
                fewer = replace(rules, **others)
                if possible([self._program(steps, fewer) for steps in self.grids]):
                    blamed.append(each)
        names = [f"forbidding {each.text}" if isinstance(each, Forbidden) else each.text for each in blamed]
        told = "".join(map(self._hundred, blamed))
        told += f"; without {' or without '.join(map(repr, names))} there would be some" if blamed else ""
        if any(isinstance(each, Linear) and each.equal and self._too_fine(each) for each in blamed or rules.linear):
            told += f"; {digits}"
        late = f" was found in {SECONDS:g} s that" if there is None else ""
        raise UserError(f"{name}: no design within the bounds{late} satisfies all constraints{told}")


def _of_fine_weights(each: Linear) -> bool:
    """Whether an equality has weights of so many decimals that few of the seven digits of 32-bit numbers are left."""
    return any(places(weight) >= FINE for _, weight in each.weights)


def _system(part: list[Linear], columns: list[int], grid: list[Fraction | None]) -> System:
    """The system of some equalities, in which these columns may change."""
    weights = [dict(each.weights) for each in part]
    rest = tuple(tuple((c, w) for c, w in of.items() if c not in columns) for of in weights)
    rows = tuple(tuple(of.get(c, Fraction(0)) for c in columns) for of in weights)
    return System(tuple(columns), tuple(grid[c] or Fraction(1) for c in columns), rows, rest, tuple(e.bound for e in part))


def _held(v: Variable, step: Fraction) -> bool:
    """Whether 32-bit numbers, as they are written, equal most of the first multiples of a step within the bounds."""
    first, last = ends(v.low, v.high, step)
    begin = 0 if math.isinf(first) else int(first)
    some = range(begin, int(min(begin + 20, last)) + 1)
    held = [not Fraction(str(np.float32(float(n * step)))) % step for n in some if n]
    return not held or 2 * sum(held) >= len(held)
