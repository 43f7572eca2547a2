"""The variables of a design: continuous, integer, categorical or ordinal, and their values from columns of a table."""

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import as_dates, category_codes, decoded, flat, is_category, is_number, is_text, some_numbers
from deadreckon.errors import UserError, unknown
from deadreckon.mbo.design_table import numbers_of

KINDS = ("continuous", "integer", "categorical", "ordinal")
FEWEST = 10  # least number of rows for a model
OWN = 0.9  # different texts per design above which the texts are identifiers of rows
SEVERAL = 3  # least number of different numbers with a unit; fewer may be names, such as 316L and 304L
WHOLE = 2**24  # up to which 32 bits hold every whole number
FINE = 1e-3  # largest distance between neighbouring float32 numbers, in standard deviations of a column
_AS_WHOLE = re.compile(r"[-+]?(?:0|[1-9]\d*)", re.ASCII)
_AS_NUMBER = re.compile(r"[-+]?(?:(?:0|[1-9]\d*)(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_RANGE = re.compile(r"\d+(?:[.,]\d*)?\s*[-\u2013\u2014]\s*\d+(?:[.,]\d*)?")
_WITH_UNIT = re.compile(r"[-+\u2212]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?\s*([^\d\s.,+/:-]\S{0,9}(?:\s\S{1,9})?)")


class Mend(UserError):
    """A column of numbers whose cells must be corrected before it can be read."""


@dataclass(frozen=True)
class Variable:
    """An input and its domain.

    Attributes:
        name: of the column.
        kind: among `KINDS`.
        low, high: inclusive bounds; for an ordinal variable those of the indices, without meaning for a categorical one.
        levels: of a categorical or an ordinal variable; a design holds their indices. Those of an ordinal one are in order.
        step: proposals are multiples of it; None: any number. For numbers only.
        log: whether models use the logarithm; for positive numbers only.
    """

    name: str
    kind: Literal["continuous", "integer", "categorical", "ordinal"] = "continuous"
    low: float = -math.inf
    high: float = math.inf
    levels: tuple[Any, ...] = ()
    step: float | None = None
    log: bool = False

    def __post_init__(self):
        if self.kind not in KINDS:
            raise UserError(f"{self.name}: {unknown('kind', self.kind, KINDS)}")
        if self.leveled and not self.levels:
            raise UserError(f"{self.name}: a{'n' * (self.kind == 'ordinal')} {self.kind} variable needs its levels")
        if len(set(self.levels)) < len(self.levels):
            twice = next(level for i, level in enumerate(self.levels) if level in self.levels[:i])
            raise UserError(f"{self.name}: its level {twice!r} is listed twice; levels must differ, numbers by their values")
        if odd := [level for level in self.levels if isinstance(level, float) and not math.isfinite(level)]:
            raise UserError(f"{self.name}: a level must be finite, got {odd[0]}")
        if self.kind == "ordinal":
            object.__setattr__(self, "low", 0.0)
            object.__setattr__(self, "high", len(self.levels) - 1.0)
        if not self.low <= self.high:
            raise UserError(f"{self.name}: bounds must satisfy low <= high, got {self.low:g} and {self.high:g}")
        if self.leveled and (self.step is not None or self.log):
            raise UserError(f"{self.name}: a step and a log scale are for numbers, and it is {self.kind}")
        if self.step is not None and not 0 < self.step < math.inf:
            raise UserError(f"{self.name}: a step must be a positive number, got {self.step:g}")
        if self.kind == "integer" and self.step is not None and self.step != round(self.step):
            raise UserError(f"{self.name}: holds whole numbers, its step must be whole too, got {self.step:g}")
        if self.log and self.low <= 0:
            raise UserError(f"{self.name}: a log scale needs a lower bound above 0, got {self.low:g}")
        if self.log and self.low < (least := float(np.finfo(np.float32).tiny)):
            raise UserError(f"{self.name}: a log scale begins at {least:.3g} (32 bits), got {self.low:g}; take another unit")

    def __repr__(self) -> str:  # part of names of result files: without defaults, so that old names stay valid
        more = "".join(f", {key}={getattr(self, key)!r}" for key in ("step", "log") if getattr(self, key))
        named = f"name={self.name!r}, kind={self.kind!r}, low={self.low!r}, high={self.high!r}, levels={self.levels!r}"
        return f"Variable({named}{more})"

    @property
    def leveled(self) -> bool:
        """Whether a design holds indices of levels."""
        return self.kind in ("categorical", "ordinal")

    @property
    def numeric_levels(self) -> bool:
        """Whether it is ordinal with levels that are numbers; truth values are none."""
        return self.kind == "ordinal" and all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.levels)


