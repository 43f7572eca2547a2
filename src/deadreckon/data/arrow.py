"""Columns of tables as pyarrow arrays: what they hold, and as numbers, flags and levels."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute

from deadreckon.data.scratch import BLOCK
from deadreckon.errors import UserError
from deadreckon.names import repeated

compute: Any = pyarrow.compute  # its functions are made at run time, so type checkers do not know them
SAMPLE = 1_000  # rows that are looked at before all are
OFFSETS = 2**31 - 1  # bytes of texts that one array with offsets of 32 bits holds
_EXACT = 2**53  # up to which float64 holds every integer
MOST_LEVELS = 1_000  # a text column with more distinct values is an identifier, not a category


def flat(table: pa.Table, column: str, ignored: bool = False) -> Any:
    """(rows,) the column as one pyarrow array, of a type with which all functions of pyarrow work.

    Args:
        table: that has it.
        column: its name.
        ignored: whether it is left out of the log, so that it may have any type.

    Raises:
        UserError: the column has a type of a library's own, such as pandas' intervals or UUIDs.
    """
    values = table.column(column)
    kind = values.type.value_type if pa.types.is_dictionary(values.type) else values.type
    if isinstance(kind, pa.BaseExtensionType):
        if not ignored:
            text = f"column {column} holds {kind.extension_name}, numbers, texts, dates or truth values are needed"
            raise UserError(f"{text}; leave it out (--ignore {column})")
        values = values.cast(kind.storage_type)
    if pa.types.is_float16(kind):
        values = (values.cast(kind) if pa.types.is_dictionary(values.type) else values).cast(pa.float32())
    elif pa.types.is_decimal(kind):
        values = _plain_decimals(values)
    if pa.types.is_dictionary(values.type):
        values = values.unify_dictionaries()
    large = pa.types.is_string(values.type) and values.nbytes > OFFSETS  # more than the offsets of one array reach
    if large or pa.types.is_string_view(values.type):  # polars', which pyarrow cannot sort yet
        values = values.cast(pa.large_string())
    return values.combine_chunks() if values.num_chunks != 1 else values.chunk(0)


def _plain_decimals(values: Any) -> Any:
    """Decimals as integers or floats, which hold them apart; as they are where these do not."""
    scale = values.type.scale
    ends = compute.min_max(values).as_py()
    if any(end is not None and abs(end) * 10 ** max(scale, 0) >= _EXACT for end in ends.values()):
        return values
    return values.cast(pa.int64() if scale <= 0 else pa.float64())


def is_string(kind: pa.DataType) -> bool:
    """Whether a column holds plain texts, on which all functions of pyarrow work."""
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def is_text(kind: pa.DataType) -> bool:
    """Whether a column holds texts, also as a dictionary of them."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return is_string(kind) or pa.types.is_string_view(kind)


def is_category(kind: pa.DataType) -> bool:
    """Whether a column's values are levels: texts, categories, truth values."""
    return pa.types.is_dictionary(kind) or pa.types.is_boolean(kind) or is_text(kind)


def is_missing(values: Any) -> np.ndarray:
    """(rows,) bool, where a value is missing; NaN is."""
    return values.is_null(nan_is_null=True).to_numpy(zero_copy_only=False)


def all_match(texts: Any, pattern: str) -> bool:
    """Whether all texts that are not missing match a pattern of RE2, and one does; a few are tried first."""
    for some in (texts[:SAMPLE], texts):
        if compute.all(compute.match_substring_regex(some, pattern)).as_py() is False:
            return False
    return texts.null_count < len(texts)


def distinct(values: Any) -> int:
    """How many different values there are, missing ones aside."""
    return len(_different(values))


def _different(values: Any) -> Any:
    """The different values, missing ones aside; of lists, which pyarrow does not compare, their texts."""
    present = values.drop_null()
    return set(map(repr, present.to_pylist())) if pa.types.is_nested(values.type) else present.unique()


def few_values(values: Any, most: int = MOST_LEVELS) -> Any | None:
    """The different values, missing ones aside, where there are at most `most`; else None, mostly seen in the first block."""
    for part in (values.slice(0, BLOCK), values):  # telling many values apart takes much memory
        found = _different(part)
        if len(found) > most:
            return None
    return found


