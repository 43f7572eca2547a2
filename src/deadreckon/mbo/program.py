"""The nearest design that satisfies all rules, as a mixed-integer linear program."""

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from deadreckon.mbo.constraints import Clause
from deadreckon.mbo.rules import Rules
from deadreckon.mbo.variables import Variable

SECONDS = 5.0  # time limit of one program
LATE = 2  # number of programs that reach the time limit after which the others are not tried
_TIME = 1  # status of SciPy's `milp`: a limit of time or iterations was reached
FURTHEST = 1e6  # bound, in scales of the variable, that a condition assumes if the variable has none


def ends(low: float, high: float, step: Fraction) -> tuple[float, float]:
    """The least and the greatest multiple of a step within bounds, in steps; infinite if there is none."""
    first = math.ceil(Fraction(str(float(low))) / step) if math.isfinite(low) else -math.inf
    last = math.floor(Fraction(str(float(high))) / step) if math.isfinite(high) else math.inf
    return first, last


def ends_of(v: Variable) -> tuple[float, float]:
    """The least and the greatest value of a variable of numbers that may be proposed: multiples of its step, if it has one."""
    if v.step is None:
        return v.low, v.high
    step = Fraction(str(v.step))
    first, last = ends(v.low, v.high, step)
    return float(first * step), float(last * step)


