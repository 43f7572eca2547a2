"""Columns of a table as numbers: levels for texts, means and indicators for what is missing."""

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute

from deadreckon.data.likeness import refuse_mistaken
from deadreckon.errors import UserError

_compute: Any = pyarrow.compute  # its functions are made at run time, so type checkers do not know them
_MOST_LEVELS = 1_000  # a text column with more distinct values is an identifier, not a category
_SPARSE = 4  # integers that leave more than 3 of 4 values unused are identifiers, and numbered anew


class Encoder:
    """Encodes columns of `table`, and keeps what should be told about it.

    Attributes:
        name: of the log, used in errors.
        table: the table.
        warnings: one line each.
        extra: for the provenance: names of the observation's dimensions, levels of categories.
    """

    def __init__(self, name: str, table: pa.Table):
        self.name = name
        self.table = table
        self.warnings: list[str] = []
        self.extra: dict[str, Any] = {}

    def observations(self, names: list[str]) -> np.ndarray:
        """(rows, size) float32 of the columns `names`; what each dimension is goes to `extra`.

        Raises:
            UserError: a column cannot be encoded.
        """
        columns: dict[str, np.ndarray] = {}
        levels: dict[str, list[Any]] = {}
        missing: dict[str, int] = {}
        rows = np.zeros(self.table.num_rows, bool)  # with something missing

        def add(key: str, values: np.ndarray) -> None:
            if key in columns:
                raise UserError(f"{self.name}: two dimensions of the observation are called {key}; rename that column")
            columns[key] = values

        for column in names:
            values = _flat(self.table, column)
            if is_category(values.type):
                refuse_mistaken(self.name, column, values)
                codes, found = category_codes(self.name, column, values)
                levels[column] = found
                for code, level in enumerate(found):
                    add(f"{column}={level}", codes == code)
                absent = codes < 0
            else:
                number, absent = _numbers(self.name, column, values)
                if absent.all():
                    raise UserError(f"{self.name}: column {column} is empty; leave it out of the observations")
                # In float64, so that the mean of large numbers is not lost.
                add(column, np.where(absent, number[~absent].mean(), number) if absent.any() else number)
            if absent.any():
                add(f"{column}_missing", absent)
                rows |= absent
                missing[column] = int(absent.sum())
        if missing:
            counts = ", ".join(f"{column} {count}" for column, count in missing.items())
            where = f"missing values in {rows.sum()} of {len(rows)} rows"
            self.warnings.append(f"{where} are replaced by the mean or by no level, and marked: {counts}")
        out = np.empty((self.table.num_rows, len(columns)), np.float32)
        with np.errstate(over="ignore"):
            for index, (key, column) in enumerate(columns.items()):
                out[:, index] = column
                if not np.isfinite(out[:, index]).all():
                    row = int(np.argmin(np.isfinite(out[:, index])))
                    raise UserError(f"{self.name}: column {key} has {column[row]} in row {row}, float32 cannot hold it")
        self.extra["observation_names"] = list(columns)
        if levels:
            self.extra["observation_levels"] = levels
        return out

    def actions(self, names: list[str]) -> np.ndarray:
        """(rows,) integers for one column of integers or categories, (rows, size) floats otherwise.

        Raises:
            UserError: no column, or one that cannot be encoded.
        """
        if not names:
            raise UserError(f"{self.name}: no action column is named")
        if len(names) > 1:
            return np.stack([numbers(self.name, self.table, column) for column in names], 1)
        (column,) = names
        values = self.complete(column)
        if is_category(values.type):
            refuse_mistaken(self.name, column, values)
            codes, levels = category_codes(self.name, column, values)
            self.extra["action_levels"] = levels
            return codes
        if not pa.types.is_integer(values.type):
            return numbers(self.name, self.table, column)[:, None]
        codes = values.to_numpy(zero_copy_only=False)
        levels, index = np.unique(codes, return_inverse=True)
        if levels[0] >= 0 and levels[-1] < _SPARSE * len(levels):
            return codes
        self.extra["action_levels"] = levels.tolist()
        text = f"actions are {len(levels)} integers from {levels[0]} to {levels[-1]}"
        self.warnings.append(f"{text}; they are numbered 0 .. {len(levels) - 1}")
        return index

    def kept(self, column: str) -> np.ndarray:
        """(rows,) of a column that is no observation: numbers as they are; texts, categories and times as int64 codes, whose
        levels go to `extra` where they are not very many.

        Raises:
            UserError: a value is missing, or the column holds something else.
        """
        values = self.complete(column)
        if pa.types.is_temporal(values.type):
            values = values.cast(pa.string())
        if not is_category(values.type):
            return numbers(self.name, self.table, column) if not pa.types.is_integer(values.type) else values.to_numpy()
        codes, levels = category_codes(self.name, column, values, most=None)
        if len(levels) <= _MOST_LEVELS:
            self.extra.setdefault("kept_levels", {})[column] = levels
        return codes

    def episodes(self, column: str, ordered: bool) -> np.ndarray:
        """(rows,) int64 index of each row's episode: of its value among those of the column, in the order in which they first
        appear or, if `ordered`, ascending."""
        values = self.complete(column)
        if isinstance(values, pa.DictionaryArray):
            values = values.dictionary_decode()
        encoded = values.dictionary_encode()
        codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        if not ordered:
            return codes
        ranks = np.empty(len(encoded.dictionary), np.int64)
        ranks[_sorted_indices(encoded.dictionary)] = np.arange(len(ranks))
        return ranks[codes]

    def moments(self, column: str) -> np.ndarray:
        """(rows,) numbers in the order of time: float64 or, of dates, int64."""
        values = self.complete(column)
        if pa.types.is_temporal(values.type):
            # Only the order matters; int64 counts of the type's own unit keep it exactly.
            width = pa.int32() if values.type.bit_width == 32 else pa.int64()
            return np.asarray(values.view(width).to_numpy(zero_copy_only=False), np.int64)
        return numbers(self.name, self.table, column)

    def complete(self, column: str) -> Any:
        """The column as one pyarrow array, refused if a value is missing."""
        values = _flat(self.table, column)
        absent = values.is_null(nan_is_null=True).to_numpy(zero_copy_only=False)
        if absent.any():
            raise UserError(f"{self.name}: column {column} is empty in row {int(np.argmax(absent))}")
        if pa.types.is_nested(values.type):
            raise UserError(f"{self.name}: column {column} holds {values.type}, one plain value a row is needed")
        return values


