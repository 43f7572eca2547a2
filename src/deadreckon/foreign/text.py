"""JSON and TOML from elsewhere: how large and how deep they may be, and what shape they must have."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError, as_one_line
from deadreckon.foreign.door import file_size, read_bytes
from deadreckon.foreign.limits import DEPTH, TEXT, beyond, check
from deadreckon.foreign.shapes import checked

_PARTS = re.compile(rb'"(?:[^"\\]|\\.)*"?|[\[{]|[\]}]', re.DOTALL)
_HALVES = re.compile(rb"\\u[dD][89a-fA-F]")


def read_json(path: Path | str, shape: Any = Any) -> Any:
    """Reads a JSON file.

    Args:
        path: of the file.
        shape: that its value must have, see `foreign.shapes`.

    Raises:
        UserError: the file is missing, is not JSON, is beyond a limit (`foreign.limits`), or has another shape.
    """
    check(path, file_size(path), TEXT, "has")
    return checked(parse_json(path, read_bytes(path)), shape, path)


def parse_json(path: Path | str, text: bytes | str) -> Any:
    """The value of a text in JSON that is from a file; raises as `read_json`."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    _check_depth(path, data)
    try:
        value = json.loads(data)
        if _HALVES.search(data):  # halves of characters, which no file can hold
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except UnicodeEncodeError as error:
        raise UserError(f"{path} is not valid JSON: it holds half of a character") from error
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not valid JSON: {as_one_line(error)}") from error


def read_toml(path: Path | str, shape: Any = Any) -> dict[str, Any]:
    """Reads a TOML file; arguments and errors are those of `read_json`."""
    check(path, file_size(path), TEXT, "has")
    data = read_bytes(path)
    _check_depth(path, data)
    try:
        return checked(tomllib.loads(data.decode("utf-8")), shape, path)
    except UnicodeDecodeError as error:
        raise UserError(f"cannot read {path}: {error}") from error
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path} is not TOML: {as_one_line(error)}") from error


def _check_depth(path: Path | str, data: bytes) -> None:
    """Refuses what is nested deeper than it may be, before a parser goes down there."""
    most = DEPTH.value
    if data.count(b"[") + data.count(b"{") <= most:
        return
    depth = deepest = 0
    for found in _PARTS.finditer(data):
        part = found[0][:1]
        if part in b"[{":
            depth += 1
            deepest = max(deepest, depth)
        elif part in b"]}":
            depth -= 1
    if deepest > most:
        raise beyond(path, deepest, most, DEPTH, "is nested in")
