"""Encodes columns of a table as numbers by a schema: levels for texts, means and indicators for missing values."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import (
    MOST_LEVELS,
    as_dates,
    category_codes,
    codes_of,
    compute,
    decoded,
    first_text,
    flags,
    flat,
    is_category,
    is_missing,
    is_text,
    levels_of_whole_numbers,
    numbers,
    ordered_moments,
    some_numbers,
    sorted_indices,
)
from deadreckon.data.formats.cells import truths
from deadreckon.data.likeness import refuse_mistaken
from deadreckon.data.schema import Column
from deadreckon.data.scratch import BLOCK, Scratch
from deadreckon.errors import UserError
from deadreckon.names import natural

OTHERS = "other_levels"  # the entry of `Provenance.extra`: values that are none of a column's levels, by column
_ACTIONS = 8  # most actions whose shares of empty rewards are told
_SHOWN, _KEPT = 5, 50  # unknown levels named in a message, and kept in `extra`
_NATURAL = 100_000  # names of episodes that are put in the order of the numbers in them; of more it would take long


class Encoder:
    """Encodes columns of `table`, and keeps messages about it.

    Attributes:
        name: of the log, used in errors.
        table: the table.
        scratch: where columns are kept that have as many rows as the table.
        warnings: one line each.
        extra: for the provenance: names of the observation's dimensions, levels of categories, and values that are no levels.
        resolved: columns as they were encoded, with their levels and what stands for missing values.
    """

    def __init__(self, name: str, table: pa.Table, scratch: Scratch):
        self.name = name
        self.table = table
        self.scratch = scratch
        self.warnings: list[str] = []
        self.extra: dict[str, Any] = {}
        self.resolved: dict[str, Column] = {}

    def observations(self, columns: Sequence[Column]) -> np.ndarray:
        """(rows, size) float32 of these columns; what each dimension is goes to `extra`.

        Raises:
            UserError: a column cannot be encoded.
        """
        parts: dict[str, np.ndarray] = {}
        levels: dict[str, list[Any]] = {}
        missing: dict[str, int] = {}
        rows = np.zeros(self.table.num_rows, bool)  # with something missing
        for column in columns:
            found, absent, column = self._observed(column)
            if column.kind == "category":
                levels[column.name] = list(column.levels or ())
            marked = absent.any() if column.marked is None else column.marked
            if marked:
                found[f"{column.name}_missing"] = absent
            elif absent.any():
                row = int(np.argmax(absent))
                raise UserError(f"{self.name}: column {column.name} is empty in row {row}, which the schema does not mark")
            self.resolved[column.name] = replace(column, marked=bool(marked))
            for key in found:
                if key in parts:
                    raise UserError(f"{self.name}: two dimensions of the observation are called {key}; rename that column")
            parts |= self._narrow(found)
            rows |= absent
            missing |= {column.name: int(absent.sum())} if absent.any() else {}
        if missing:
            counts = ", ".join(f"{column} {count}" for column, count in missing.items())
            where = f"{sum(missing.values())} missing values in {rows.sum()} of {len(rows)} rows"
            how = "replaced by the column's fill (the mean by default) or by no level"
            self.warnings.append(f"{where} are {how}, and marked: {counts}")
        self.extra["observation_names"] = list(parts)
        if levels:
            self.extra["observation_levels"] = levels
        return self._joined(parts)

    def next_observations(self, columns: Sequence[Column], observed: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """(rows, size) float32 of next observations, encoded as the observations, and (rows,) bool where they are missing.

        Args:
            columns: the next observations, with `of`.
            observed: the observations, which `observations` has encoded.

        Raises:
            UserError: a column cannot be encoded alike.
        """
        by = {column.of: column.name for column in columns}
        unknown = np.ones(self.table.num_rows, bool)  # all of a row is missing
        for column in columns:
            unknown &= is_missing(flat(self.table, column.name))
        parts: dict[str, np.ndarray] = {}
        for column in observed:
            like = self.resolved[column.name]
            source = by.get(column.name)
            if source is None:
                raise UserError(f"{self.name}: observation {column.name} has no next observation; name it, or leave both out")
            found, absent, _ = self._observed(replace(like, name=source))
            if like.marked:
                found[f"{source}_missing"] = absent
            elif (absent & ~unknown).any():
                row = int(np.argmax(absent & ~unknown))
                raise UserError(f"{self.name}: column {source} is empty in row {row}, whose other next observations are known")
            parts |= self._narrow(found)
        for column in columns:
            self.resolved[column.name] = column
        return self._joined(parts), unknown

    def _observed(self, column: Column) -> tuple[dict[str, np.ndarray], np.ndarray, Column]:
        """The numbers of a column by the names of their dimensions, (rows,) bool where it is missing, and it resolved."""
        name = column.name
        values = flat(self.table, name)
        if column.kind == "category":
            codes, column = self._codes(column, values)
            found = {f"{name}={level}": codes == code for code, level in enumerate(column.levels or ())}
            return found, is_missing(values), column
        number, absent = some_numbers(self.name, name, values)
        if column.kind == "flag" and not np.isin(number[~absent], (0, 1)).all():
            row = int(np.argmax(~absent & ~np.isin(number, (0, 1))))
            raise UserError(f"{self.name}: column {name} has {number[row]:g} in row {row}, a flag is 0 or 1")
        if column.kind == "integer" and (broken := ~absent & (number != np.floor(number))).any():
            row = int(np.argmax(broken))
            self.warnings.append(f"column {name} is of kind integer and has {number[row]:g} in row {row}, which is not rounded")
        if column.fill is None and absent.all():
            raise UserError(f"{self.name}: column {name} is empty; leave it out of the observations")
        if absent.any():
            if column.fill is None:
                # In float64, so that the mean of large numbers is not lost.
                column = replace(column, fill=float(number[~absent].mean()))
            number[absent] = column.fill
        self._in_range(column, number)
        return {name: number}, absent, column

    def _in_range(self, column: Column, number: np.ndarray) -> None:
        """Tells how many values lie outside the range that the schema has."""
        low, high = (-np.inf if column.low is None else column.low), (np.inf if column.high is None else column.high)
        if outside := int(((number < low) | (number > high)).sum()):
            row = int(np.argmax((number < low) | (number > high)))
            text = f"column {column.name} is outside {low:g} .. {high:g} in {outside:,} rows"
            self.warnings.append(f"{text}, first {number[row]:g} in row {row}")

    def _codes(self, column: Column, values: Any) -> tuple[np.ndarray, Column]:
        """(rows,) code of each value's level, -1 where there is none, and the column with its levels."""
        if not is_category(values.type):  # whole numbers that are codes
            if pa.types.is_floating(values.type):
                values = compute.if_else(compute.is_nan(values), None, values)
            found = levels_of_whole_numbers(values.drop_null())
            if found is None:
                text = f"column {column.name} holds {values.type}, a category needs whole numbers or texts"
                raise UserError(f"{self.name}: {text}")
            if found and not -(2**63) <= found[0] <= found[-1] < 2**63:
                text = "a category needs whole numbers below 2 ** 63, or texts: put a letter before its codes"
                raise UserError(f"{self.name}: column {column.name} holds {max(found, key=abs)}, {text}")
            values = values.cast(pa.int64())
        if column.levels is None:
            refuse_mistaken(self.name, column.name, values)
            codes, levels = category_codes(self.name, column.name, values)
            return codes, replace(column, levels=tuple(levels))
        levels = column.levels if column.kind != "flag" else truths(column.levels, pa.types.is_integer(values.type))
        codes, other = codes_of(self.name, column.name, values, levels)
        if other:
            shown = ", ".join(map(repr, other[:_SHOWN])) + (", ..." if len(other) > _SHOWN else "")
            text = f"{self.name}: column {column.name} has values that are none of its levels: {shown}"
            if column.role == "action":
                raise UserError(f"{text}; rename them, or add them to its levels")
            self.warnings.append(f"{text.partition(': ')[2]}; they become no level")
            self.extra.setdefault(OTHERS, {})[column.name] = [str(level) for level in other[:_KEPT]]
        return codes, column

    def _narrow(self, parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The same numbers as float32, which is refused where it cannot hold them; flags stay as they are."""
        out = {}
        for key, column in parts.items():
            with np.errstate(over="ignore"):
                small = column if column.dtype == bool else column.astype(np.float32)
            if not (finite := np.isfinite(small)).all():
                row = int(np.argmin(finite))
                raise UserError(f"{self.name}: column {key} has {column[row]} in row {row}, float32 cannot hold it")
            out[key] = self.scratch.keep(small)
        return out

    def _joined(self, parts: dict[str, np.ndarray]) -> np.ndarray:
        """(rows, size) float32 of what `_narrow` gave."""
        out = self.scratch.empty((self.table.num_rows, len(parts)), np.float32)
        for start in range(0, len(out), BLOCK):
            for index, column in enumerate(parts.values()):
                out[start : start + BLOCK, index] = column[start : start + BLOCK]
        return out

    def actions(self, columns: Sequence[Column]) -> np.ndarray:
        """(rows,) integers for one discrete column, (rows, size) floats otherwise.

        Raises:
            UserError: a column cannot be encoded, or several of which one is discrete.
        """
        for column in columns:
            self.resolved[column.name] = column
        if len(columns) > 1 or columns[0].kind == "number":
            for column in columns:
                if column.kind != "number" and len(columns) > 1:
                    raise UserError(
                        f"{self.name}: column {column.name} is discrete ({column.kind}) and one of several actions; "
                        "join them into one column, leave it out, or make it a number"
                    )
            out = self.scratch.empty((self.table.num_rows, len(columns)), np.float64)
            for index, column in enumerate(columns):
                out[:, index] = numbers(self.name, self.table, column.name)
            return out
        (column,) = columns
        values = self.complete(column.name)
        if column.kind == "category" or is_category(values.type):
            codes, column = self._codes(column, values)
            self.resolved[column.name] = column
            self.extra["action_levels"] = list(column.levels or ())
            return codes
        found = levels_of_whole_numbers(values)
        if found is None or max(found) >= 2**63:
            what = "other than whole numbers" if found is None else f"{max(found)}"
            raise UserError(f"{self.name}: column {column.name} holds {what}; discrete actions are whole numbers below 2 ** 63")
        codes = values.cast(pa.int64()).to_numpy(zero_copy_only=False)
        self._in_range(column, codes)
        if column.levels is not None:
            codes, column = self._codes(column, values.cast(pa.int64()))
            self.extra["action_levels"] = list(column.levels or ())
            return codes
        if found == list(range(len(found))):
            return codes
        self.extra["action_levels"] = found
        self.resolved[column.name] = replace(column, levels=tuple(found))
        text = f"actions are {len(found)} integers from {found[0]} to {found[-1]}"
        self.warnings.append(f"{text}; they are numbered 0 .. {len(found) - 1}")
        return np.searchsorted(found, codes)

    def rewards(self, column: Column, actions: Sequence[Column]) -> np.ndarray:
        """(rows,) float64 of a column of numbers; where some are empty, the error says after which of the actions."""
        if (empty := is_missing(flat(self.table, column.name))).any():
            raise UserError(f"{self.name}: column {column.name} is empty in {self._empty(empty, actions)}")
        values = numbers(self.name, self.table, column.name)
        self._in_range(column, values)
        return values

    def _empty(self, empty: np.ndarray, actions: Sequence[Column]) -> str:
        """Which rewards are empty, and why this is no reason to leave their rows out."""
        told = f"row {int(np.argmax(empty))}"
        if empty.sum() > 1:
            told += f" and {int(empty.sum()) - 1:,} more"
            values = flat(self.table, actions[0].name).to_pylist() if len(actions) == 1 else []
            levels = sorted(set(values), key=str)
            if 2 <= len(levels) <= _ACTIONS:
                shares = (empty[[each == level for each in values]].mean() for level in levels)
                told += f" ({', '.join(f'{share:.0%} of the rows of {level}' for level, share in zip(levels, shares))})"
        return (
            f"{told}: a reward that is not known may be unlike the others, and more so if it is missing after one action more "
            "often; find it out, and neither leave its row out nor fill it in without knowing why it is missing"
        )

    def flags(self, column: Column | None) -> np.ndarray:
        """(rows,) bool of a flag; all false where there is no such column."""
        if column is None:
            return np.zeros(self.table.num_rows, bool)
        return flags(self.name, self.table, column.name)

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
        if len(levels) <= MOST_LEVELS:
            self.extra.setdefault("kept_levels", {})[column] = levels
        return codes

    def exact(self, column: str, what: str) -> Any:
        """A column that identifies something as one pyarrow array, refused if a value is missing or numbers are so large that
        they were rounded."""
        values = decoded(self.complete(column))
        exact = 2 ** {16: 11, 32: 24, 64: 53}.get(values.type.bit_width, 53) if pa.types.is_floating(values.type) else np.inf
        if exact < np.inf and (large := float(np.abs(values.to_numpy()).max())) >= exact:
            raise UserError(
                f"{self.name}: column {column} identifies {what}, and it was read as numbers up to {large:g}, which are "
                f"rounded from {exact:g} on: put a letter before its codes, so that they are texts"
            )
        return values

    def episodes(self, column: str, ordered: bool) -> np.ndarray:
        """(rows,) int64 index of each row's episode: of its value among those of the column, in the order in which they first
        appear or, if `ordered`, ascending, texts by the numbers in them.

        Raises:
            UserError: a cell is empty; or numbers are so large that they were rounded.
        """
        encoded = self.exact(column, "episodes").dictionary_encode()
        codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        if not ordered:
            return codes
        ranks = np.empty(len(encoded.dictionary), np.int64)
        if is_text(encoded.dictionary.type) and len(ranks) <= _NATURAL:
            texts = encoded.dictionary.to_pylist()
            order = sorted(range(len(texts)), key=lambda i: natural(texts[i]))
        else:
            order = sorted_indices(encoded.dictionary)
        ranks[order] = np.arange(len(ranks))
        return ranks[codes]

    def moments(self, column: str) -> np.ndarray:
        """(rows,) numbers in the order of time: float64 or, of dates and whole numbers, int64, which rounds none."""
        values = decoded(self.complete(column))
        dates = as_dates(values)
        if dates is not None:
            return ordered_moments(dates)
        if odd := first_text(values):
            text = "orders rows, and holds neither numbers nor dates in a form that is read"
            raise UserError(f"{self.name}: column {column} {text}{odd}; write dates as 2024-04-03 or 2024-04-03 14:30")
        if pa.types.is_integer(values.type) and compute.max(values).as_py() < 2**63:
            return values.to_numpy(zero_copy_only=False).astype(np.int64)
        return numbers(self.name, self.table, column)

    def complete(self, column: str) -> Any:
        """The column as one pyarrow array, refused if a value is missing."""
        values = flat(self.table, column)
        if (gone := is_missing(values)).any():
            raise UserError(f"{self.name}: column {column} is empty in row {int(np.argmax(gone))}")
        if pa.types.is_nested(values.type):
            raise UserError(f"{self.name}: column {column} holds {values.type}, one plain value per row is needed")
        return values