def variable_of(
    name: str,
    table: pa.Table,
    column: str,
    kind: str | None,
    bounds: tuple[float, float] | None,
    levels: Any,
    rows: np.ndarray,
    converted: bool = False,
) -> tuple[np.ndarray, Variable]:
    """The values of a column in the given rows, as designs hold them, and its variable.

    Args:
        name: of the data, used in errors.
        table: in which the column is.
        column: its name.
        kind: among `KINDS`; None: by the column.
        bounds: lowest and highest value; None: those of the rows.
        levels: all levels; None: those of the rows.
        rows: (rows,) that are read, counted from 0.
        converted: whether a reader has converted texts that are numbers, so that a column which is left as texts is one.

    Raises:
        UserError: the column cannot be an input of this kind, with these bounds or levels.
    """
    stored, given = table.column(column).type, kind
    if pa.types.is_temporal(stored):
        raise _holds_times(name, column)
    if kind is None and not levels and _plain_text(stored):
        kind = "categorical" if converted else _kind_of_texts(filled(name, table, column, rows))
    elif kind is None:
        kind = "categorical" if is_category(stored) or levels else "integer" if pa.types.is_integer(stored) else "continuous"
    if kind not in KINDS:
        raise UserError(f"{name}: column {column}: {unknown('kind', kind, KINDS)}")
    if kind not in ("categorical", "ordinal"):
        if levels:
            raise UserError(f"{name}: column {column} is {kind} and has no levels; to propose these alone, make it ordinal")
        return _number(name, table, column, kind, bounds, rows)
    if bounds is not None:
        raise UserError(f"{name}: column {column} is {kind} and has levels, not bounds")
    if kind == "ordinal" and not levels and is_category(stored):
        raise UserError(f"{name}: column {column} is ordinal: give its levels in their order, such as low,medium,high")
    values, variable = _category(name, table, column, levels, rows, told=given is not None or bool(levels))
    return values, replace(variable, kind=kind)


def _category(
    name: str, table: pa.Table, column: str, levels: Sequence[Any] | None, rows: np.ndarray, *, told: bool
) -> tuple[np.ndarray, Variable]:
    """Level indices of a column, and the variable; unless its kind or levels are given (`told`), likely errors are refused."""
    stored, values = table.column(column).type, filled(name, table, column, rows)
    if not told and _plain_text(stored):
        _check_texts(name, column, values, rows)
    if levels:
        known = _typed(levels, stored)
    elif is_category(stored) and not pa.types.is_boolean(stored):
        known = tuple(category_codes(name, column, flat(table, column).take(pa.array(rows)))[1])
    else:
        known = tuple(sorted(set(values)))
    return codes(name, column, values, known, rows), Variable(column, "categorical", levels=known)


def _plain_text(stored: pa.DataType) -> bool:
    return is_text(stored) and not pa.types.is_dictionary(stored)


def _kind_of_texts(values: Sequence[str]) -> str:
    """The kind of a column of texts: that of numbers if all are written as numbers, of which designs hold every one.

    Codes such as 007 and 4012345678901 are texts.
    """
    if not all(map(_AS_NUMBER.fullmatch, values)):
        return "categorical"
    whole, largest = all(map(_AS_WHOLE.fullmatch, values)), max(abs(float(value)) for value in values)
    if largest > (WHOLE if whole else float(np.finfo(np.float32).max)):
        return "categorical"
    return "integer" if whole else "continuous"


def texts_told(table: pa.Table, variables: Sequence[Variable]) -> list[str]:
    """A message for each of these variables that is read as numbers from texts, or whose texts are large whole numbers."""
    told = []
    for v in variables:
        if not is_text(table.column(v.name).type):
            continue
        if not v.leveled:
            text = "holds texts that are all numbers, and is read so; if they are names, say kind categorical"
            told.append(f"column {v.name} {text}")
        elif all(_AS_WHOLE.fullmatch(str(level)) for level in v.levels) and max(map(float, v.levels)) > WHOLE:
            text = f"holds whole numbers as texts, some beyond {WHOLE:,}, which are read as names"
            told.append(f"column {v.name} {text}; if they are quantities, give them as numbers in a larger unit")
    return told


def _holds_times(name: str, column: str) -> UserError:
    quoted = shlex.quote(column)
    remedy = f"make numbers of them, ignore the column (--ignore {quoted}), or, if rows of one day belong together, hold them "
    remedy += f"out together where predictions are tested (--groups {quoted})"
    return UserError(f"{name}: column {column} holds times; {remedy}")


