"""Messages on possible mistakes in a table of experiments, which is read all the same; one line each."""

import re
import shlex
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from fractions import Fraction

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import as_dates, compute, decoded, flat, is_text
from deadreckon.data.placeholders import placeholder
from deadreckon.mbo.constraints import Linear
from deadreckon.mbo.design_table import rows_told
from deadreckon.mbo.rules import NO_RULES, Rules
from deadreckon.mbo.variables import Variable, measured
from deadreckon.stats.ranks import spearman

_RANGES = 3.0  # least distance of an outlier from all other values, in ranges of these
_SEVERAL = 2  # a level in a single row may be a misspelling of one that is in more rows than this
_ALIKE = 0.8  # least similarity of two texts (`difflib`) that may be spellings of the same
_FEW = 0.2  # largest share of rows whose violations of a sum may be errors in these rows
_FEWEST = 3  # least number of different values whose range is meaningful
ROUNDED = 0.01  # relative error of a sum that rounded decimals may cause
_SLACKS = np.geomspace(1e-6, ROUNDED, 41)  # tolerances of a sum, in wholes; the least first, so that traces count as parts
_RELATED = 1e-3  # tolerance of a linear relation, in standard deviations of the variables
_SAME = 0.98  # rank correlation with the score above which an input may be another outcome
_LEAST = 0.01  # least weight of a column in the space of constant sums; each of k parts of a whole has 1 / k
_MANY = 200  # number of variables from which on sums are not searched
_DECADES = 3.0  # least span of numbers that may be meant for a log scale
_THIRD = 0.1  # least share of them in each third of that span
_TIED, _TIMES_MORE, _VARIED = 3, 3, 10  # least number of best scores that are equal, how many times other ties, and values
_GROUPS = re.compile(r"(batch|lot|plate|operator|day|campaign)(es|s)?(_?(id|no|nr|number|name))?")
_WHOLES = (1, 100)  # sums of the parts of a whole


def of_inputs(
    variables: Sequence[Variable],
    x: np.ndarray,
    rows: np.ndarray,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    rules: Rules = NO_RULES,
) -> list[str]:
    """Messages on the inputs: columns that look like groups or run numbers, levels that are spelled nearly alike, outliers,
    sums and linear relations that hold but are not among the rules, and rows that violate sums among the rules.

    Args:
        variables: of the designs.
        x: (rows, variables) float64, as designs hold them: for levels their indices.
        rows: (rows,) their rows in the table, counted from 0.
        bounds: bounds given by the user, within which an outlier is intended, unless they are the range of the data, as in a
            draft.
        rules: of proposals.
    """
    lines = []
    for column, v in enumerate(variables):
        if of_groups(v.name):
            lines.append(
                f"column {v.name} is taken for an input; if it is no setting and tells which rows belong together, "
                f"--groups {shlex.quote(v.name)} holds these out together where predictions are tested"
            )
        if v.leveled:
            lines += _of_levels(v, x[:, column])
        elif told := placeholder(pa.array(x[:, column]), "leave such rows out"):
            lines.append(f"column {v.name} {told}")
        elif (row := far(x[:, column])) is not None and _not_meant((bounds or {}).get(v.name), x[:, column]):
            others = np.delete(x[:, column], row)
            end = f"<= {others.max():g}" if x[row, column] > others.max() else f">= {others.min():g}"
            text = f"{_far(v.name, x[:, column], row, rows)}; the models are fitted to it: correct it, or leave the row out, "
            text += "if it is an error"
            if not _excluded(rules, column, x[row, column]):
                text += f"; --constraints {shlex.quote(f'`{v.name}` {end}')} would keep proposals within the others' range"
            lines.append(text)
        elif _run_number(v, x[:, column]) and _not_meant((bounds or {}).get(v.name), x[:, column]):
            ends = f"{x[:, column].min():g} to {x[:, column].max():g}"
            text = f"column {v.name} has each whole number from {ends} once, and is taken for an input"
            text += f"; if it is the number of the run, leave it out (--ignore {shlex.quote(v.name)}) or, if the process "
            lines.append(f"{text}drifts, fix it at its latest value (--fix {shlex.quote(f'{v.name}={ends.split()[-1]}')})")
    for column, v in enumerate(variables):
        if not v.leveled and not v.log and spans_decades(x[:, column]):
            text = f"column {v.name} reaches from {x[:, column].min():g} to {x[:, column].max():g}, evenly in its logarithm"
            lines.append(f"{text}; have it modelled on a log scale (--logs {shlex.quote(v.name)})")
    sums = unsaid_sums(variables, x, rules)
    for columns, whole in sums:
        said = sum_of([variables[column].name for column in columns], whole)
        text = f"{said} in every row, and proposals need not satisfy it; if these are parts of a whole, say"
        lines.append(f"{text} --constraints {shlex.quote(said)}")
    numbers = measured(variables, x)
    lines += _of_relations(variables, numbers, said_in(rules) | {column for columns, _ in sums for column in columns})
    return lines + [line for each in rules.linear if each.equal for line in _of_sum(each, numbers, rows)]


