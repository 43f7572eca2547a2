"""Rows of a table in whatever form they come, as columns, numbers and levels: numpy and the standard library alone.

Like `table_encoder`, which needs it, this module imports nothing of the package and can be copied beside `portable.py`.
"""

import contextlib
import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from decimal import Decimal
from typing import Any

import numpy as np

if __package__:
    from deadreckon.errors import UserError
else:  # copied beside `portable.py`
    UserError = ValueError

_PLAIN = {int, float, bool}
_SHOWN = 8  # names in a message
_FLAG = "a flag is true or false, 1 or 0, yes or no"
_MISSING = ("", "NA", "N/A", "n/a", "NaN", "nan", "NULL", "Null", "null", "None", "none", "#N/A", "#NV", "#NA")
# Texts of truth values, as `data.formats.cells` reads them in files.
_TRUTHS = {word: True for word in ("yes", "ja", "oui", "si", "sí", "sì", "true", "y", "j", "t", "on")} | {
    word: False for word in ("no", "nein", "non", "false", "n", "f", "off")
}


class RowsError(UserError):  # pyrefly: ignore[invalid-inheritance] - either is an error
    """Rows that cannot be encoded, in one line that names the column, the row and what would be right."""


def columns_of(
    rows: Any, needed: Collection[str], more: Collection[str], name: str
) -> tuple[dict[str, np.ndarray], int, bool] | None:
    """Rows by columns.

    Args:
        rows: a data frame (pandas, polars, Arrow), a mapping of columns, a sequence of mappings or one mapping, or rows with
            names that are no mappings, such as named tuples and the rows of pandas and sqlite3.
        needed: columns without which rows are of no use; one value of them says whether a mapping is one row.
        more: columns that are of use where they are there.
        name: of the rows, for errors.

    Returns:
        {column: (rows,) values}, how many rows there are, and whether they are one mapping; None where `rows` is something
        else, such as an array. Columns that are of no use stay as they are.

    Raises:
        RowsError: columns differ in length, or a row lacks a column that others have.
    """
    count, rows = None, _named(rows)
    if isinstance(rows, Sequence) and not isinstance(rows, str | bytes):
        if not len(rows):
            raise RowsError(f"{name}: there are no rows")
        rows = list(map(_named, rows)) if isinstance(_named(rows[0]), Mapping) else rows
    if isinstance(rows, Mapping):
        given: dict[str, Any] = {str(key): value for key, value in rows.items()}
        if any(not _is_many(given[key]) for key in needed if key in given) or (
            given and not any(map(_is_many, given.values()))
        ):
            return {key: _array([value]) for key, value in given.items()}, 1, True
    elif isinstance(rows, list) and isinstance(rows[0], Mapping):
        given, count = _of_mappings(rows, needed, more, name), len(rows)
    elif hasattr(rows, "columns") and hasattr(rows, "__getitem__"):
        frame: Any = rows
        keys = list(frame.column_names if hasattr(frame, "column_names") else frame.columns)  # Arrow's; of the others
        if len(set(map(str, keys))) < len(keys):
            raise RowsError(f"{name}: two columns have one name; rename one")
        try:
            given = {str(key): frame[key] for key in keys}
        except TypeError:  # a relation of a database, whose columns are none yet
            wanted = "a data frame, an Arrow table or dictionaries are needed"
            raise RowsError(f"{name}: the columns of a {type(rows).__name__} cannot be read; {wanted}") from None
    else:
        return None
    columns = {key: _array(value) if key in needed or key in more else value for key, value in given.items()}
    for key in [key for key in columns if key in needed or key in more]:
        values = columns[key]
        if not values.ndim:
            raise RowsError(f"{name}: column {key} is one value, {shown(values.item())}, and others are columns")
        count = len(values) if count is None else count
        if values.ndim != 1 or len(values) != count:
            shape = "x".join(map(str, values.shape))
            raise RowsError(f"{name}: column {key} has the shape {shape}, the first one has {count} values")
    return columns, count or 0, False


