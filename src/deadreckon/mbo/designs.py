"""Scored designs: inputs x with one score y each, the domains of the variables, and the coordinates that models use."""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import to_arrow
from deadreckon.data.formats.csv_out import write_table
from deadreckon.data.formats.kind import READING
from deadreckon.data.kinds import check_column
from deadreckon.data.roles import row_numbers
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.mbo import doubts
from deadreckon.mbo.constraints import read_fixed
from deadreckon.mbo.coordinates import Coordinates
from deadreckon.mbo.design_table import (
    check_filled,
    groups_of,
    name_of,
    numbers_of,
    numpy_floats,
    read_for,
    score_name,
    scored,
    trimmed,
    warn,
    whole_again,
)
from deadreckon.mbo.driven_inputs import about_driven_inputs
from deadreckon.mbo.nn_distance import usual_distance
from deadreckon.mbo.over_time import about_order
from deadreckon.mbo.repair import Repair
from deadreckon.mbo.replicates import errors_of, pooled, recipes, units, units_told
from deadreckon.mbo.rules import NO_RULES, Rules
from deadreckon.mbo.variables import (
    FEWEST,
    Variable,
    codes,
    complete_designs,
    filled,
    name_of_rows,
    texts_told,
    variable_of,
)
from deadreckon.provided import Shown

SLACK = 1e-6  # by which designs may be beyond a bound, as a share of it
LARGEST = 1e150  # largest absolute score: squares of larger ones would overflow


