"""Scored designs: inputs x with one score y each, what every variable may be, and the coordinates that methods see."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from pyarrow import csv

from deadreckon.data.encode import category_codes, is_category, is_number, numbers, row_numbers
from deadreckon.data.frame import check_column, to_arrow
from deadreckon.errors import UserError, reading, unknown
from deadreckon.files import replacing

KINDS = ("continuous", "integer", "categorical")
FEWEST = 10  # rows below which no model is worth fitting
FINE = 1e-3  # deviations of a column that float32 must be able to tell apart


@dataclass(frozen=True)
class Variable:
    """What one input may be.

    Attributes:
        name: column's.
        kind: among `KINDS`.
        low, high: bounds, included; of a categorical variable they say nothing.
        levels: of a categorical variable; a design holds their indices.
    """

    name: str
    kind: Literal["continuous", "integer", "categorical"] = "continuous"
    low: float = -math.inf
    high: float = math.inf
    levels: tuple[Any, ...] = ()

    def __post_init__(self):
        if self.kind not in KINDS:
            raise UserError(f"{self.name}: {unknown('kind', self.kind, KINDS)}")
        if self.kind == "categorical" and not self.levels:
            raise UserError(f"{self.name}: a categorical variable needs its levels")
        if not self.low <= self.high:
            raise UserError(f"{self.name}: bounds must satisfy low <= high, got {self.low:g} and {self.high:g}")


@dataclass(frozen=True, eq=False)
class Designs:
    """Immutable designs and their scores.

    Attributes:
        x: (rows, variables) float32; of a categorical variable the index of its level.
        y: (rows,) float64, what is to be made large.
        variables: one a column of `x`.
        name: of the data, used in errors and tables.
        target: name of the score.
        minimise: whether the score was turned around: `y` is then minus what the table held.
    """

    x: np.ndarray
    y: np.ndarray
    variables: tuple[Variable, ...]
    name: str = "designs"
    target: str = "y"
    minimise: bool = False

    def __post_init__(self):
        object.__setattr__(self, "x", np.asarray(self.x, np.float32))
        object.__setattr__(self, "y", np.asarray(self.y, np.float64))
        if self.x.ndim != 2 or self.x.shape != (len(self.y), len(self.variables)):
            asked = f"({len(self.y)}, {len(self.variables)}), a row a score and a column per variable"
            raise UserError(f"{self.name}: x must have shape {asked}, got {self.x.shape}")
        self.check(self.x)
        if not np.isfinite(self.y).all():
            raise UserError(f"{self.name}: {self.target} is not finite in row {int(np.argmin(np.isfinite(self.y)))}")
        if len(self.y) < FEWEST:
            raise UserError(f"{self.name}: {len(self.y)} rows are too few to learn from, {FEWEST} or more are needed")
        if np.ptp(self.y) == 0:
            only = float(self.shown(self.y)[0])
            raise UserError(f"{self.name}: {self.target} is {only:g} in all rows, so nothing tells good from bad")
        if not np.ptp(self.x, axis=0).any():
            raise UserError(f"{self.name}: all designs are the same, so nothing tells what to change")
        self.x.flags.writeable = self.y.flags.writeable = False

    def __len__(self) -> int:
        return len(self.y)

    @classmethod
    def from_arrays(
        cls, x: np.ndarray, y: np.ndarray, variables: Sequence[Variable] | None = None, *, name: str = "designs"
    ) -> "Designs":
        """Designs of arrays; without `variables` all are continuous and without bounds."""
        x = np.asarray(x)
        if variables is None:
            variables = [Variable(f"x{i}") for i in range(x.shape[1] if x.ndim == 2 else 0)]
        return cls(np.array(x, np.float32), np.array(y, np.float64), tuple(variables), name)

    @classmethod
    def from_csv(cls, path: Path | str, target: str, **options: Any) -> "Designs":
        """Designs of a CSV file with a line of names, separated by commas, semicolons or tabs; options as for `from_frame`."""
        with reading(path, "CSV", pa.ArrowException):
            separator, point = _dialect(Path(path))
            # An empty cell is none, also of texts; what else cannot be read as a number is told with its row.
            convert = csv.ConvertOptions(strings_can_be_null=True, null_values=[""], decimal_point=point)
            table = csv.read_csv(path, parse_options=csv.ParseOptions(delimiter=separator), convert_options=convert)
        options.setdefault("name", Path(path).stem)
        return cls.from_frame(table, target, **options)

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
    ) -> "Designs":
        """Designs of a table, a row each.

        Args:
            frame: a pandas, polars or pyarrow table, or a mapping of column names to values.
            target: the column to make large.
            kinds: among `KINDS` by column. Otherwise texts, categories and truth values are categorical, whole numbers
                integer, and all else continuous. Row numbers that a table library wrote, without a name, are left out.
            bounds: lowest and highest value by column, both allowed. Otherwise those of the data: nothing beyond what has been
                seen is proposed unless one says that it exists.
            levels: all levels of a categorical column, where the data lacks some.
            ignore: columns that are no inputs.
            minimise: make the target small instead.
            name: of the data, used in errors.

        Raises:
            UserError: one line with column and row.
        """
        table = to_arrow(frame, name)
        for column in (target, *(kinds or {}), *(bounds or {}), *(levels or {}), *ignore):
            check_column(table, column, name)
        for what, given in (("kinds", kinds), ("bounds", bounds), ("levels", levels), ("ignore", ignore)):
            if target in (given or ()):
                raise UserError(f"{name}: {what} is of inputs, and {target} is the target")
        if table.num_rows == 0:
            raise UserError(f"{name}: the table has no rows")
        y = numbers(name, table, target)
        inputs = [column for column in table.column_names if column != target and column not in ignore]
        if index := row_numbers(inputs):
            warnings.warn(f"{name}: column {index[0]!r} looks like a row number and is left out", stacklevel=2)
            inputs = [column for column in inputs if column not in index]
        if not inputs:
            raise UserError(f"{name}: there is no column beside the target {target!r}")
        columns, variables = [], []
        for column in inputs:
            values, variable = _variable(
                name, table, column, (kinds or {}).get(column), (bounds or {}).get(column), (levels or {}).get(column)
            )
            columns.append(values)
            variables.append(variable)
        return cls(np.stack(columns, 1).astype(np.float32), -y if minimise else y, tuple(variables), name, target, minimise)

    def shown(self, scores: Any) -> Any:
        """Scores as the table has them: turned around again where its target was to be made small."""
        return -scores if self.minimise else scores

    @cached_property
    def coordinates(self) -> "Coordinates":
        """How methods see these designs."""
        return Coordinates.of(self)

    def check(self, x: np.ndarray) -> None:
        """Refuses designs (rows, variables) that these variables do not allow.

        Raises:
            UserError: with row and variable.
        """
        if x.ndim != 2 or x.shape[1] != len(self.variables):
            raise UserError(f"{self.name}: designs must have shape (rows, {len(self.variables)}), got {x.shape}")
        low = np.array([0.0 if v.kind == "categorical" else v.low for v in self.variables])
        high = np.array([len(v.levels) - 1.0 if v.kind == "categorical" else v.high for v in self.variables])
        whole = np.array([v.kind != "continuous" for v in self.variables])
        slack = 1e-6 * np.maximum(1.0, np.abs(x))  # float32 does not hold every bound exactly
        with np.errstate(invalid="ignore"):
            good = np.isfinite(x) & (x >= low - slack) & (x <= high + slack) & (~whole | (x == np.round(x)))
        if not good.all():
            row, column = map(int, np.argwhere(~good)[0])
            v, value = self.variables[column], x[row, column]
            number = "a whole number" if v.kind == "integer" else "a number"
            asked = f"one of {len(v.levels)} levels" if v.kind == "categorical" else f"{number} in [{v.low:g}, {v.high:g}]"
            raise UserError(f"{self.name}: {v.name} is {value:g} in row {row}, {asked} is needed")

    def part(self, rows: np.ndarray, name: str | None = None) -> "Designs":
        """Some of the designs, under another name if one is given."""
        return replace(self, x=self.x[rows], y=self.y[rows], name=name or self.name)

    def best(self, count: int, worst: bool = False) -> np.ndarray:
        """(count,) rows with the highest scores, or the lowest; over again from the first where there are fewer."""
        order = np.argsort(self.y if worst else -self.y, kind="stable")
        return np.resize(order, count)

    def encode(self, frame: Any) -> np.ndarray:
        """(rows, variables) of a table with these variables as columns.

        Raises:
            UserError: a column is missing, a value is out of bounds, or a level is not known.
        """
        table = to_arrow(frame, self.name)
        columns = []
        for v in self.variables:
            check_column(table, v.name, self.name)
            if v.kind == "categorical":
                columns.append(_codes(self.name, table, v.name, v.levels))
            else:
                columns.append(numbers(self.name, table, v.name))
        x = np.stack(columns, 1)
        self.check(x)
        return x.astype(np.float32)

    def decode(self, x: np.ndarray) -> dict[str, list[Any]]:
        """A table of designs (rows, variables): names to values, whole numbers as such, levels by name."""
        out: dict[str, list[Any]] = {}
        for v, column in zip(self.variables, np.asarray(x).T):
            if v.kind == "categorical":
                out[v.name] = [v.levels[int(i)] for i in column]
            else:
                # The shortest number that float32 cannot tell from it: 2.7 rather than 2.700000047683716.
                shortest = lambda i: float(str(np.float32(i)))  # noqa: E731
                out[v.name] = [int(i) if v.kind == "integer" else shortest(i) for i in column]
        return out

    def write(self, path: Path | str, x: np.ndarray, more: Mapping[str, Sequence[float]] | None = None) -> Path:
        """Writes designs as rows of the same table, with more columns behind; CSV."""
        with replacing(path) as temporary:
            csv.write_csv(pa.table({**self.decode(x), **{key: list(value) for key, value in (more or {}).items()}}), temporary)
        return Path(path)


def _variable(
    name: str, table: pa.Table, column: str, kind: str | None, bounds: tuple[float, float] | None, levels: Any
) -> tuple[np.ndarray, Variable]:
    """A column's numbers, and what it may be."""
    stored, given = table.column(column).type, kind
    if pa.types.is_temporal(stored):
        raise UserError(f"{name}: column {column} holds times; make numbers of them, or ignore the column")
    if kind is None:
        kind = "categorical" if is_category(stored) or levels else "integer" if pa.types.is_integer(stored) else "continuous"
    if kind not in KINDS:
        raise UserError(f"{name}: column {column}: {unknown('kind', kind, KINDS)}")
    if kind == "categorical":
        if bounds is not None:
            raise UserError(f"{name}: column {column} is categorical and has levels, not bounds")
        if given is None and not levels:
            _not_numbers(name, table, column)
        known = _typed(levels, stored) if levels else _levels(name, table, column)
        if given is None and not levels and len(known) == table.num_rows >= FEWEST:
            raise UserError(
                f"{name}: column {column} holds another text in every row, from which nothing is learned; ignore it, or say "
                "kind categorical"
            )
        return _codes(name, table, column, known), Variable(column, "categorical", levels=known)
    values = numbers(name, table, column)
    low, high = bounds if bounds is not None else (values.min(), values.max())
    if not low <= high:
        raise UserError(f"{name}: column {column}: bounds must be low and high, got {low:g} and {high:g}")
    if kind == "integer" and bounds is not None and (low != np.ceil(low) or high != np.floor(high)):
        raise UserError(f"{name}: column {column} holds whole numbers, its bounds must be whole too, got {low:g} and {high:g}")
    if kind == "integer" and max(abs(low), abs(high)) > 2**24:
        raise UserError(
            f"{name}: column {column} reaches beyond 16,777,216, where 32 bits do not hold every whole number; "
            f"take a constant off it, or ignore it"
        )
    if kind == "integer" and (values != np.round(values)).any():
        row = int(np.argmax(values != np.round(values)))
        raise UserError(f"{name}: column {column} has {values[row]:g} in row {row}, whole numbers are needed")
    spread, fineness = values.std(), float(np.spacing(np.float32(np.abs(values).max())))
    if kind == "continuous" and fineness > FINE * spread > 0:
        raise UserError(
            f"{name}: column {column} reaches {np.abs(values).max():g} with a deviation of {spread:.3g}, which 32 bits hold in "
            f"steps of {fineness:g} only; take a constant off it, or ignore it"
        )
    outside = (values < low) | (values > high)
    if outside.any():
        row = int(np.argmax(outside))
        raise UserError(f"{name}: column {column} has {values[row]:g} in row {row}, outside the bounds [{low:g}, {high:g}]")
    return values, Variable(column, kind, float(low), float(high))  # type: ignore[arg-type]