def of_ignored(table: pa.Table, columns: Sequence[str]) -> list[str]:
    """Messages on ignored columns that may tell which rows belong together: times, and names such as batch, in several rows
    each."""
    lines = []
    for column in columns:
        values = decoded(flat(table, column)).drop_null()
        if pa.types.is_nested(values.type) or not (of_groups(column) or _holds_times(values)):
            continue
        if 1 < (count := len(compute.unique(values))) <= len(values) / 2:
            text = f"column {column} is ignored and has {count:,} values in {len(values):,} rows: if rows of one belong "
            text += f"together, hold them out together where predictions are tested (--groups {shlex.quote(column)})"
            lines.append(text)
    return lines


def _holds_times(values: pa.Array) -> bool:
    return pa.types.is_temporal(values.type) or (is_text(values.type) and as_dates(values) is not None)


def of_groups(name: str) -> bool:
    """Whether a column is named as one that tells which rows belong together."""
    return _GROUPS.fullmatch(name.lower()) is not None


def spans_decades(values: np.ndarray) -> bool:
    """Whether positive numbers lie evenly on a log scale, over three decades or more."""
    if values.min() <= 0 or (span := np.log10(values.max() / values.min())) < _DECADES:
        return False
    thirds = np.minimum(3 * np.log10(values / values.min()) / span, 2).astype(int)
    return bool(np.bincount(thirds, minlength=3).min() >= _THIRD * len(values))


def _not_meant(bounds: tuple[float, float] | None, values: np.ndarray) -> bool:
    return bounds is None or tuple(bounds) == (values.min(), values.max())


def _of_levels(v: Variable, values: np.ndarray) -> list[str]:
    """Messages on levels that differ only in case, and on levels of one row that are spelled nearly like a frequent one."""
    lines, count = [], np.bincount(values.astype(int), minlength=len(v.levels))
    texts = [(str(level), n) for level, n in zip(v.levels, count) if isinstance(level, str)]
    alike: dict[str, list[str]] = {}
    for level, _ in texts:
        alike.setdefault(level.casefold(), []).append(level)
    pairs = [" and ".join(same) for same in alike.values() if len(same) > 1]
    if pairs:
        text = f"column {v.name} has levels that differ in upper and lower case alone: {'; '.join(pairs[:5])}"
        lines.append(f"{text}; they are different levels, so write them alike if they are the same")
    usual = [level for level, n in texts if n > _SEVERAL and level.isalpha()]
    for level, n in texts:
        near = get_close_matches(level, usual, 1, _ALIKE) if n == 1 and level.isalpha() else []
        if near and level.casefold() != near[0].casefold():
            text = f"column {v.name} has {level} in one row, which is written nearly as {near[0]}"
            lines.append(f"{text}; they are different levels, so write them alike if it is an error")
    return lines


