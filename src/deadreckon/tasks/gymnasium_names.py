"""Options of environments behind the question mark of a name: `gymnasium:FrozenLake-v1?is_slippery=False`."""

import ast
from collections.abc import Mapping
from typing import Any

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
    """The inverse of `options_of`, in the order of names."""
    return "?" * bool(options) + "&".join(f"{key}={' '.join(str(value).split())}" for key, value in sorted(options.items()))