def _number(
    name: str, table: pa.Table, column: str, kind: str, bounds: tuple[float, float] | None, rows: np.ndarray
) -> tuple[np.ndarray, Variable]:
    """Values of a column of numbers, and the variable with its bounds."""
    values = numbers_of(name, table, column, rows)
    low, high = bounds if bounds is not None else (values.min(), values.max())
    if not low <= high:
        raise UserError(f"{name}: column {column}: bounds must be low and high, got {low:g} and {high:g}")
    if kind == "integer" and bounds is not None and (low != np.ceil(low) or high != np.floor(high)):
        raise UserError(f"{name}: column {column} holds whole numbers, its bounds must be whole too, got {low:g} and {high:g}")
    if kind == "integer" and max(abs(low), abs(high)) > WHOLE:
        raise UserError(
            f"{name}: column {column} reaches beyond 16,777,216, where 32 bits do not hold every whole number; "
            f"take a constant off it, or ignore it"
        )
    if kind == "integer" and (values != np.round(values)).any():
        row = int(np.argmax(values != np.round(values)))
        raise UserError(f"{name}: column {column} has {values[row]:g} in row {rows[row]}, whole numbers are needed")
    spread, fineness = values.std() if np.ptp(values) else 0.0, float(np.spacing(np.float32(np.abs(values).max())))
    if kind == "continuous" and fineness > FINE * spread > 0:
        raise UserError(
            f"{name}: column {column} reaches {np.abs(values).max():g} with a deviation of {spread:.3g}, which 32 bits hold in "
            f"steps of {fineness:g} only; take a constant off it, or ignore it"
        )
    outside = (values < low) | (values > high)
    if outside.any():
        row = int(np.argmax(outside))
        where = f"in row {rows[row]}, outside the bounds [{low:g}, {high:g}]"
        end = f">= {low:g}" if values[row] < low else f"<= {high:g}"
        how = f"to keep proposals alone within them, use --constraints {shlex.quote(f'`{column}` {end}')}"
        raise UserError(f"{name}: column {column} has {values[row]:g} {where}; {how}")
    if bounds is not None and low == high:  # a constant, as the nearest 32-bit number
        low = high = float(str(np.float32(low)))
    elif bounds is not None:
        low, high = _within(float(low), 1), _within(float(high), -1)
        if low > high:
            raise UserError(f"{name}: column {column}: 32 bits hold no number between its bounds {bounds[0]} and {bounds[1]}")
    return values, Variable(column, kind, float(low), float(high))  # pyrefly: ignore[bad-argument-type] - of `KINDS`


def _within(bound: float, inwards: int) -> float:
    """The nearest 32-bit number to a bound that, as written, is not beyond it; `inwards` is 1 for a lower bound, else -1."""
    largest = np.finfo(np.float32).max
    found = np.float32(bound if math.isinf(bound) else min(max(bound, -largest), largest))
    if math.isfinite(bound) and inwards * (Fraction(str(found)) - Fraction(str(bound))) < 0:
        found = np.nextafter(found, np.float32(inwards * math.inf))
    return float(str(found))


def _typed(levels: Sequence[Any], stored: pa.DataType) -> tuple[Any, ...]:
    """Levels, with texts converted to the type of the values in the column."""
    truths = {"true": True, "false": False}

    def typed(level: Any) -> Any:
        if not isinstance(level, str):
            return level
        level = level.strip()
        if pa.types.is_boolean(stored):
            return truths.get(level.lower(), level)
        if not (pa.types.is_integer(stored) or pa.types.is_floating(stored)) or not is_number(level):
            return level
        return int(level) if level.lstrip("-").isdigit() else float(level)

    return tuple(map(typed, levels))


def filled(name: str, table: pa.Table, column: str, rows: np.ndarray) -> list[Any]:
    """The values of a column in the given rows, none of which may be missing.

    Raises:
        UserError: one is; the line names its row.
    """
    found = table.column(column).to_pylist()
    values = [found[row] for row in rows]
    for row, value in zip(rows, values):
        if value is None or (isinstance(value, float) and math.isnan(value)):
            raise UserError(f"{name}: column {column} is empty in row {row}")
    return values


def measured(variables: Sequence[Variable], x: np.ndarray) -> np.ndarray:
    """(rows, variables) float64 designs with levels that are ordered numbers in place of their indices."""
    x = np.array(x, np.float64)
    for column, v in enumerate(variables):
        if v.numeric_levels:
            x[:, column] = np.array(v.levels, np.float64)[x[:, column].astype(int)]
    return x


