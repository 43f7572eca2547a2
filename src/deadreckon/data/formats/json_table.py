"""Reading of tables in JSON as pyarrow tables: an object per line (JSON Lines), or one list of objects."""

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa

from deadreckon.data.formats.values import column_of
from deadreckon.errors import UserError, as_one_line, reading
from deadreckon.foreign.door import file_size, opened, unpacked
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked

_NEEDED = "an object per line, or one list of objects, is needed"
_CELL = 8  # bytes of a cell that is missing
_LONGEST = 1000  # entries of lists that become columns
_WHOLE = 2**63  # integers from here on do not fit into 64 bits


def is_json_table(head: bytes) -> bool:
    """Whether a file that is not RLlib's begins with an object of JSON, or with a list of such."""
    start = without_mark(head)
    return b"\0" not in head and re.match(rb'(\[\s*)?\{\s*"', start) is not None


def without_mark(head: bytes) -> bytes:
    """The beginning of a text without its byte order mark and without blanks before the first character."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()


def read_json_table(path: Path | str) -> tuple[pa.Table, list[str]]:
    """Reads a table, a row per object, whose columns are the keys of all objects; what an object lacks is missing.

    Objects within objects become columns such as `user.age`. Lists of one length become columns such as `position[0]`, others
    texts.

    Args:
        path: of the file, which may be gzipped.

    Returns:
        The table, and messages.

    Raises:
        UserError: one line that names the line, or the row of a list, and the column.
    """
    most = max_unpacked(file_size(path))
    with reading(path, "JSON"), opened(path) as file:
        columns: dict[str, list[Any]] = {}
        places: list[int] = []
        unit = "line"
        for unit, place, row in _rows(path, unpacked(path, file)):
            cells: dict[str, Any] = {}
            _spread(row, "", cells, f"{path}: {unit} {place}")
            for name, value in cells.items():
                if name not in columns:
                    columns[name] = [None] * len(places)
                columns[name].append(value)
            places.append(place)
            for values in columns.values() if len(cells) < len(columns) else ():
                values.extend([None] * (len(places) - len(values)))
            if (taken := len(columns) * len(places) * _CELL) > most:
                raise beyond(path, taken, most, UNPACKED, "unpacks to")
        if len(places) == 1 and (inner := next((name for name, (value,) in columns.items() if _is_rows(value)), None)):
            raise UserError(f"{path}: its object holds a list of objects, {inner!r}; write a file with that list alone")
        if not columns:
            raise UserError(f"{path}: its objects have no keys, which name the columns")
        arrays, told = {}, []
        for column, values in columns.items():
            parts, lines = _parts(column, values)
            told += lines
            for name, cells_of in parts.items():
                if name in arrays or (name != column and name in columns):
                    raise UserError(f"{path}: two columns are called {name!r}; rename one")
                arrays[name], lines = column_of(
                    path, f"column {name}", cells_of, lambda index: f"{unit} {places[index]}", decimal=True
                )
                told += lines
        return pa.table(arrays), told


def _rows(path: Path | str, source: BinaryIO) -> Iterator[tuple[str, int, Any]]:
    """The objects, each with its place: `line` or `row`, and its number."""
    text = io.TextIOWrapper(source, encoding="utf-8-sig")
    for number, line in enumerate(text, 1):
        if not line.strip():
            continue
        if line.lstrip().startswith("["):  # a list, which may go on over many lines
            listed = _parsed(path, line + text.read(), f"the list from line {number} on")
            if not isinstance(listed, list):
                raise UserError(f"{path}: {_NEEDED}")
            yield from (("row", index, row) for index, row in enumerate(listed, 1))
            return
        yield "line", number, _parsed(path, line, f"line {number}")


def _parsed(path: Path | str, text: str, what: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_object, parse_constant=_constant)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: {what} is no JSON ({as_one_line(error)}); {_NEEDED}") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"two values of an object are called {next(name for name in names if names.count(name) > 1)!r}")
    return found


def _constant(name: str) -> float | None:
    """What Python's and other writers make of numbers that JSON does not have; one that is none is missing."""
    return None if name == "NaN" else float(name)


def _is_rows(value: Any) -> bool:
    """Whether a value is itself a table: a list of objects."""
    return isinstance(value, list) and bool(value) and all(isinstance(one, dict) for one in value)


def _spread(row: Any, prefix: str, cells: dict[str, Any], what: str) -> None:
    """Adds the values of an object to `cells`, those of objects in it under `outer.inner`."""
    if not isinstance(row, dict):
        raise UserError(f"{what} is no object; {_NEEDED}")
    for key, value in row.items():
        if not (name := " ".join(key.split())):
            raise UserError(f"{what} has a value without a name")
        if isinstance(value, dict):
            _spread(value, f"{prefix}{name}.", cells, what)
        elif (whole := prefix + name) in cells:
            raise UserError(f"{what} has two values called {whole!r}; rename one")
        else:
            cells[whole] = value


def _parts(name: str, values: list[Any]) -> tuple[dict[str, list[Any]], list[str]]:
    """The columns that one of JSON becomes: several for lists of one length; and messages."""
    filled = [value for value in values if value is not None]
    lists = [value for value in filled if isinstance(value, list)]
    if lists:
        size = len(lists[0])
        flat = len(lists) == len(filled) and 0 < size <= _LONGEST
        if flat and all(len(each) == size and not any(isinstance(one, list | dict) for one in each) for each in lists):
            return {f"{name}[{i}]": [None if each is None else each[i] for each in values] for i in range(size)}, []
        texts = [json.dumps(value) if isinstance(value, list) else value for value in values]
        return {name: texts}, [f"column {name} holds lists, not all of the same length and flat, and is read as texts"]
    # Integers beyond 64 bits are read as those of a text file are.
    if all(isinstance(value, int) for value in filled) and any(not -_WHOLE <= value < _WHOLE for value in filled):
        return {name: [None if value is None else str(value) for value in values]}, []
    return {name: values}, []