@dataclass(frozen=True, eq=False)
class Designs(Shown):
    """Immutable designs and their scores.

    Attributes:
        x: (rows, variables) float32; for a categorical or ordinal variable the index of the level.
        y: (rows,) float64, the score to maximise.
        variables: one per column of `x`.
        name: of the data, used in errors and tables.
        target: name of the score.
        minimise: whether the score was negated: `y` is then minus the value of the table.
        rules: that proposals must satisfy; the data need not.
        replicates: (rows,) number of measurements of which each row is the mean; None: one each.
        std_error: (rows,) standard error of `y`; None: not known.
        groups: (rows,) number, from 0, of the group of each row, such as a batch: rows of a group are held out together when
            predictions are tested (`replicates.units`); None: there are no groups.
        table_rows: (rows,) the row of the table, counted from 0, that each row is from, of pooled ones the first; None: the
            same rows as in the table.
        pooling: how rows of the same design were pooled (`mbo.replicates.pooled`), in words; None: they were not.
        noticed: messages on possible mistakes in the table and on columns that are not used, one line each.
        unscored: (k, variables) float32 designs without a score, such as failed or planned runs: models are not fitted to them,
            and they are not proposed again; None: there are none.
        passed: (k,) bool, which of these stand before a row with a score, as runs that failed do. Those after all such rows, as
            proposals that were added to the table, are planned. None: all may have failed.
    """

    x: np.ndarray
    y: np.ndarray
    variables: tuple[Variable, ...]
    name: str = "designs"
    target: str = "y"
    minimise: bool = False
    rules: Rules = NO_RULES
    replicates: np.ndarray | None = None
    std_error: np.ndarray | None = None
    groups: np.ndarray | None = None
    table_rows: np.ndarray | None = None
    pooling: str | None = None
    noticed: tuple[str, ...] = ()
    unscored: np.ndarray | None = None
    passed: np.ndarray | None = None

    def __post_init__(self):
        object.__setattr__(self, "x", np.asarray(self.x, np.float32))
        object.__setattr__(self, "y", np.asarray(self.y, np.float64))
        for key in ("replicates", "std_error"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, np.asarray(getattr(self, key), np.float64))
                getattr(self, key).flags.writeable = False
        if self.groups is not None:
            object.__setattr__(self, "groups", np.asarray(self.groups, np.int64))
            self.groups.flags.writeable = False
        if self.x.ndim != 2 or self.x.shape != (len(self.y), len(self.variables)):
            asked = f"({len(self.y)}, {len(self.variables)}), a row per score and a column per variable"
            raise UserError(f"{self.name}: x must have shape {asked}, got {self.x.shape}")
        self.check(self.x)
        if not np.isfinite(self.y).all():
            row = int(self.numbered(np.array(np.isfinite(self.y).argmin())))
            raise UserError(f"{self.name}: {self.target} is not finite in row {row}")
        if np.abs(self.y).max(initial=0.0) > LARGEST:
            most = int(np.abs(self.y).argmax())
            where = f"in row {int(self.numbered(np.array(most)))}, and may be {LARGEST:g} at most"
            raise UserError(f"{self.name}: {self.target} is {self.y[most]:g} {where}")
        if len(self.y) < FEWEST:
            raise UserError(f"{self.name}: {len(self.y)} rows are too few, {FEWEST} or more are needed")
        if np.ptp(self.y) == 0:
            only = float(self.shown(self.y)[0])
            raise UserError(f"{self.name}: {self.target} is {only:g} in all rows, so no design is known to be better")
        if not np.ptp(self.x, axis=0).any():
            raise UserError(f"{self.name}: all designs are the same, so the effect of changes is not known")
        self.x.flags.writeable = self.y.flags.writeable = False

    def __len__(self) -> int:
        return len(self.y)

    def __repr__(self) -> str:
        how = "least" if self.minimise else "greatest"
        return f"Designs({self.name}: {len(self):,} designs, {len(self.variables):,} variables, {how} {self.target} sought)"

    @classmethod
    def from_arrays(
        cls, x: np.ndarray, y: np.ndarray, variables: Sequence[Variable] | None = None, *, name: str = "designs"
    ) -> "Designs":
        """Designs from arrays (rows, variables) and (rows,); without `variables` all are continuous and without bounds.

        Raises:
            UserError: shapes, values or scores that are not valid.
        """
        x = np.asarray(x)
        if variables is None:
            variables = [Variable(f"x{i}") for i in range(x.shape[1] if x.ndim == 2 else 0)]
        return cls(np.array(x, np.float32), np.array(y, np.float64), tuple(variables), name)

    @classmethod
    def from_csv(cls, path: Path | str, target: str, **options: Any) -> "Designs":
        """Designs from a file with a table: CSV in any dialect, Parquet, a spreadsheet, SQLite or DuckDB.

        Args:
            path: of the file.
            target: the column to maximise.
            options: as for `from_frame`, and those of the reader (`data.formats.any_table.table_of_kind`).

        Raises:
            UserError: as `from_frame` and `table_of_kind`.
        """
        ways = {key: options.pop(key) for key in READING if key in options}
        table, told, converts = read_for(path, ways, target, options)
        warn(path, told)
        options.setdefault("name", name_of(path))
        options.setdefault("converted", converts)
        return cls.from_frame(table, target, noticed=[*options.pop("noticed", ()), *told], **options)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        target: str,
        *,
        kinds: Mapping[str, str] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        levels: Mapping[str, Sequence[Any]] | None = None,
        ignore: Sequence[str] = (),
        minimise: bool = False,
        name: str = "frame",
        steps: Mapping[str, float] | None = None,
        logs: Sequence[str] = (),
        std_error: str | None = None,
        groups: str | None = None,
        weights: Mapping[str, float] | None = None,
        pool: bool = True,
        targets: Sequence[str] = (),
        noticed: Sequence[str] = (),
        converted: bool = False,
        **rules: Any,
    ) -> "Designs":
        """Designs from a table with one row per design. Rows without a score are left out, with a warning, and are not proposed
        again. Blanks at both ends of texts are removed.

        Args:
            frame: a pandas, polars or pyarrow table, or a mapping of column names to values.
            target: the column to maximise.
            kinds: {column: kind, among `KINDS`}. By default texts, categories and truth values are categorical, whole numbers
                integer, and all others continuous. Row numbers that a table library wrote, without a name, are left out.
            bounds: {column: lowest and highest value}, both inclusive. By default those of the data, so that nothing outside
                the range of the data is proposed.
            levels: {column: all its levels}, if the data lacks some; for ordinal columns in their order.
            ignore: columns that are not inputs.
            minimise: minimise the target instead.
            name: of the data, used in errors.
            steps: {column of numbers: step}; proposals are multiples of it.
            logs: columns of positive numbers that models use on a log scale.
            std_error: column with the standard error of the target.
            groups: column with the group of each row, such as its batch or day. Rows of a group may share influences that were
                not recorded, so predictions are tested on held-out groups. The column is not an input.
            weights: {column: weight} of further parts of the score, such as a cost: the score is the target plus the sum of
                weight times column.
            pool: whether rows of the same design are pooled into one, with the mean score (`mbo.replicates.pooled`).
            targets: all targets for which this table is read; a row with none of them is left out. By default `target` alone.
            noticed: earlier messages on the table, such as those of its reader.
            converted: whether a reader has converted texts that are numbers already, so that a column of texts is one of names,
                such as of versions 1.1 and 1.10 in a file with decimal commas.
            rules: of proposals; see `mbo.rules.Rules.of`.

        Raises:
            UserError: one line with column and row, or rules that no design satisfies.
        """
        table = to_arrow(frame, name)
        given = {"kinds": kinds, "bounds": bounds, "levels": levels, "ignore": ignore, "steps": steps, "logs": logs}
        outputs, grouped = [target, *(weights or {}), *([std_error] if std_error else [])], [groups] if groups else []
        _check_given(name, table, given, outputs, groups, targets)
        inputs = [column for column in table.column_names if column not in (*outputs, *grouped, *ignore)]
        told = []
        if index := row_numbers(inputs):
            told.append(f"column {index[0]!r} looks like a row number and is left out")
            inputs = [column for column in inputs if column not in index]
        if not inputs:
            raise UserError(f"{name}: there is no column other than the target {target!r}")
        table = trimmed(table, [*inputs, *grouped])
        rows, planned = scored(name, table, targets or [target])
        if planned:
            planned += "; complete ones are not proposed again (--repeat allows it)"
        warn(name, told := told + ([planned] if planned else []))
        check_filled(name, table, inputs, [*outputs, *grouped], rows)
        if "fixed" in rules:
            rules["fixed"] = tuple(rules["fixed"] or ())  # it is read twice
        unsaid = [each for each in inputs if each not in {*(kinds or {}), *(levels or {})}]
        floats = numpy_floats(frame) - _not_whole(name, inputs, bounds or {}, steps or {}, rules.get("fixed") or ())
        table, restored = whole_again(table, [each for each in unsaid if each in floats])
        y, columns, variables = numbers_of(name, table, target, rows), [], []
        raw, slips = y, doubts.of_target(target, y, rows) + doubts.of_best(target, y, minimise)
        for column, weight in (weights or {}).items():
            y = y + weight * numbers_of(name, table, column, rows)
        for column in inputs:
            values, variable = variable_of(
                name, table, column, (kinds or {}).get(column), (bounds or {}).get(column), (levels or {}).get(column), rows,
                converted,
            )  # fmt: skip
            columns.append(values)
            variables.append(replace(variable, step=(steps or {}).get(column), log=column in logs))
        error, unknown = (None, []) if std_error is None else errors_of(name, table, std_error, rows)
        x, scores = np.stack(columns, 1), -y if minimise else y
        designs, said = len(np.unique(x, axis=0)), {*(kinds or {}), *(levels or {})}
        for v, values in zip(variables, columns):
            if v.name not in said and (why := name_of_rows(v, values, designs)):
                raise UserError(f"{name}: {why}")
        others, kept, strange = complete_designs(name, table, variables, rows) if planned else (None, None, [])
        made = cls(
            x, scores, tuple(variables), name, score_name(target, weights), minimise,
            Rules.of(variables, name=name, **rules), std_error=error, table_rows=rows if planned else None,
            groups=groups_of(name, table, groups, rows) if groups else None,
            unscored=others, passed=None if kept is None else kept < rows[-1],
        )  # fmt: skip
        made.repair.check_possible()
        read = [*restored, *texts_told(table, [v for v in variables if v.name in unsaid])]
        slips = [*read, *unknown, *strange, *doubts.of_inputs(variables, x, rows, bounds, made.rules), *slips]
        warn(name, slips := [*slips, *doubts.of_outcomes(variables, x, target, raw)])
        left = [each for each in ignore if each not in targets]
        changed = [*about_order(made), *about_driven_inputs(made), *([] if groups else doubts.of_ignored(table, left))]
        warn(name, changed)
        unused = [f"not used: {', '.join(left)}"] if left else []
        made = replace(made, noticed=(*noticed, *told, *slips, *changed, *unused))
        made = pooled(made) if pool else made
        warn(name, together := units_told(made, groups))
        return replace(made, noticed=(*made.noticed, *together)) if together else made

    def shown(self, scores: Any) -> Any:
        """Scores with the sign of the table: negated again if its target is minimised."""
        return -scores if self.minimise else scores

    @cached_property
    def repair(self) -> Repair:
        """The object that moves designs to the nearest ones that satisfy all rules."""
        return Repair(self)

    @cached_property
    def recipes(self) -> np.ndarray:
        """(rows,) recipe number of each row: rows of a recipe are replicates, or nearly so (`replicates.recipes`)."""
        return recipes(self)

    @cached_property
    def units(self) -> np.ndarray:
        """(rows,) number of the unit, a group or a recipe, that each row is held out with (`replicates.units`)."""
        return units(self)

    @cached_property
    def usual_distance(self) -> float:
        """The typical distance between neighbours of different recipes (`nn_distance.usual_distance`)."""
        return usual_distance(self)

    @cached_property
    def coordinates(self) -> "Coordinates":
        """The coordinates of these designs, in which methods search."""
        return Coordinates.of(self)

    def check(self, x: np.ndarray) -> None:
        """Refuses designs (rows, variables) that these variables do not allow.

        Raises:
            UserError: with row and variable.
        """
        if x.ndim != 2 or x.shape[1] != len(self.variables):
            raise UserError(f"{self.name}: designs must have shape (rows, {len(self.variables)}), got {x.shape}")
        low = np.array([0.0 if v.leveled else v.low for v in self.variables])
        high = np.array([len(v.levels) - 1.0 if v.leveled else v.high for v in self.variables])
        whole = np.array([v.kind != "continuous" for v in self.variables])
        # Float32 does not hold every bound exactly. The slack of an infinite bound would be infinite, too; that of a bound of 0
        # is a smaller share of the range.
        wide = 0.01 * np.where(np.isfinite(high - low), high - low, 0.0)
        below, above = (SLACK * np.select([end == 0, np.isfinite(end)], [wide, np.abs(end)], 0.0) for end in (low, high))
        with np.errstate(invalid="ignore"):
            good = np.isfinite(x) & (x >= low - below) & (x <= high + above) & (~whole | (x == np.round(x)))
        if not good.all():
            row, column = map(int, np.argwhere(~good)[0])
            v, value = self.variables[column], x[row, column]
            number = "a whole number" if v.kind == "integer" else "a number"
            asked = f"one of {len(v.levels)} levels" if v.leveled else f"{number} in [{v.low:g}, {v.high:g}]"
            raise UserError(f"{self.name}: {v.name} is {value:g} in row {row}, {asked} is needed")

    def part(self, rows: np.ndarray, name: str | None = None) -> "Designs":
        """The given rows of the designs, with another name if one is given."""
        kept = ("replicates", "std_error", "groups")
        some = {key: None if (of := getattr(self, key)) is None else of[rows] for key in kept}
        some["table_rows"] = self.numbered(rows)
        return replace(self, x=self.x[rows], y=self.y[rows], name=name or self.name, **some)

    def numbered(self, rows: np.ndarray) -> np.ndarray:
        """The rows of the table, counted from 0, that the given rows of the designs are from; for pooled ones the first."""
        rows = np.arange(len(self))[rows]
        return rows if self.table_rows is None else self.table_rows[rows]

    def best(self, count: int, worst: bool = False) -> np.ndarray:
        """(count,) rows with the highest scores, or the lowest, in order; repeated from the first if there are fewer."""
        order = np.argsort(self.y if worst else -self.y, kind="stable")
        return np.resize(order, count)

    def best_and_others(self, most: int, rng: np.random.Generator) -> np.ndarray:
        """(most,) rows for a fit that takes no more: half of them the best ones, half drawn from the others. If there are not
        more, all rows, the best first.

        If all these rows had the same score, from which no model learns anything, the worst ones replace those drawn.
        """
        order = self.best(len(self))
        if len(order) <= most:
            return order
        best, rest = order[: most // 2], order[most // 2 :]
        drawn = rng.choice(rest, most - len(best), replace=False)
        if np.ptp(self.y[np.append(best, drawn)]) == 0:
            drawn = rest[-len(drawn) :]
        return np.concatenate([best, drawn])

    def encode(self, frame: Any) -> np.ndarray:
        """(rows, variables) float32 designs from a table with these variables as columns.

        Raises:
            UserError: a column is missing, a value is out of bounds, or a level is not known.
        """
        table, columns = to_arrow(frame, self.name), []
        rows = np.arange(table.num_rows)
        for v in self.variables:
            check_column(table, v.name, self.name)
            if v.leveled:
                values = filled(self.name, trimmed(table, [v.name]), v.name, rows)
                columns.append(codes(self.name, v.name, values, v.levels, rows))
            else:
                columns.append(numbers_of(self.name, table, v.name, rows))
        x = np.stack(columns, 1)
        self.check(x)
        return x.astype(np.float32)

    def decode(self, x: np.ndarray) -> dict[str, list[Any]]:
        """Designs (rows, variables) as a table: {variable: values}, integers as int, and levels by name."""
        out: dict[str, list[Any]] = {}
        for v, column in zip(self.variables, np.asarray(x).T):
            if v.leveled:
                out[v.name] = [v.levels[int(i)] for i in column]
            else:
                # The shortest decimal number with the same float32: 2.7 rather than 2.700000047683716.
                shortest = lambda i: float(str(np.float32(i)))  # noqa: E731
                out[v.name] = [int(i) if v.kind == "integer" else shortest(i) for i in column]
        return out

    def write(self, path: Path | str, x: np.ndarray, more: Mapping[str, Sequence[float]] | None = None) -> Path:
        """Writes designs as CSV with the columns of the table, followed by further ones (see `csv_out`); returns the path."""
        with replacing(path) as temporary:
            write_table({**self.decode(x), **{key: list(value) for key, value in (more or {}).items()}}, temporary)
        return Path(path)


def _check_given(
    name: str, table: pa.Table, given: Mapping[str, Any], outputs: Sequence[str], groups: str | None, targets: Sequence[str]
) -> None:
    """Refuses keywords of `Designs.from_frame` about columns that the table lacks, or that are no inputs, and a table without
    rows.

    Args:
        name: of the data.
        table: the data.
        given: keywords about inputs, and `ignore`.
        outputs: the target, and other columns of the score.
        groups: the column with the groups of rows; None: there is none.
        targets: all targets for which the table is read.
    """
    grouped, ignore = [groups] if groups else [], given["ignore"]
    for column in (*outputs, *grouped, *(each for columns in given.values() for each in columns or ())):
        check_column(table, column, name)
    for what, columns in given.items():
        if both := [column for column in outputs if column in (columns or ())]:
            part = "" if both[0] == outputs[0] else " or part of it"
            raise UserError(f"{name}: {what} is of inputs, and {both[0]} is the target{part}")
        if what != "ignore" and groups in (columns or ()):
            raise UserError(f"{name}: {what} is of inputs, and {groups} holds the groups of rows")
        if what != "ignore" and (both := [column for column in columns or () if column in {*ignore} - {*targets}]):
            raise UserError(f"{name}: {what} is of inputs, and {both[0]} is ignored")
    if groups in outputs:
        raise UserError(f"{name}: {groups} cannot be the target or part of it and hold the groups of rows")
    if table.num_rows == 0:
        raise UserError(f"{name}: the table has no rows")


def _not_whole(
    name: str, inputs: Sequence[str], bounds: Mapping[str, Iterable[float]], steps: Mapping[str, float], fixed: Iterable[str]
) -> set[str]:
    """The columns of which a bound, the step or a fixed value is no whole number, so that other numbers are meant."""
    given = [(column, value) for column, ends in bounds.items() for value in ends or ()]
    given += [(column, value) for column, value in steps.items() if value is not None]
    anything = [Variable(column) for column in inputs]
    for text in fixed:
        with contextlib.suppress(UserError):  # a level, or wrong, which is told once the variables are known
            column, value = read_fixed(text, anything, name)
            given.append((inputs[column], value))
    return {column for column, value in given if not float(value).is_integer()}