def _of_mappings(
    rows: Sequence[Any], needed: Collection[str], more: Collection[str], name: str
) -> dict[str, Any]:  # fmt: skip
    """Columns of a sequence of mappings; only columns that are not needed may be absent from some, where they are missing."""
    if (wrong := next((i for i, row in enumerate(rows) if not isinstance(row, Mapping)), None)) is not None:
        raise RowsError(f"{name}: row {wrong} is {kind(rows[wrong])}, a dictionary of columns is needed")
    out: dict[str, Any] = {}
    for key in needed:
        try:
            out[key] = [row[key] for row in rows]
        except KeyError:
            row = next(i for i, row in enumerate(rows) if key not in row)
            text = f"row {row} has no column {key}{near(key, rows[row])}"
            raise RowsError(f"{name}: {text}; say null where a value is missing") from None
    for key in more:
        if key not in out and any(key in row for row in rows):
            out[key] = [row.get(key) for row in rows]
    return out


def _named(row: Any) -> Any:
    """A row with names that is no mapping, such as a named tuple or a row of pandas or sqlite3, as a mapping; else as it is."""
    if isinstance(row, Mapping | list | np.ndarray) or hasattr(row, "columns"):
        return row
    if isinstance(row, tuple):
        return dict(zip(row._fields, row, strict=True)) if hasattr(row, "_fields") else row
    names = list(row.keys()) if callable(getattr(row, "keys", None)) else []
    return {key: row[key] for key in names} if names and all(isinstance(key, str) for key in names) else row


def _is_many(value: Any) -> bool:
    """Whether a value is that of a column, and not of a cell."""
    return isinstance(value, list | tuple) or (hasattr(value, "__array__") and np.ndim(value) > 0)


def _array(values: Any) -> np.ndarray:
    """(rows,) values of a column; texts and what is mixed as objects, so that no value becomes another."""
    if isinstance(values, np.ma.MaskedArray):
        if values.dtype.kind in "mM":
            return np.where(np.ma.getmaskarray(values), np.array("NaT", values.dtype), values.data)
        out = np.array(values.data, object)
        out[np.ma.getmaskarray(values)] = None
        return out
    if not isinstance(values, list | tuple):
        if not str(getattr(values, "type", "")).startswith("dictionary"):
            return np.asarray(values)
        values = values.to_pylist()  # Arrow forgets which are missing
    kinds = {type(value) for value in values}
    if kinds <= _PLAIN:
        with contextlib.suppress(OverflowError):  # of whole numbers beyond float64, which are refused where the column is known
            return np.asarray(values, None if len(kinds) < 2 else np.float64)
    out = np.empty(len(values), object)
    for row, value in enumerate(values):  # at once, lists would be taken for further dimensions
        out[row] = value
    return out


def numbers_of(column: str, values: np.ndarray, name: str, needed: str = "a number is needed") -> np.ndarray:
    """(rows,) float64 of a column, NaN where a value is missing; texts that say numbers are these; `needed` is for errors.

    Raises:
        RowsError: a value is no number.
    """
    if values.dtype.kind in "fiub":
        return values.astype(np.float64)
    if values.dtype.kind in "mM":  # dates and durations, which some units of numpy list as whole numbers
        if (there := ~np.isnat(values)).any():
            raise _no_value(column, str(values[row := first(there)]), row, name, needed)
        return np.full(len(values), np.nan)
    cells = values.tolist()
    if (kinds := set(map(type, cells))) <= {float, type(None)} or (kinds == {str} and _says_number("".join(cells))):
        with contextlib.suppress(ValueError):  # a text that is no number, which is looked for below
            return np.asarray([np.nan if cell is None else float(cell) for cell in cells])
    out = np.empty(len(values))
    for row, value in enumerate(cells):
        if is_missing(value):
            out[row] = np.nan
            continue
        try:
            if isinstance(value, str) and not _says_number(value):
                raise TypeError
            out[row] = float(value) if isinstance(value, int | float | str | Decimal) else _as_float(value)
        except (TypeError, ValueError, OverflowError):
            raise _no_value(column, value, row, name, needed) from None
    return out


def _as_float(value: Any) -> float:
    """A number of a library's own, such as numpy's; dates are none."""
    if np.asarray(value).dtype.kind not in "biuf":
        raise TypeError
    return float(value)


