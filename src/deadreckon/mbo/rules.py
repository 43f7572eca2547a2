"""Rules that proposals must satisfy beyond their bounds: linear constraints, forbidden combinations and fixed values.

All are checked exactly, as fractions of the decimal numbers as written, so that a mixture that must sum to 1 does so exactly.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.constraints import Forbidden, Linear, conditions, places, read_clause, read_fixed, read_linear
from deadreckon.mbo.variables import Variable
from deadreckon.names import repeated

ROUNDING = 1e-6  # relative tolerance of a fixed value, for the rounding of 32-bit numbers
_CONDITIONS = 50  # largest number of conditions of a forbidden combination


@dataclass(frozen=True)
class Rules:
    """All that proposals must satisfy.

    Attributes:
        linear: constraints.
        forbidden: combinations.
        fixed: (column, value as a design holds it) of variables that are not searched.
        max_distance: largest distance to the nearest scored design, in typical distances (`mbo.nn_distance`); None: no limit.
        apart: least distance between proposals, in typical distances; None: `mbo.batch.APART`, or less if there are too few.
    """

    linear: tuple[Linear, ...] = ()
    forbidden: tuple[Forbidden, ...] = ()
    fixed: tuple[tuple[int, float], ...] = ()
    max_distance: float | None = None
    apart: float | None = None

    @property
    def touched(self) -> set[int]:
        """Columns that occur in linear constraints or forbidden combinations."""
        linear = {column for each in self.linear for column, _ in each.weights}
        return linear | {clause.column for each in self.forbidden for clause in each.clauses}

    def decimals(self, variables: Sequence[Variable]) -> list[int]:
        """Number of decimals that each variable needs to satisfy its equalities.

        It is the largest among the bounds (minus fixed terms), weights, steps and levels of these equalities, and of others
        that share a variable with them.
        """
        values = {
            c: Fraction(str(variables[c].levels[int(value)] if variables[c].leveled else np.float32(value)))
            for c, value in self.fixed if variables[c].numeric_levels or not variables[c].leveled
        }  # fmt: skip
        out, sums = [0] * len(variables), []
        for each in self.linear:
            if not each.equal:
                continue
            left = each.bound - sum(weight * values.get(c, 0) for c, weight in each.weights)
            found = [places(left)]
            free = [(c, weight) for c, weight in each.weights if c not in values]
            for c, weight in free:
                v = variables[c]
                units = list(v.levels) if v.leveled else [v.step or 1]
                found += [places(weight), *(places(weight * Fraction(str(unit))) for unit in units)]
            sums.append((max(found), [c for c, _ in free]))
        for _ in sums:  # as often as a need can propagate to another equality
            for most, columns in sums:
                most = max([most, *(out[c] for c in columns)])
                for c in columns:
                    out[c] = most
        return out

    @classmethod
    def of(
        cls,
        variables: Sequence[Variable],
        *,
        constraints: Iterable[str] = (),
        mixtures: Iterable[Sequence[str]] = (),
        forbidden: Iterable[str] = (),
        fixed: Iterable[str] = (),
        max_distance: float | None = None,
        apart: float | None = None,
        name: str = "designs",
    ) -> "Rules":
        """Parses rules.

        Args:
            variables: of the designs.
            constraints: such as `a + 2 b <= 0.8`, with <=, >= or =; names with characters other than letters, digits and _
                must be in backticks.
            mixtures: groups of variables that sum to one.
            forbidden: combinations such as `solvent = water & temp > 80`.
            fixed: such as `temp = 60`.
            max_distance, apart: see `Rules`.
            name: of the data, for errors.

        Raises:
            UserError: one line: a text cannot be parsed, a variable is fixed twice, or a distance is not valid.
        """
        for group in mixtures:
            if twice := repeated(group):
                raise UserError(f"{name}: {twice[0]} is in a mixture twice; name each of its variables once")
        parts = [f"{' + '.join(f'`{each}`' for each in group)} = 1" for group in mixtures]
        linear = tuple(read_linear(text, variables, name) for text in [*constraints, *parts])
        for text in forbidden:
            if (count := len(conditions(text))) > _CONDITIONS:
                raise UserError(f"{name}: {text[:60]!r} ... has {count:,} conditions, and {_CONDITIONS} are the most")
        combinations = tuple(
            Forbidden(tuple(read_clause(part, variables, name, text) for part in conditions(text)), text) for text in forbidden
        )
        pinned = [read_fixed(text, variables, name) for text in fixed]
        if twice := {column for column, _ in pinned if [c for c, _ in pinned].count(column) > 1}:
            raise UserError(f"{name}: {variables[min(twice)].name} is fixed twice")
        if max_distance is not None and not max_distance > 0:
            raise UserError(f"{name}: the largest distance to the data must be above 0, got {max_distance:g}")
        if apart is not None and not 0 < apart < math.inf:
            raise UserError(f"{name}: the least distance between proposals must be a finite number above 0, got {apart:g}")
        return cls(linear, combinations, tuple(pinned), max_distance, apart)

    def broken(self, variables: Sequence[Variable], values: Sequence[Any]) -> str | None:
        """The first rule or step that a design violates, in words; None: it satisfies all.

        Args:
            variables: of the designs.
            values: one per variable, as from `written`.
        """
        exact = [Fraction(str(each)) for each in values]
        for column, value in self.fixed:
            if not at_value(float(exact[column]), value):
                return f"{variables[column].name} = {value:g}"
        for v, value in zip(variables, exact):
            if v.step is not None and value % Fraction(str(v.step)):
                return f"{v.name} in steps of {v.step:g}"
        measured = [
            Fraction(str(v.levels[int(value)])) if v.numeric_levels else value for v, value in zip(variables, exact)
        ]
        for each in self.linear:
            if not each.holds(measured):
                return each.text
        for each in self.forbidden:
            if all(clause.holds(exact[clause.column]) for clause in each.clauses):
                return f"not {each.text}"
        return None


NO_RULES = Rules()


def at_value(values: Any, value: float) -> Any:
    """(rows,) bool: which values of a variable equal the fixed one, up to relative rounding errors."""
    return np.abs(np.asarray(values, np.float64) - value) <= ROUNDING * abs(value)


def written(variables: Sequence[Variable], x: np.ndarray) -> list[list[Any]]:
    """(rows, variables) designs as written: numbers as the shortest texts that identify a float32, indices of levels as int."""
    whole = [v.kind != "continuous" for v in variables]
    return [[int(i) if w else str(np.float32(i)) for w, i in zip(whole, row)] for row in np.asarray(x, np.float32)]
