"""Reading of tables in JSON as pyarrow tables: an object per line (JSON Lines), or one list of objects."""

import codecs
import io
import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa

from deadreckon.data.formats.cells import NOTHING, Known
from deadreckon.data.formats.marks import LARGEST
from deadreckon.data.formats.values import column_of
from deadreckon.data.roles import like
from deadreckon.errors import UserError, as_one_line, reading
from deadreckon.foreign.door import file_size, opened, unpacked
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked

_NEEDED = "an object per line, or one list of objects, is needed"
_CELL = 8  # bytes of a cell that is missing
_LONGEST = 1000  # entries of lists that become columns
_UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE


def is_json_table(head: bytes) -> bool:
    """Whether a file that is not RLlib's begins with an object of JSON, or with a list of such or of nothing."""
    start = without_mark(head)
    return begins_object(head) or re.match(rb'\[\s*(\{\s*["}]|\]\s*$)', start) is not None


def begins_object(head: bytes) -> bool:
    """Whether a text begins with an object of JSON."""
    return re.match(rb'\{\s*["}]', without_mark(head)) is not None


def without_mark(head: bytes) -> bytes:
    """The beginning of a text in UTF-8, without its byte order mark and without blanks before the first character."""
    if head.startswith(_UTF_16):
        head = head.decode("utf-16", "ignore").encode("utf-8", "ignore")
    return head.removeprefix(codecs.BOM_UTF8).lstrip()


def read_json_table(path: Path | str, known: Known = NOTHING) -> tuple[pa.Table, list[str]]:
    """Reads a table, a row per object, whose columns are the keys of all objects; what an object lacks is missing.

    Objects within objects become columns such as `user.age`. Lists of numbers of one length become columns such as
    `position[0]`, others texts, and those of actions a column of lists.

    Args:
        path: of the file, which may be gzipped.
        known: the columns that list actions.

    Returns:
        The table, and messages.

    Raises:
        UserError: one line that names the line, or the row of a list, and the column.
    """
    most = max_unpacked(file_size(path))
    with reading(path, "JSON"), opened(path) as file:
        columns: dict[str, list[Any]] = {}
        places: list[int] = []
        first: dict[str, Any] = {}
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
            first = row if len(places) == 1 else {}
        if not columns:
            raise UserError(f"{path}: {'its objects have no keys, which name the columns' if places else 'it has no rows'}")
        if len(places) == 1 and (why := _no_row(first)):
            raise UserError(f"{path}: its object {why}")
        arrays, told = {}, []
        within = {name[:i]: name for name in reversed(columns) for i, sign in enumerate(name) if sign == "."}
        for column, values in columns.items():
            inside = within.get(column)  # the first column of an object's parts
            if inside is not None and all(value is None for value in values):
                continue  # it is missing, and so are its parts
            if inside is not None:
                told.append(f"column {column} holds objects too, whose values are in {inside} and the like")
            parts, lines = _parts(column, values, known)
            told += lines
            for name, cells_of in parts.items():
                if name in arrays or (name != column and name in columns):
                    raise UserError(f"{path}: two columns are called {name!r}; rename one")
                if any(isinstance(cell, list) for cell in cells_of):
                    arrays[name], lines = pa.array(cells_of), []
                else:
                    where = lambda index: f"{unit} {places[index]}"  # noqa: E731
                    arrays[name], lines = column_of(path, f"column {name}", _in_64_bits(cells_of), where, decimal=True)
                told += lines
        return pa.table(arrays), told


def _rows(path: Path | str, source: BinaryIO) -> Iterator[tuple[str, int, Any]]:
    """The objects, each with its place: `line` or `row`, and its number."""
    encoding = "utf-16" if source.read(2) in _UTF_16 else "utf-8-sig"
    source.seek(0)
    text = io.TextIOWrapper(source, encoding=encoding)
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


def _no_row(only: dict[str, Any]) -> str:
    """What the only object of a file is where it is a whole table, and no row; empty otherwise."""
    for name, value in only.items():
        if isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            return f"holds a list of objects, {name!r}; write a file with that list alone"
    inner = [list(value) for value in only.values() if isinstance(value, dict)]
    columns = len(inner) == len(only) and all(keys == inner[0] and all(map(str.isdecimal, keys)) for keys in inner)
    if columns or only.keys() >= {"columns", "data"}:
        return "is a whole data frame as pandas writes it; write a list of objects, by to_json(orient='records')"
    return ""


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


def _parts(name: str, values: list[Any], known: Known) -> tuple[dict[str, list[Any]], list[str]]:
    """The columns that one of JSON becomes: several for lists of numbers of one length; and messages."""
    filled = [value for value in values if value is not None]
    lists = [value for value in filled if isinstance(value, list)]
    if not lists:
        return {name: values}, []
    kinds = {type(one) for each in lists for one in each}
    alone = len(lists) == len(filled) and not kinds & {list, dict}
    actions = name in known.lists if known.lists is not None else like("legal", name) or like("next_legal", name)
    if actions and alone and (kinds <= {int} or kinds <= {str}):
        return {name: values}, []
    sizes = {len(each) for each in lists}
    if alone and len(sizes) == 1 and 0 < max(sizes) <= _LONGEST and kinds <= {int, float, bool, type(None)}:
        return {f"{name}[{i}]": [None if each is None else each[i] for each in values] for i in range(max(sizes))}, []
    texts = [json.dumps(value) if isinstance(value, list) else value for value in values]
    return {name: texts}, [f"column {name} holds lists, not all of numbers and of one length, and is read as texts"]


def _in_64_bits(values: list[Any]) -> list[Any]:
    """Cells whose integers beyond 64 bits are texts, as in a text file, or among other numbers floats."""
    large = [value for value in values if isinstance(value, int) and not -LARGEST <= value < LARGEST]
    if not large:
        return values
    if not any(isinstance(value, float) for value in values):
        return [str(value) if isinstance(value, int) else value for value in values]
    most = int(sys.float_info.max)
    infinite = lambda value: math.inf if value > 0 else -math.inf  # noqa: E731
    as_float = lambda value: float(value) if abs(value) <= most else infinite(value)  # noqa: E731
    return [as_float(value) if isinstance(value, int) else value for value in values]