def flags_of(column: str, values: np.ndarray, name: str) -> np.ndarray:
    """(rows,) float64 of a column of truth values, 0 or 1, NaN where a value is missing; texts such as yes and no are these.

    Raises:
        RowsError: a value is none.
    """
    if values.dtype.kind not in "fiubmM":
        cells = values.tolist()
        values = _array([_truth(cell.strip()) if isinstance(cell, str) else cell for cell in cells])
    found = numbers_of(column, values, name, _FLAG)
    if (wrong := ~np.isnan(found) & (found != 0) & (found != 1)).any():
        raise _no_value(column, values.tolist()[row := first(wrong)], row, name, _FLAG)
    return found


def _truth(text: str) -> Any:
    return None if text in _MISSING else _TRUTHS.get(text.lower(), text)


def word_of_truth(text: str) -> str:
    """"true" or "false" for a text such as yes or off, which says the same in a file; any other text as it is."""
    return text if (found := _TRUTHS.get(text.lower())) is None else str(found).lower()


def _no_value(column: str, value: Any, row: int, name: str, needed: str) -> RowsError:
    return RowsError(f"{name}: column {column} has {shown(value)} in row {row}, {needed}")


def _says_number(text: str) -> bool:
    """Whether Arrow reads the text as a number, as training did; Python takes 1_000 and the digits of other scripts too."""
    return text.isascii() and "_" not in text


def is_missing(value: Any) -> bool:
    """Whether a value is missing: None, NaN, or what pandas has for it."""
    return value is None or (isinstance(value, float) and value != value) or type(value).__name__ in ("NAType", "NaTType")


def codes_by_level(levels: Iterable[Any]) -> dict[Any, int]:
    """{level: code} of levels in the order of their codes, also by their texts, so that 1.0 and "1" are 1."""
    levels = [_plain(level) for level in levels]
    exact = {level: code for code, level in enumerate(levels)}
    return {text_of(level): code for code, level in enumerate(levels)} | exact


def coded(codes: Mapping[Any, int], values: np.ndarray) -> list[int]:
    """(rows,) the codes of values by `codes_by_level`, -1 where there is none."""
    cells = values.tolist()
    if bool not in map(type, cells):  # which would be taken for 0 and 1
        with contextlib.suppress(TypeError):  # a list is no level
            return [codes.get(cell, -1) for cell in cells]
    return [-1 if (code := code_of(codes, cell)) is None else code for cell in cells]


def code_of(codes: Mapping[Any, int], value: Any) -> int | None:
    """The code of a value by `codes_by_level`, or None."""
    value = _plain(value)
    try:
        found = codes.get(value)
    except TypeError:  # a list is no level
        return None
    return codes.get(text_of(value)) if found is None else found


def _plain(level: Any) -> Any:
    """A level as it is compared: truth values as the texts that they become in a table, lists as tuples."""
    if isinstance(level, bool | np.bool_):
        return "true" if level else "false"
    return tuple(level) if isinstance(level, list) else level


def text_of(level: Any) -> str:
    """A level as text: 2.0 as 2, true and false as in a file."""
    level = _plain(level)
    try:
        return str(int(level)) if isinstance(level, float) and level.is_integer() else str(level)
    except ValueError:  # a whole number of thousands of digits, which Python does not write in decimals
        return hex(level)


def first(where: np.ndarray) -> int:
    """The first row in which something holds, of (rows,) or (rows, n) truth values."""
    return int(np.argmax(where.reshape(len(where), -1).any(1)))


def near(word: str, known: Iterable[str], kind: str = "columns") -> str:
    """What may have been meant, or what there is, as the end of a message."""
    known = [str(each) for each in known]
    if found := difflib.get_close_matches(word, known, n=1, cutoff=0.6):
        return f": did you mean {found[0]}?"
    return f" ({kind}: {listed(known)})"


def listed(names: Iterable[str]) -> str:
    """The names, as many as fit into a message."""
    names = list(names)
    return ", ".join(names[:_SHOWN]) + ", ..." * (len(names) > _SHOWN)


def shown(value: Any) -> str:
    """A value in a message, which may be long."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:
        return "a whole number of thousands of digits"
    return text if len(text) <= 40 else f"{text[:37]}..."


def kind(value: Any) -> str:
    """What a value is, in a message."""
    return {"dict": "a dictionary", "list": "a list", "str": "a text", "NoneType": "nothing"}.get(
        type(value).__name__, f"of type {type(value).__name__}"
    )