def _dialect(path: Path) -> tuple[str, str]:
    """What separates a file's columns, by its first line, and the point of its numbers.

    Raises:
        UserError: its text is not UTF-8.
    """
    with pa.input_stream(path) as file:  # which unpacks what is compressed, as the reader does
        head = file.read(65_536)
    if len(head) == 65_536:
        head = head[: head.rfind(b"\n") + 1] or head  # a letter may have been cut in two
    try:
        first, _, rest = head.decode().partition("\n")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: its text is not UTF-8 ({error.reason} at byte {error.start}); save it as such") from error
    separator = max(",;\t", key=first.count)  # of none, the comma
    return separator, "," if separator != "," and "," in rest and "." not in rest else "."


def _typed(levels: Sequence[Any], stored: pa.DataType) -> tuple[Any, ...]:
    """Levels that came as texts, as a column of other values holds them."""
    truths = {"true": True, "false": False}

    def typed(level: Any) -> Any:
        if not isinstance(level, str):
            return level
        if pa.types.is_boolean(stored):
            return truths.get(level.lower(), level)
        if not (pa.types.is_integer(stored) or pa.types.is_floating(stored)) or not is_number(level):
            return level
        return int(level) if level.strip().lstrip("-").isdigit() else float(level)

    return tuple(map(typed, levels))