def _run_number(v: Variable, values: np.ndarray) -> bool:
    """Whether values look like run numbers: consecutive integers, each in one row."""
    return v.kind == "integer" and np.ptp(values) + 1 == len(values) == len(np.unique(values))


def unsaid_sums(variables: Sequence[Variable], x: np.ndarray, rules: Rules = NO_RULES) -> list[tuple[list[int], int]]:
    """Groups of columns that vary and sum to 1 or to 100 in every row, up to rounding, and are in no equality of the rules.

    The linear combinations of columns that are the same in every row form a space. The projection of a column's unit vector
    onto it has equal weights on all columns of its group and none on others, if no other combination is constant.

    Returns:
        (columns, sum) of each group.
    """
    said = said_in(rules)
    varied = np.ptp(x, axis=0) > 0
    open_ = [i for i, v in enumerate(variables) if not v.leveled and i not in said and varied[i] and "`" not in v.name]
    found: list[tuple[list[int], int]] = []
    for whole in _WHOLES:
        taken = {column for columns, _ in found for column in columns}
        parts = [i for i in open_ if i not in taken and _within(x[:, i] / whole)]
        if not 1 < len(parts) < min(len(x), _MANY):
            continue
        _, deviations, directions = np.linalg.svd(x[:, parts] - x[:, parts].mean(0), full_matrices=False)
        for slack in _SLACKS * whole:
            same = directions[deviations <= slack * len(x) ** 0.5]
            weights = same.T @ same
            for group in sorted({tuple(np.flatnonzero(row > row.max() / 2)) for row in weights if row.max() > _LEAST}):
                columns = [parts[i] for i in group if parts[i] not in taken]
                if 1 < len(columns) == len(group) and (np.abs(x[:, columns].sum(1) - whole) <= slack).all():
                    found.append((columns, whole))
                    taken |= set(columns)
    return sorted(found)


def said_in(rules: Rules) -> set[int]:
    """Columns that occur in equalities."""
    return {column for each in rules.linear if each.equal for column, _ in each.weights}


def _of_relations(variables: Sequence[Variable], x: np.ndarray, known: set[int]) -> list[str]:
    """Messages on variables with a linear relation in every row; arguments as for `relations`."""
    lines = []
    for group in relations(variables, x, known):
        names = [variables[i].name for i in group]
        text = f"{', '.join(names[:-1])} and {names[-1]} satisfy a linear relation in every row, and proposals need not"
        lines.append(f"{text}; ignore one that follows from the others, as a cost does, or say the relation as a constraint")
    return lines


def relations(variables: Sequence[Variable], x: np.ndarray, known: set[int]) -> list[tuple[int, ...]]:
    """Groups of variables with a linear relation in every row (levels as dummy variables); `known` columns are skipped, and
    `x` is `measured`."""
    parts, of = [], []
    for i, v in enumerate(variables):
        if i in known or np.ptp(x[:, i]) == 0:
            continue
        levels = np.unique(x[:, i])[1:] if v.kind == "categorical" else []
        columns = [(x[:, i] == level).astype(float) for level in levels] if v.kind == "categorical" else [x[:, i]]
        parts += columns
        of += [i] * len(columns)
    if not 1 < len(parts) < min(len(x) / 2, _MANY):
        return []
    z = np.stack(parts, 1)
    z = (z - z.mean(0)) / z.std(0)
    _, deviations, directions = np.linalg.svd(z, full_matrices=False)
    same = directions[deviations <= _RELATED * len(x) ** 0.5]
    weights = np.abs(same.T @ same) > _LEAST
    groups, told = [], set()
    for row in weights:
        group = tuple(dict.fromkeys(of[i] for i in np.flatnonzero(row)))
        if len(group) < 2 or told & set(group) or all(variables[i].kind == "categorical" for i in group):
            continue
        told |= set(group)
        groups.append(group)
    return groups


