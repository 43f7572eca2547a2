"""What may be a mistake in a table of experiments and is read all the same: one line each."""

import shlex
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from deadreckon.mbo.rules import NO_RULES, Rules
from deadreckon.mbo.variables import Variable

_RANGES = 3.0  # ranges of all other values that lie between these and a value that is far
_FEWEST = 3  # different values among the others, fewer of which say nothing of their range


def of_inputs(
    variables: Sequence[Variable], x: np.ndarray, rows: np.ndarray, told: Sequence[str] = (), rules: Rules = NO_RULES
) -> list[str]:
    """Levels that differ in case alone, and numbers that are far from all others and may be proposed.

    Args:
        variables: of the designs.
        x: (rows, variables) float64, as the table has them.
        rows: (rows,) where they stand in the table, counted from 0.
        told: names of variables whose bounds somebody gave.
        rules: that proposals satisfy.
    """
    lines = []
    for column, v in enumerate(variables):
        if v.leveled:
            alike: dict[str, list[str]] = {}
            for level in v.levels:
                if isinstance(level, str):
                    alike.setdefault(level.casefold(), []).append(level)
            pairs = [" and ".join(same) for same in alike.values() if len(same) > 1]
            if pairs:
                text = f"column {v.name} has levels that differ in upper and lower case alone: {'; '.join(pairs[:5])}"
                lines.append(f"{text}; they are different levels, so write them alike if they are the same")
        elif v.name not in told and (row := far(x[:, column])) is not None and not _excluded(rules, column, x[row, column]):
            others = np.delete(x[:, column], row)
            end = f"<= {others.max():g}" if x[row, column] > others.max() else f">= {others.min():g}"
            kept = f"--constraints {shlex.quote(f'`{v.name}` {end}')}"
            lines.append(f"{_far(v.name, x[:, column], row, rows)}; proposals may go there: mend it, or say {kept}")
    return lines


def of_target(target: str, y: np.ndarray, rows: np.ndarray) -> list[str]:
    """A score that has two values only, or one that is far from all others.

    Args:
        target: its column.
        y: (rows,) as the table has it.
        rows: (rows,) where they stand in the table, counted from 0.
    """
    if set(np.unique(y)) == {0.0, 1.0}:
        return [f"{target} has only the values 0 and 1: predictions are of its mean (a rate), and may lie below 0 or above 1"]
    row = far(y)
    return [] if row is None else [f"{_far(target, y, row, rows)}: mend it, or leave the row out, if it is a slip"]


def far(values: np.ndarray) -> int | None:
    """The row of the least or the greatest value, if it is far from all others.

    It is where it lies more than three times the range of all others away from them, and also more than their range of
    logarithms on the scale of these, so that long tails are none: of the values where all have one sign, else of the
    distance from the median in median deviations. Zero is a value of its own, as of a control, and is never far.
    """
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    middle = np.median(values)
    usual = np.median(np.abs(values - middle))
    if ascending[0] > 0 or ascending[-1] < 0:
        scale = np.sign(ascending) * np.log(np.abs(ascending))
    elif usual > 0:
        scale = np.sign(ascending - middle) * np.log1p(np.abs(ascending - middle) / usual)
    else:
        return None
    for row, ends in ((order[-1], (ascending, scale)), (order[0], (-ascending[::-1], -scale[::-1]))):
        (gap, span), (long, length) = [(each[-1] - each[-2], each[-2] - each[0]) for each in ends]
        few = len(np.unique(ends[0][:-1])) < _FEWEST
        if values[row] != 0 and not few and gap > _RANGES * span and long > length:
            return int(row)
    return None


def _far(name: str, values: np.ndarray, row: int, rows: np.ndarray) -> str:
    others = np.delete(values, row)
    where = f"row {rows[row]}, counted from 0"
    return f"{name}: {values[row]:g} ({where}) is far from all others ({others.min():g} to {others.max():g})"


def _excluded(rules: Rules, column: int, value: float) -> bool:
    """Whether no proposal has this value, by what is said of this variable alone."""
    alone = [each for each in rules.linear if [c for c, _ in each.weights] == [column]]
    return column in dict(rules.fixed) or not all(each.holds([Fraction(str(value))] * (column + 1)) for each in alone)