def name_of_rows(v: Variable, values: np.ndarray, designs: int) -> str | None:
    """A message if nearly every design has a different level of a variable, which then identifies rows; else None.

    Args:
        v: the variable.
        values: (rows,) indices of its levels.
        designs: number of different designs.
    """
    own = len(np.unique(values)) if v.kind == "categorical" else 0
    if own < FEWEST or own <= OWN * designs:
        return None
    text = f"holds {own:,} different values in {designs:,} designs, like an identifier of rows, and has no effect to estimate"
    return f"column {v.name} {text}; ignore it (--ignore {shlex.quote(v.name)}), or say kind categorical"


def _check_texts(name: str, column: str, values: Sequence[str], rows: np.ndarray) -> None:
    """Refuses texts that are numbers in most rows, or several numbers with the same unit, or ranges: each would be a category.

    Raises:
        Mend: they are.
        UserError: they are dates.
    """
    if as_dates(pa.array(values)) is not None:
        raise _holds_times(name, column)
    by_unit: dict[str, list[str]] = {}
    for value in values:
        if found := _WITH_UNIT.fullmatch(value):
            by_unit.setdefault(found[1], []).append(value)
    unit, cells = max(by_unit.items(), key=lambda each: len(each[1]), default=("", []))
    if len(cells) > len(values) / 2 and len(set(cells)) >= SEVERAL:
        more = " (in a mixture, which sums to 1, 40% is 0.4)" if unit == "%" else ""
        raise Mend(
            f"{name}: column {column} holds texts such as {cells[0]!r}; take the {unit!r} off, so that they are numbers, or "
            f"say kind categorical{more}"
        )
    ranges = [value for value in values if _RANGE.fullmatch(value)]
    if len(ranges) > len(values) / 2 and len(set(ranges)) >= SEVERAL:
        text = f"holds texts such as {ranges[0]!r}; write one number, such as the middle of the range, or say kind categorical"
        raise Mend(f"{name}: column {column} {text}")
    bad = [row for row, value in enumerate(values) if not is_number(value)]
    if bad and len(bad) < len(values) / 2:
        row = bad[0]
        raise Mend(
            f"{name}: column {column} holds {values[row]!r} in row {rows[row]}, where most rows hold numbers; "
            "correct it, or say kind categorical"
        )


def codes(name: str, column: str, values: Sequence[Any], levels: Sequence[Any], rows: np.ndarray) -> np.ndarray:
    """(rows,) float64 indices of the values of these rows in the levels of a variable.

    Raises:
        UserError: a value is none of them.
    """
    index = {level: i for i, level in enumerate(levels)}
    out = []
    for row, value in zip(rows, values):
        if value not in index:
            shown = ", ".join(map(str, levels[:8])) + (", ..." if len(levels) > 8 else "")
            raise UserError(f"{name}: column {column} has the unknown level {value!r} in row {row}; known are {shown}")
        out.append(index[value])
    return np.array(out, np.float64)


def complete_designs(
    name: str, table: pa.Table, variables: Sequence[Variable], scored: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(k, variables) float32 designs of the rows without a score that have a value, or a known level, of every variable, (k,)
    these rows, and messages on unknown levels.

    They may be outside of the bounds.
    """
    columns: list[Any] = []
    told: list[str] = []
    rows = np.setdiff1d(np.arange(table.num_rows), scored)
    for v in variables:
        if v.leveled:
            index, values = {level: float(i) for i, level in enumerate(v.levels)}, table.column(v.name).to_pylist()
            columns.append([index.get(values[row], math.nan) for row in rows])
            odd = [row for row in rows if values[row] is not None and values[row] not in index]
            if odd:
                what = f"column {v.name} has {values[odd[0]]!r} in row {odd[0]}, which no row with a score has"
                told.append(f"{what}, so this run may be proposed again{f' ({len(odd)} such rows)' if len(odd) > 1 else ''}")
            continue
        cells = flat(table, v.name).take(pa.array(rows))
        if is_text(cells.type):  # others may be no numbers
            texts = ["nan" if text is None or not is_number(text) else text for text in decoded(cells).to_pylist()]
            cells = pa.array(texts, pa.string())
        columns.append(some_numbers(name, v.name, cells)[0])
    with np.errstate(over="ignore"):  # a larger number than 32 bits hold is infinite
        x = np.stack(columns, 1).astype(np.float32)
    complete = np.isfinite(x).all(1)
    return x[complete], rows[complete], told
