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
# Of TOML: what is in quotes, where dots mean nothing, and comments; parts of keys with dots between them. Neither looks twice
# at what it has seen, whatever the text is.
_TEXTS = re.compile(
    rb"""\"{3}(?:[^\\]|\\.?)*?(?:\"{3}|\Z)|'{3}.*?(?:'{3}|\Z)|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?|#[^\n]*+""", re.DOTALL
)
_DOTTED = re.compile(rb"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++)++")
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
    _check_keys(path, data)
    try:
        found = tomllib.loads(data.decode("utf-8"))
        _check_nested(path, found)
        return checked(found, shape, path)
    except UnicodeDecodeError as error:
        raise UserError(f"cannot read {path}: {error}") from error
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path} is not TOML: {as_one_line(error)}") from error


def _check_keys(path: Path | str, data: bytes) -> None:
    """Refuses keys of TOML with more parts than levels may be: each part is a level, and their time grows with the square."""
    most = DEPTH.value
    if data.count(b".") < most:
        return
    bare = _TEXTS.sub(_without, data)
    longest = max((found[0].count(b".") + 1 for found in _DOTTED.finditer(bare)), default=0)
    if longest > most:
        raise beyond(path, longest, most, DEPTH, "is nested in")


def _without(found: re.Match[bytes]) -> bytes:
    """What stands for a text, or part of a key, in quotes; nothing for a comment."""
    return b"" if found[0].startswith(b"#") else b"_"


def _check_nested(path: Path | str, value: Any) -> None:
    """Refuses a value that is nested deeper than it may be, as inner tables with dotted keys are together."""
    most = DEPTH.value
    level, depth = [value], 0
    while level := [each for each in level if isinstance(each, dict | list)]:
        if (depth := depth + 1) > most + 1:  # the document itself is none
            raise beyond(path, depth - 1, most, DEPTH, "is nested in")
        level = [part for each in level for part in (each.values() if isinstance(each, dict) else each)]


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
