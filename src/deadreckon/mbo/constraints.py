"""Linear constraints, forbidden combinations and fixed values, and their parsers.

Numbers are exact fractions of the decimal numbers as written, so that a mixture that must sum to 1 can do so exactly.
"""

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from deadreckon.data.arrow import is_number
from deadreckon.errors import UserError, unknown
from deadreckon.mbo.variables import Variable

_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_LONGEST, _EXPONENT = 100, 300  # largest number of characters of a number, and largest exponent of ten
_LARGEST = 1e300
COMPARED = {
    "=": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
_RELATION = re.compile(r"<=|>=|==|!=|=|<|>")


@dataclass(frozen=True)
class Linear:
    """A linear constraint: a weighted sum of variables that must be at most, or exactly, a bound.

    Attributes:
        weights: (column of the designs, weight) of each variable in it.
        equal: whether the sum must equal the bound.
        bound: of the sum.
        text: the constraint as given.
    """

    weights: tuple[tuple[int, Fraction], ...]
    equal: bool
    bound: Fraction
    text: str

    def holds(self, values: Sequence[Any]) -> bool:
        """Whether a design, with one exact number per variable, satisfies it."""
        total = sum(weight * values[column] for column, weight in self.weights)
        return total == self.bound if self.equal else total <= self.bound


@dataclass(frozen=True)
class Clause:
    """A condition on one variable.

    Attributes:
        column: of the variable in the designs.
        relation: between the variable and `value`: =, !=, <, <=, > or >=.
        value: a number; for a variable with levels and = or != the index of a level.
        levels: indices of the levels that satisfy the condition; None for a variable without levels.
    """

    column: int
    relation: str
    value: Fraction
    levels: tuple[int, ...] | None = None

    def holds(self, value: Fraction) -> bool:
        """Whether a value, or the index of a level, satisfies it."""
        return COMPARED[self.relation](value, self.value) if self.levels is None else value in self.levels

    def met(self, values: np.ndarray) -> np.ndarray:
        """(rows,) bool: which values satisfy it, with both sides in 32-bit floating point, like the designs."""
        if self.levels is not None:
            return np.isin(values, self.levels)
        with np.errstate(over="ignore"):  # a larger number than 32 bits hold is infinite
            return COMPARED[self.relation](np.asarray(values, np.float32), np.float32(float(self.value)))


@dataclass(frozen=True)
class Forbidden:
    """Conditions that no proposal may satisfy all at once; `text` is the combination as given."""

    clauses: tuple[Clause, ...]
    text: str


def _column(given: str, variables: Sequence[Variable], name: str) -> int:
    names = [v.name for v in variables]
    given = given.strip().strip("`")
    if given not in names:
        odd = next((each for each in names if given and each.startswith(given) and not each.isidentifier()), None)
        if odd is not None:
            raise UserError(f"{name}: unknown variable {given!r}: {odd!r} stands in backticks in rules, as `{odd}`")
        raise UserError(f"{name}: {unknown('variable', given, names)}")
    return names.index(given)


def _bare(text: str) -> str:
    """The text with names in backticks, and levels in quotes after a relation, masked: signs in them separate nothing."""

    def hidden(match: re.Match[str]) -> str:
        before = match[1] or ""
        return before + "_" * (len(match[0]) - len(before))

    return re.sub(rf"`[^`]*`|((?:{_RELATION.pattern})\s*)(?:\"[^\"]*\"|'[^']*')", hidden, text)


def quoted(value: Any) -> str:
    """A value as written in a rule: texts are put into quotes that they do not contain."""
    mark = next((mark for mark in "\"'`" if mark not in value), "") if isinstance(value, str) else ""
    return f"{mark}{value}{mark}"


def _sides(text: str, name: str, what: str, several: str = "") -> tuple[str, str, str]:
    """The left side, the relation and the right side of a text; `several` is a hint for the error if there is more than one."""
    found = list(_RELATION.finditer(_bare(text)))
    if len(found) != 1:
        hint = f"; {several}levels that hold such signs stand in quotes" if found else ""
        raise UserError(f"{name}: {what} needs one relation, got {text!r}{hint}")
    at = found[0]
    return text[: at.start()], {"==": "="}.get(at[0], at[0]), text[at.end() :]


def read_linear(text: str, variables: Sequence[Variable], name: str) -> Linear:
    """Parses a constraint such as `a + 2 b <= 0.8`; `name` is that of the data, for errors.

    Raises:
        UserError: it cannot be parsed, or has a variable that is unknown or not numeric.
    """
    left, relation, right = _sides(text, name, 'a constraint such as "a + b <= 0.8"', "two of them are two constraints; ")
    if relation not in ("<=", ">=", "="):
        raise UserError(f"{name}: constraint {text!r} takes <=, >= or =, not {relation}")
    weights: dict[int, Fraction] = {}
    constant = Fraction(0)
    for side, sign in ((left, 1), (right, -1)):
        for factor, column in _terms(side, text, variables, name):
            if column is None:
                constant += sign * factor
            else:
                weights[column] = weights.get(column, Fraction(0)) + sign * factor
    weights = {column: weight for column, weight in weights.items() if weight}
    if not weights:
        raise UserError(f"{name}: constraint {text!r} names no variable")
    for column in weights:
        v = variables[column]
        if v.leveled and not v.numeric_levels:
            raise UserError(f"{name}: constraint {text!r} is of numbers, and {v.name} has levels; use a forbidden combination")
    turn = -1 if relation == ">=" else 1
    turned = tuple((column, turn * weight) for column, weight in weights.items())
    return Linear(turned, relation == "=", -turn * constant, text.replace("`", ""))


def _terms(side: str, text: str, variables: Sequence[Variable], name: str) -> list[tuple[Fraction, int | None]]:
    """(factor, column) of each term of a sum; the column of a constant is None."""
    term = re.compile(rf"\s*([+-])?\s*({_NUMBER})?\s*\*?\s*(`[^`]+`|[^\W\d]\w*)?\s*")
    at, out = 0, []
    while at < len(side.rstrip()):
        found = term.match(side, at)
        if found is None or (found[2] is None and found[3] is None) or (out and found[1] is None):
            where = side[at:].strip()
            needed = "numbers have a decimal point" if where.startswith(",") else "a sum such as a + 2 b is needed"
            raise UserError(f"{name}: constraint {text!r} cannot be read at {where!r}; {needed}")
        # This pattern matches any text.
        head, power, tail = re.match(r"([^eE]*)([eE]?)(.*)", found[2] or "").groups()  # pyrefly: ignore[missing-attribute]
        if power and {power + tail, power if tail[0] in "+-" else ""} & {v.name for v in variables}:
            times = f"{head} * {power}{tail}"
            raise UserError(f"{name}: constraint {text!r}: {found[2]} is a number, or {times}; write one or the other")
        factor = (Fraction(1) if found[2] is None else _exact(found[2], name)) * (-1 if found[1] == "-" else 1)
        out.append((factor, None if found[3] is None else _column(found[3], variables, name)))
        at = found.end()
    if not out:
        raise UserError(f"{name}: constraint {text!r} has an empty side")
    return out


def conditions(text: str) -> list[str]:
    """The conditions of a forbidden combination, separated by & outside of backticks and quotes."""
    cuts = [i for i, sign in enumerate(_bare(text)) if sign == "&"]
    return [text[start + 1 : end] for start, end in pairwise([-1, *cuts, len(text)])]


def read_clause(part: str, variables: Sequence[Variable], name: str, text: str) -> Clause:
    """Parses a condition such as `temp > 80`, a part of the forbidden combination `text`.

    Raises:
        UserError: it cannot be parsed, has an unknown variable or level, or a relation that the variable does not allow.
    """
    what = f"each condition of the forbidden combination {text!r}"
    left, relation, right = _sides(part, name, what, "conditions are joined by &; ")
    column = _column(left, variables, name)
    v = variables[column]
    if v.leveled and relation not in ("=", "!=") and not v.numeric_levels:
        raise UserError(f"{name}: forbidden combination {text!r}: {v.name} has levels, which are compared by = and != alone")
    if not v.leveled:
        if relation in ("=", "!="):
            raise UserError(f"{name}: {v.name} is a number; compare it with <, <=, > or >= in forbidden combinations")
        return Clause(column, relation, _fraction(right, v, name))
    same = relation in ("=", "!=")
    bound = Fraction(_level(right, v, name)) if same else _fraction(right, v, name)
    values = [Fraction(i) if same else Fraction(str(level)) for i, level in enumerate(v.levels)]
    return Clause(column, relation, bound, tuple(i for i, value in enumerate(values) if COMPARED[relation](value, bound)))


def read_fixed(text: str, variables: Sequence[Variable], name: str) -> tuple[int, float]:
    """Parses a fixed value such as `temp=60`: the column of the variable, and the value as designs hold it.

    Raises:
        UserError: it cannot be parsed, has an unknown variable or level, or a value that the variable does not allow.
    """
    left, relation, right = _sides(text, name, 'a fixed value such as "temp=60"')
    if relation != "=":
        raise UserError(f"{name}: a fixed value is NAME=VALUE, got {text!r}")
    column = _column(left, variables, name)
    v = variables[column]
    value = float(_level(right, v, name) if v.leveled else _fraction(right, v, name, "is fixed at"))
    slack = 2.0 * float(np.spacing(np.float32(abs(value))))  # bounds are rounded inwards to 32 bits
    if not v.leveled and not v.low - slack <= value <= v.high + slack:
        raise UserError(f"{name}: {v.name} is fixed at {value:g}, outside its bounds [{v.low:g}, {v.high:g}]")
    if v.kind == "integer" and value != round(value):
        raise UserError(f"{name}: {v.name} holds whole numbers and is fixed at {value:g}")
    return column, value


def _level(text: str, v: Variable, name: str) -> int:
    """The index of a level that was given as a text."""
    given = text.strip()
    if len(given) > 1 and given[0] == given[-1] and given[0] in "`'\"":
        given = given[1:-1]
    for i, level in enumerate(v.levels):
        if str(level).lower() == given.lower() if isinstance(level, bool) else str(level) == given:
            return i
    number = _fraction(given, v, name) if is_number(given) else None  # 1.0 names the level 1, too
    for i, level in enumerate(v.levels):
        if isinstance(level, int | float) and not isinstance(level, bool) and Fraction(str(level)) == number:
            return i
    raise UserError(f"{name}: {unknown(f'level of {v.name}', given, list(map(str, v.levels)))}")


def _fraction(text: str, v: Variable, name: str, how: str = "is compared with") -> Fraction:
    """The number that a text says; `how` is what a rule says of it and the variable, for errors."""
    try:
        return _exact(text.strip(), name)
    except (ValueError, ZeroDivisionError) as error:
        if isinstance(error, UserError):
            raise
        needed = "a number with a decimal point" if "," in text else "a number"
        raise UserError(f"{name}: {v.name} {how} {text.strip()!r}, {needed} is needed") from None


def places(number: Fraction) -> int:
    """Number of decimals of a number that has finitely many."""
    count = 0
    while number.denominator != 1:
        number, count = number * 10, count + 1
    return count


def _exact(text: str, name: str) -> Fraction:
    """The exact value of a decimal number; raises ValueError for other texts.

    Length and exponent are limited, because 1e999999999 would have a billion digits as a fraction, and designs are floats.
    """
    exponent = re.search(r"[eE]([+-]?\d+)\s*$", text)
    if len(text) > _LONGEST or (exponent is not None and abs(int(exponent[1])) > _EXPONENT):
        most = f"up to {_LONGEST} characters and exponents from -{_EXPONENT} to {_EXPONENT}"
        raise UserError(f"{name}: the number {text[:40]!r} is too long or too large; numbers have {most}")
    found = Fraction(text)
    if abs(found) > _LARGEST:
        raise UserError(f"{name}: the number {text[:40]!r} is too large; numbers are at most {_LARGEST:.0e} from zero")
    return found