def _not_numbers(name: str, table: pa.Table, column: str) -> None:
    """Refuses texts that are numbers in most rows: one bad cell would make a category of each."""
    if not pa.types.is_string(table.column(column).type):
        return
    values = _texts(name, table, column)
    bad = [row for row, value in enumerate(values) if not is_number(value)]
    if bad and len(bad) < len(values) / 2:
        row = bad[0]
        raise UserError(
            f"{name}: column {column} holds {values[row]!r} in row {row}, where most rows hold numbers; "
            "mend it, or say kind categorical"
        )


def _texts(name: str, table: pa.Table, column: str) -> list[Any]:
    values = table.column(column).to_pylist()
    for row, value in enumerate(values):
        if value is None or (isinstance(value, float) and math.isnan(value)):
            raise UserError(f"{name}: column {column} is empty in row {row}")
    return values


def _levels(name: str, table: pa.Table, column: str) -> tuple[Any, ...]:
    if is_category(table.column(column).type) and not pa.types.is_boolean(table.column(column).type):
        _texts(name, table, column)
        return tuple(category_codes(name, column, table.column(column).combine_chunks())[1])
    return tuple(sorted(set(_texts(name, table, column))))


def _codes(name: str, table: pa.Table, column: str, levels: Sequence[Any]) -> np.ndarray:
    index = {level: i for i, level in enumerate(levels)}
    out = []
    for row, value in enumerate(_texts(name, table, column)):
        if value not in index:
            shown = ", ".join(map(str, levels[:8])) + (", ..." if len(levels) > 8 else "")
            raise UserError(f"{name}: column {column} has the unknown level {value!r} in row {row}; known are {shown}")
        out.append(index[value])
    return np.array(out, np.float64)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Numbers that methods search in, of mean 0 and deviation 1, and back.

    A categorical variable of V levels is V - 1 logits, as in Design-Bench: those of 0.6 one-hot + 0.4 uniform, less that of the
    first level, which is then zero and left out; on a scale where they are -1, 0 or 1. The level with the highest is chosen.

    Attributes:
        numeric: (n,) columns of the designs that are numbers.
        mean, std: (n,) of these.
        groups: columns with equally many levels, and how many.
        low, high: (size,) bounds of the coordinates; infinite where there are none.
        y_mean, y_std: of the scores, which methods see standardised too.
    """

    designs: Designs
    numeric: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    groups: tuple[tuple[np.ndarray, int], ...]
    low: np.ndarray
    high: np.ndarray
    y_mean: float
    y_std: float

    @classmethod
    def of(cls, designs: Designs) -> "Coordinates":
        """Of these designs' variables and statistics."""
        kinds = [v.kind for v in designs.variables]
        numeric = np.array([i for i, kind in enumerate(kinds) if kind != "categorical"], int)
        counts = sorted({len(v.levels) for v in designs.variables if v.kind == "categorical"})
        groups = tuple(
            (np.array([i for i, v in enumerate(designs.variables) if v.kind == "categorical" and len(v.levels) == n]), n)
            for n in counts
        )
        part = designs.x[:, numeric].astype(np.float64)
        mean, std = part.mean(0), part.std(0)
        std = np.where(std > 0, std, 1.0)
        bounds = np.array([(designs.variables[i].low, designs.variables[i].high) for i in numeric]).reshape(-1, 2)
        free = np.full(sum(len(columns) * (n - 1) for columns, n in groups), np.inf)
        low, high = (np.concatenate([(b - mean) / std, s * free]) for b, s in ((bounds[:, 0], -1), (bounds[:, 1], 1)))
        worth = float(designs.y.mean()), float(designs.y.std())
        return cls(designs, numeric, mean, std, groups, low.astype(np.float32), high.astype(np.float32), *worth)

    @property
    def size(self) -> int:
        """Coordinates a design."""
        return len(self.low)

    @property
    def discrete(self) -> bool:
        """Whether most variables are categories."""
        return len(self.numeric) < len(self.designs.variables) / 2

    def encode(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) designs as (rows, size) float32 coordinates."""
        x = np.asarray(x)
        parts = [(x[:, self.numeric] - self.mean) / self.std]
        for columns, n in self.groups:
            index = x[:, columns].astype(int)
            logits = (index[..., None] == np.arange(n)).astype(np.float64)
            parts.append((logits[..., 1:] - logits[..., :1]).reshape(len(x), -1))
        return np.concatenate(parts, 1).astype(np.float32)

    def decode(self, z: np.ndarray) -> np.ndarray:
        """(rows, size) coordinates as (rows, variables) designs, within bounds, whole numbers rounded."""
        z = np.asarray(z, np.float64)
        out = np.empty((len(z), len(self.designs.variables)))
        count = len(self.numeric)
        variables = [self.designs.variables[i] for i in self.numeric]
        value = z[:, :count] * self.std + self.mean
        whole = np.array([v.kind == "integer" for v in variables], bool)
        value = np.where(whole, np.round(value), value)
        out[:, self.numeric] = value.clip([v.low for v in variables], [v.high for v in variables]) if count else value
        for columns, n in self.groups:
            logits = z[:, count : count + len(columns) * (n - 1)].reshape(len(z), len(columns), n - 1)
            count += len(columns) * (n - 1)
            out[:, columns] = np.concatenate([np.zeros((*logits.shape[:2], 1)), logits], -1).argmax(-1)
        return out.astype(np.float32)

    def score(self, y: np.ndarray) -> np.ndarray:
        """Standardised scores as scores."""
        return self.y_mean + self.y_std * np.asarray(y, np.float64)