def decoded(values: Any) -> Any:
    """The values of a dictionary array, or the array itself."""
    if not isinstance(values, pa.DictionaryArray):
        return values
    if pa.types.is_string_view(values.type.value_type):  # polars' categories; pyarrow cannot take from these yet
        values = pa.DictionaryArray.from_arrays(values.indices, values.dictionary.cast(pa.large_string()))
    return values.dictionary_decode()


def says_numbers(values: Any) -> bool:
    """Whether all texts of a column say numbers."""
    found = decoded(values)
    return is_text(found.type) and all(is_number(text) for text in found.drop_null().unique().to_pylist())


def as_dates(values: Any) -> Any | None:
    """The dates that a column holds, also as texts of ISO 8601; None where it holds something else."""
    values = decoded(values)
    if pa.types.is_temporal(values.type):
        return values
    if not is_text(values.type) or says_numbers(values):
        return None
    for kind in (pa.timestamp(unit, zone) for unit in ("us", "ns") for zone in (None, "UTC")):
        try:
            return compute.cast(values, kind)
        except pa.ArrowInvalid:
            continue
    return None


def ordered_moments(dates: Any) -> np.ndarray:
    """(rows,) int64 counts of the type's own unit, which keep the order of dates exactly; none is missing."""
    width = pa.int32() if dates.type.bit_width == 32 else pa.int64()
    return np.asarray(dates.view(width).to_numpy(zero_copy_only=False), np.int64)


def levels_of_whole_numbers(values: Any, missing: bool = False) -> list[int] | None:
    """The different values of a column of whole numbers, ascending; None where it has others.

    Args:
        values: (rows,) of it.
        missing: whether some may be missing; None else where they are.
    """
    kind = values.type
    if missing:
        values = values.filter(pa.array(~is_missing(values)))
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)) or values.null_count:
        return None
    if pa.types.is_floating(kind):  # looked at in blocks before they are told apart, which takes much memory of many values
        for start in range(0, len(values), BLOCK):
            part = values.slice(start, BLOCK).to_numpy(zero_copy_only=False)
            if not (np.isfinite(part).all() and (part == np.floor(part)).all()):
                return None
    found = np.asarray(values.unique().to_numpy(zero_copy_only=False), np.float64 if pa.types.is_floating(kind) else None)
    return [int(level) for level in np.sort(found)]


def is_number(text: str) -> bool:
    """Whether a text says a number, as pyarrow reads it; Python takes 1_000 and the digits of other scripts too."""
    try:
        float(text)
    except ValueError:
        return False
    return str(text).isascii() and "_" not in str(text)


def numbers(name: str, table: pa.Table, column: str) -> np.ndarray:
    """(rows,) float64 of a column that must be complete, finite numbers or truth values.

    Raises:
        UserError: it is not, with the row.
    """
    values, absent = some_numbers(name, column, flat(table, column))
    wrong = absent | ~np.isfinite(values)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"{name}: column {column} {'is empty' if absent[row] else f'has {values[row]}'} in row {row}")
    return values