class Program:
    """Rows and columns of the program that finds the nearest design; its objective is the sum of scaled distances.

    Its unknowns are the value of each number, in steps of its grid if it has one, and its distance from the given design; and
    a binary number for each level and for each condition of a forbidden combination.

    Args:
        variables: of the designs.
        rules: that they must satisfy.
        steps: of the grids of the variables; None: there is none.
        scale: (variables,) of the data, in which bounds of variables without any are assumed (`FURTHEST`).
    """

    def __init__(self, variables: Sequence[Variable], rules: Rules, steps: Sequence[Fraction | None], scale: np.ndarray):
        self.variables, self.steps, self.scale = variables, steps, scale
        self.fixed = fixed = dict(rules.fixed)
        self.at: list[int] = []  # first column of each variable
        self.lows: list[float] = []
        self.highs: list[float] = []
        self.whole: list[int] = []
        self.rows: list[tuple[dict[int, float], float, float]] = []
        self.apart: dict[int, int] = {}  # variable -> column of its distance
        for i, v in enumerate(variables):
            self.at.append(len(self.lows))
            if v.leveled:
                for level in range(len(v.levels)):
                    self._column(*((float(fixed[i] == level),) * 2 if i in fixed else (0.0, 1.0)), whole=True)
                self.rows.append(({self.at[i] + level: 1.0 for level in range(len(v.levels))}, 1.0, 1.0))
                continue
            unit = self.unit(i)
            low, high = (fixed[i],) * 2 if i in fixed else (v.low, v.high)
            step = None if i in fixed else steps[i]
            low, high = (low / unit, high / unit) if step is None else ends(v.low, v.high, step)
            self._column(low, high, whole=step is not None)
        for i, v in enumerate(variables):
            if not v.leveled:
                self.apart[i] = self._column(0.0, math.inf, whole=False)
        for each in rules.linear:
            row: dict[int, float] = {}
            for i, weight in each.weights:
                v = variables[i]
                if v.leveled:
                    row |= {self.at[i] + level: float(weight) * float(value) for level, value in enumerate(v.levels)}
                else:
                    row[self.at[i]] = float(weight * self._unit(i))
            # In units of the finest grid, so that the solver's tolerance of 1e-6 is negligible.
            grids = [abs(float(weight * self._unit(i))) for i, weight in each.weights if i not in fixed and steps[i]]
            fine = min([1.0, *(grid for grid in grids if grid > 1e-12)])
            bound = float(each.bound) / fine
            row = {column: value / fine for column, value in row.items()}
            self.rows.append((row, bound if each.equal else -math.inf, bound))
        for each in rules.forbidden:
            self.rows.append(({self._fails(clause): 1.0 for clause in each.clauses}, 1.0, math.inf))

    def _column(self, low: float, high: float, *, whole: bool) -> int:
        self.lows.append(low)
        self.highs.append(high)
        if whole:
            self.whole.append(len(self.lows) - 1)
        return len(self.lows) - 1

    def _unit(self, i: int) -> Fraction:
        return self.steps[i] or Fraction(1)

    def unit(self, i: int) -> float:
        """The value of one unit in the column of a number."""
        return float(self._unit(i))

    def _fails(self, clause: Clause) -> int:
        """Adds a binary column that can be 1 only if a condition does not hold, and returns it."""
        i, v = clause.column, self.variables[clause.column]
        if i in self.fixed or v.low == v.high:  # its only value need not be on a grid
            only = self.fixed.get(i, v.low)
            value = Fraction(int(only)) if v.leveled else Fraction(str(np.float32(only)))
            return self._column(0.0, 0.0 if clause.holds(value) else 1.0, whole=True)
        out = self._column(0.0, 1.0, whole=True)
        if v.leveled:
            met = {self.at[i] + level: 1.0 for level in range(len(v.levels)) if clause.holds(Fraction(level))}
            self.rows.append(({out: 1.0} | met, -math.inf, 1.0))
            return out
        unit = self.unit(i)
        low, high = (b if math.isfinite(b) else s * FURTHEST * self.scale[i] for b, s in ((v.low, -1), (v.high, 1)))
        at = clause.value / self._unit(i)
        # The nearest values on the grid for which the condition does not hold.
        if clause.relation in (">", ">="):
            limit = math.floor(at) if clause.relation == ">" else math.ceil(at) - 1
            reach = max(high / unit - limit, 0.0)
            self.rows.append(({self.at[i]: 1.0, out: reach}, -math.inf, limit + reach))
        else:
            limit = math.ceil(at) if clause.relation == "<" else math.floor(at) + 1
            reach = max(limit - low / unit, 0.0)
            self.rows.append(({self.at[i]: 1.0, out: -reach}, limit - reach, math.inf))
        return out

    def nearest(self, x: np.ndarray, scale: np.ndarray) -> np.ndarray | None:
        """(variables,) the nearest design to this one; None: there is none, or it was not found in time.

        Args:
            x: (variables,) the design.
            scale: (variables,) units in which distances from it are measured.
        """
        cost = np.zeros(len(self.lows))
        rows = list(self.rows)
        for i, v in enumerate(self.variables):
            if not v.leveled:
                here, unit, apart = float(x[i]) / self.unit(i), self.unit(i) / scale[i], self.apart[i]
                cost[apart] = unit
                rows.append(({self.at[i]: 1.0, apart: -1.0}, -math.inf, here))
                rows.append(({self.at[i]: 1.0, apart: 1.0}, here, math.inf))
                continue
            for level in range(len(v.levels)):
                away = abs(level - x[i]) / scale[i] if v.kind == "ordinal" else 2.0 * (level != int(x[i]))
                cost[self.at[i] + level] = away
        found = self._solved(cost, rows).x
        if found is None:
            return None
        out = np.empty(len(self.variables))
        for i, v in enumerate(self.variables):
            if v.leveled:
                out[i] = found[self.at[i] : self.at[i] + len(v.levels)].argmax()
                continue
            value, step = found[self.at[i]], self.steps[i]
            out[i] = value if step is None else round(value) * step.numerator / step.denominator
        ruled = {column for row, _, _ in self.rows for column in row}
        for i, v in enumerate(self.variables):  # numbers that no rule holds need not move, however small they are
            if not v.leveled and self.steps[i] is None and self.at[i] not in ruled:
                out[i] = np.clip(x[i], v.low, v.high)
        out[list(self.fixed)] = list(self.fixed.values())
        return out

    def possible(self) -> bool | None:
        """Whether any design on its grids satisfies all rules; None: none was found in time."""
        found = self._solved(np.zeros(len(self.lows)), self.rows)
        return True if found.x is not None else None if found.status == _TIME else False

    def _solved(self, cost: np.ndarray, rows: list[tuple[dict[int, float], float, float]]) -> Any:
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import csr_array

        where = [(k, column, value) for k, (row, _, _) in enumerate(rows) for column, value in row.items()]
        k, columns, values = zip(*where) if where else ((), (), ())
        matrix = csr_array((values, (k, columns)), shape=(len(rows), len(cost)))
        whole = np.zeros(len(cost))
        whole[self.whole] = 1
        lows, highs = (np.array([row[end] for row in rows]) for end in (1, 2))
        bounds = Bounds(np.array(self.lows), np.array(self.highs))
        limits = LinearConstraint(matrix, lows, highs)
        found = milp(
            cost, integrality=whole, bounds=bounds, constraints=limits,
            options={"time_limit": SECONDS, "mip_rel_gap": 1e-3},
        )  # fmt: skip
        return found


def possible(programs: Iterable[Program]) -> bool | None:
    """Whether one of the programs has a solution; None: none was found, and some reached the time limit."""
    late = 0
    for program in programs:
        found = program.possible()
        if found:
            return True
        late += found is None
        if late == LATE:
            break
    return None if late else False