def numbers(name: str, table: pa.Table, column: str) -> np.ndarray:
    """(rows,) float64 of a column that must be complete, finite numbers or truth values.

    Raises:
        UserError: it is not, with the row.
    """
    values, absent = _numbers(name, column, _flat(table, column))
    wrong = absent | ~np.isfinite(values)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"{name}: column {column} {'is empty' if absent[row] else f'has {values[row]}'} in row {row}")
    return values


def flags(name: str, table: pa.Table, column: str) -> np.ndarray:
    """(rows,) bool of a column of truth values, or of 0 and 1."""
    values = numbers(name, table, column)
    _refuse(name, column, values, (values != 0) & (values != 1), "0 or 1")
    return values != 0


def log_probabilities(name: str, table: pa.Table, column: str) -> np.ndarray:
    """(rows,) logarithms of a column of probabilities in (0, 1]."""
    values = numbers(name, table, column)
    _refuse(name, column, values, (values <= 0) | (values > 1), "a probability in (0, 1]")
    return np.log(values).astype(np.float32)


def _refuse(name: str, column: str, values: np.ndarray, wrong: np.ndarray, needed: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"{name}: column {column} has {values[row]:g} in row {row}, {needed} is needed")


def is_category(kind: pa.DataType) -> bool:
    """Whether a column's values are levels: texts, categories, truth values."""
    texts = (pa.types.is_string, pa.types.is_large_string)
    return pa.types.is_dictionary(kind) or pa.types.is_boolean(kind) or any(test(kind) for test in texts)


def category_codes(name: str, column: str, values: Any, most: int | None = _MOST_LEVELS) -> tuple[np.ndarray, list[Any]]:
    """(rows,) int64 index of each value's level, -1 where it is missing, and the levels that occur, sorted; `most` of them."""
    if isinstance(values, pa.DictionaryArray):
        values = values.dictionary_decode()
    if pa.types.is_boolean(values.type):
        values = values.cast(pa.string())
    encoded = values.dictionary_encode()
    if most is not None and len(encoded.dictionary) > most:
        text = f"column {column} has {len(encoded.dictionary)} distinct values, at most {most} are encoded"
        raise UserError(f"{name}: {text}; leave it out")
    codes = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
    order = _sorted_indices(encoded.dictionary)
    ranks = np.append(np.empty(len(order), np.int64), -1)
    ranks[order] = np.arange(len(order))
    return ranks[codes], [encoded.dictionary[int(index)].as_py() for index in order]


def _sorted_indices(values: Any) -> np.ndarray:
    """The positions of a pyarrow array's values in ascending order."""
    return _compute.sort_indices(values).to_numpy()


def _flat(table: pa.Table, column: str) -> Any:
    values = table.column(column)
    if pa.types.is_dictionary(values.type):
        values = values.unify_dictionaries()
    elif pa.types.is_string_view(values.type):  # polars'; pyarrow cannot sort them yet
        values = values.cast(pa.large_string())
    return values.combine_chunks() if values.num_chunks != 1 else values.chunk(0)


def _first_text(values: Any) -> str:
    """Which cell keeps a column of texts from being numbers; nothing for another kind of column."""
    for row, value in enumerate(values.to_pylist() if is_category(values.type) else ()):
        if isinstance(value, str) and not is_number(value):
            return f"; row {row} has {value!r}"
    return ""


def is_number(text: str) -> bool:
    """Whether a text says a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(name: str, column: str, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """(rows,) float64 and (rows,) bool where a value is missing."""
    kind = values.type
    if pa.types.is_boolean(kind):
        values = values.cast(pa.int8())
    elif pa.types.is_decimal(kind):
        values = values.cast(pa.float64())
    elif pa.types.is_null(kind):
        return np.full(len(values), np.nan), np.ones(len(values), bool)
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        hint = "; give it as time, or leave it out" if pa.types.is_temporal(kind) else _first_text(values)
        raise UserError(f"{name}: column {column} holds {kind}, numbers are needed{hint}")
    out = values.to_numpy(zero_copy_only=False).astype(np.float64)
    return out, np.isnan(out)