def some_numbers(name: str, column: str, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """(rows,) float64 and (rows,) bool where a value is missing."""
    if pa.types.is_dictionary(values.type) and not is_text(values.type):  # categories that are numbers, and parts of paths
        values = decoded(values)
    kind = values.type
    if pa.types.is_boolean(kind):
        values = values.cast(pa.int8())
    elif is_text(kind) and says_numbers(values):
        values = compute.utf8_trim_whitespace(decoded(values)).cast(pa.float64())
    elif pa.types.is_decimal(kind):
        values = values.cast(pa.float64())
    elif pa.types.is_null(kind):
        return np.full(len(values), np.nan), np.ones(len(values), bool)
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        hint = "; give it as time, or leave it out" if pa.types.is_temporal(kind) else first_text(values)
        what = "texts" if is_text(kind) else str(kind)
        raise UserError(f"{name}: column {column} holds {what}, numbers are needed{hint}")
    out = values.to_numpy(zero_copy_only=False).astype(np.float64)
    return out, np.isnan(out)


def flags(name: str, table: pa.Table, column: str, free: np.ndarray | None = None) -> np.ndarray:
    """(rows,) bool of a column of truth values, or of 0 and 1; true where a value is missing in a row that is `free` to."""
    if free is None:
        values = numbers(name, table, column)
    else:
        values, absent = some_numbers(name, column, flat(table, column))
        values = np.where(absent & free, 1.0, values)
        if (absent := absent & ~free).any():
            raise UserError(f"{name}: column {column} is empty in row {int(np.argmax(absent))}")
    _refuse(name, column, values, (values != 0) & (values != 1), "0 or 1")
    return values != 0


def log_probabilities(name: str, table: pa.Table, column: str, actions: np.ndarray) -> np.ndarray:
    """(rows,) logarithms of a column of probabilities in (0, 1], or of densities above 0 where `actions` are continuous."""
    values = numbers(name, table, column)
    discrete = actions.dtype.kind in "iub"
    wrong = (values <= 0) | (discrete & (values > 1))
    _refuse(name, column, values, wrong, "a probability in (0, 1]" if discrete else "a density above 0")
    return np.log(values).astype(np.float32)


def _refuse(name: str, column: str, values: np.ndarray, wrong: np.ndarray, needed: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"{name}: column {column} has {values[row]:g} in row {row}, {needed} is needed")


def category_codes(name: str, column: str, values: Any, most: int | None = MOST_LEVELS) -> tuple[np.ndarray, list[Any]]:
    """(rows,) int64 index of each value's level, -1 where it is missing, and the levels that occur, sorted; `most` of them."""
    values = decoded(values)
    if pa.types.is_boolean(values.type):
        values = values.cast(pa.string())
    encoded = values.dictionary_encode()
    if most is not None and len(encoded.dictionary) > most:
        text = f"column {column} has {len(encoded.dictionary)} distinct values, at most {most} are encoded"
        raise UserError(f"{name}: {text}; leave it out")
    codes = encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
    order = sorted_indices(encoded.dictionary)
    ranks = np.append(np.empty(len(order), np.int64), -1)
    ranks[order] = np.arange(len(order))
    return ranks[codes], [encoded.dictionary[int(index)].as_py() for index in order]


def codes_of(name: str, column: str, values: Any, levels: Sequence[Any]) -> tuple[np.ndarray, list[Any]]:
    """(rows,) int64 index among given levels of each value, -1 where it is none of them, and the values that are none."""
    found, here = category_codes(name, column, values, most=None)
    known = {_plain(level): index for index, level in enumerate(levels)}
    ranks = np.append([known.get(_plain(level), -1) for level in here], -1).astype(np.int64)
    return ranks[found], [level for level in here if _plain(level) not in known]


def _plain(level: Any) -> Any:
    """A level as it is compared: true and false as the texts that flags become, 1.0 as 1."""
    return ("false", "true")[level] if isinstance(level, bool) else level


def sorted_indices(values: Any) -> np.ndarray:
    """The positions of a pyarrow array's values in ascending order."""
    return compute.sort_indices(values).to_numpy()


def first_text(values: Any) -> str:
    """Which cell keeps a column of texts from being numbers; nothing for another kind of column."""
    for row, value in enumerate(values.to_pylist() if is_category(values.type) else ()):
        if isinstance(value, str) and not is_number(value):
            return f"; row {row} has {value!r}; write all cells as plain numbers"
    return ""


def to_arrow(frame: Any, name: str = "frame") -> pa.Table:
    """A pandas, polars or pyarrow table, or a mapping of columns, as a pyarrow table.

    Raises:
        UserError: it is none of these, or its columns do not fit together.
    """
    try:
        if isinstance(frame, pa.Table):
            table = frame
        elif isinstance(frame, Mapping):
            table = pa.table({str(key): _sequence(value) for key, value in frame.items()})
        elif hasattr(frame, "__arrow_c_stream__"):
            table = pa.table(frame)
        elif hasattr(frame, "__dataframe__"):
            from pyarrow.interchange import from_dataframe

            table = from_dataframe(frame)
        else:
            raise UserError(f"{name}: a pandas, polars or pyarrow table is needed, not {type(frame).__name__}")
    except (pa.ArrowException, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{name}: not a table of plain columns ({' '.join(' '.join(map(str, error.args)).split())})") from error
    if twice := repeated(table.column_names):
        raise UserError(f"{name}: column {twice[0]} occurs more than once")
    # pandas' own index, unless it has a name, is no column of the user's.
    return table.drop_columns([column for column in table.column_names if re.fullmatch(r"__index_level_\d+__", column)])


def _sequence(value: Any) -> Any:
    return pa.chunked_array(value) if hasattr(value, "__arrow_c_stream__") else pa.array(value)
