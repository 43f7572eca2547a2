"""Options of environments behind the question mark of a name: `gymnasium:FrozenLake-v1?is_slippery=False`."""

import ast
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.errors import UserError


def options_of(name: str, text: str) -> dict[str, Any]:
    """`a=1&b=x` as Python's values where they are such, else as text.

    Raises:
        UserError: a part without a name or a value.
    """
    found: dict[str, Any] = {}
    for part in filter(None, text.split("&")):
        key, equals, value = part.partition("=")
        if not key.isidentifier() or not equals:
            raise UserError(f"task {name}: options are written ?name=value&name=value, got {part!r}")
        found[key] = _value(value)
    return found


def written(options: Mapping[str, Any]) -> str:
    """The inverse of `options_of`, in the order of names; of an array, which no name can hold, what tells it from others."""
    return "?" * bool(options) + "&".join(f"{key}={_text(value)}" for key, value in sorted(options.items()))


def array_text(value: np.ndarray) -> str:
    """What tells an array from others in a name or in a file."""
    return f"array-{hashlib.blake2b(f'{value.shape} {value.dtype}'.encode() + value.tobytes(), digest_size=8).hexdigest()}"


def _value(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, RecursionError, MemoryError):  # the last two of deeply nested texts
        return text


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return array_text(value)
    value = value.item() if isinstance(value, np.generic) else value
    text = str(value)
    if "&" not in text and type(found := _value(text)) is type(value) and found == value:
        return text
    if isinstance(value, float):
        return text.replace("inf", "1e999")  # infinity as a literal
    return repr(value).replace("&", r"\x26")  # a text that looks like a number, or holds what separates options