def of_outcomes(variables: Sequence[Variable], x: np.ndarray, target: str, y: np.ndarray) -> list[str]:
    """Messages on numbers that order the rows nearly like the scores `y` (rows,), as another outcome of an experiment does."""
    lines = []
    for i, v in enumerate(variables):
        if not v.leveled and np.ptp(x[:, i]) > 0 and abs(found := spearman(x[:, i], y)) > _SAME:
            text = f"{v.name} orders the rows nearly as {target} does (rank correlation {found:.2f}), and is taken for an input"
            lines.append(f"{text}; if it is another outcome, ignore it (--ignore {shlex.quote(v.name)})")
    return lines


def _within(share: np.ndarray) -> bool:
    return bool(share.min() >= -_SLACKS[0] and share.max() <= 1 + _SLACKS[0])


def sum_of(names: Sequence[str], whole: int) -> str:
    """A sum, written as a constraint."""
    return f"{' + '.join(name if name.isidentifier() else f'`{name}`' for name in names)} = {whole}"


def _of_sum(rule: Linear, x: np.ndarray, rows: np.ndarray) -> list[str]:
    """A message, if any, on rows that violate an equality by more than a hundredth of its terms; `x` is `measured`."""
    terms = np.stack([float(weight) * x[:, column] for column, weight in rule.weights], 1)
    total, slack = terms.sum(1), ROUNDED * np.maximum(np.abs(terms).sum(1), abs(float(rule.bound)))
    broken = np.abs(total - float(rule.bound)) > slack
    if not broken.any():
        return []
    if broken.sum() <= _FEW * len(rows):
        text = f"{rule.text} does not hold in {rows_told(rows[broken])}"
        return [f"{text}; the models are fitted to these: correct them, or leave them out, if they are errors"]
    span = f"{total[broken].min():.4g} to {total[broken].max():.4g}"
    text = f"{rule.text} does not hold in {broken.sum():,} of {len(rows):,} rows, where the sum is {span} instead of "
    return [f"{text}{float(rule.bound):g}; proposals satisfy it: check that it is right in the units of the table"]


def of_target(target: str, y: np.ndarray, rows: np.ndarray) -> list[str]:
    """Messages on a score that has only the values 0 and 1, or an outlier.

    Args:
        target: its column.
        y: (rows,) as in the table.
        rows: (rows,) their rows in the table, counted from 0.
    """
    if set(np.unique(y)) == {0.0, 1.0}:
        return [f"{target} has only the values 0 and 1: predictions are of its mean (a rate), and may lie below 0 or above 1"]
    if told := placeholder(pa.array(y), "empty such cells, or give runs that failed the worst score of the others,"):
        return [f"{target} {told}"]
    row = far(y)
    return [] if row is None else [f"{_far(target, y, row, rows)}: correct it, or leave the row out, if it is an error"]


def of_best(target: str, y: np.ndarray, minimise: bool) -> list[str]:
    """A message if several of the scores `y` (rows,), as in the table, are the best one, as where they were cut off."""
    values, counts = np.unique(y, return_counts=True)
    best = 0 if minimise else len(values) - 1
    if len(values) < _VARIED or counts[best] < max(_TIED, _TIMES_MORE * np.delete(counts, best).max()):
        return []
    end, beyond = ("least", "below") if minimise else ("greatest", "above")
    text = f"{counts[best]:,} rows have the {end} {target}, {values[best]:g}: if it is a limit, no score lies {beyond} it"
    return [f"{text}, and predictions {beyond} it mean that it is reached"]


def far(values: np.ndarray) -> int | None:
    """The row of the least or the greatest value, if it is an outlier; else None.

    It is one if its distance from all others is more than three times their range, and on a log scale also more than their
    range there, so that long tails are not outliers. The log scale is that of the values if all have the same sign, else that
    of their distances from the median in median absolute deviations. Zero, as for a control, is never an outlier.
    """
    if len(values) <= _FEWEST:
        return None
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
    """Whether no proposal has this value, by the rules on this variable alone."""
    alone = [each for each in rules.linear if [c for c, _ in each.weights] == [column]]
    return column in dict(rules.fixed) or not all(each.holds([Fraction(str(value))] * (column + 1)) for each in alone)
