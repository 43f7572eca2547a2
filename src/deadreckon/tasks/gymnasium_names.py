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
        try:
            found[key] = ast.literal_eval(value)
        except (ValueError, SyntaxError, RecursionError, MemoryError):  # the last two of deeply nested texts
            found[key] = value
    return found


def written(options: Mapping[str, Any]) -> str:
    """The inverse of `options_of`, in the order of names; of an array, which no name can hold, what tells it from others."""
    return "?" * bool(options) + "&".join(f"{key}={_text(value)}" for key, value in sorted(options.items()))


def _text(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    return f"array-{hashlib.blake2b(f'{value.shape} {value.dtype}'.encode() + value.tobytes(), digest_size=8).hexdigest()}"
