"""Settings that functions take as keywords, hold as one object and pass on."""

import dataclasses
import math
import numbers
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, Union

from deadreckon.errors import UserError, unknown

NUMBERS = {int: (numbers.Integral, "a whole number"), float: (numbers.Real, "a number")}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of all settings: each field is declared and described once, for Python and for the command line."""

    @classmethod
    def of(cls, keywords: Mapping[str, Any]) -> Self:
        """Settings from keywords.

        Raises:
            UserError: there is no such setting, or its value is of another kind than its field says.
        """
        names = [field.name for field in dataclasses.fields(cls)]
        hints = typing.get_type_hints(cls) if keywords else {}
        for name, value in keywords.items():
            if name not in names:
                raise unknown("setting", name, names)
            check_kind(name, value, hints[name])
        return cls(**keywords)

    def check_values(self) -> None:
        """Refuses values that are out of range, whatever the log is.

        Raises:
            UserError: names the value and its range.
        """

    def only(self, kind: type["Settings"]) -> dict[str, Any]:
        """The settings of a base class, as keywords for the function that takes these."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(kind)}


def check_kind(name: str, value: Any, hint: Any) -> None:
    """Refuses a value that is not what an annotation says: numbers, truth values, choices, pairs, functions, classes, None.

    Annotations that say something else, such as sequences, take anything.

    Raises:
        UserError: names the value and what would be right.
    """
    found = [_kind(value, each) for each in _parts(hint)]
    if all(right is False for right, _ in found):
        raise UserError(f"{name} takes {' or '.join(told for _, told in found)}, got {value!r}")


def _parts(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) in (Union, types.UnionType) else (hint,)


def _kind(value: Any, hint: Any) -> tuple[bool | None, str]:
    """Whether a value is of a kind, None where that is not checked, and the kind in words."""
    if hint in NUMBERS:
        kind, told = NUMBERS[hint]
        return isinstance(value, kind) and not _is_bool(value) and not math.isnan(float(value)), told
    if hint is bool:
        return _is_bool(value), "True or False"
    if hint is type(None):
        return value is None, "None"
    if typing.get_origin(hint) is Literal:
        return isinstance(value, str) and value in typing.get_args(hint), " or ".join(map(repr, typing.get_args(hint)))
    if typing.get_origin(hint) is tuple and Ellipsis not in typing.get_args(hint):
        kinds = typing.get_args(hint)
        right = isinstance(value, tuple | list) and len(value) == len(kinds)
        right = right and all(_kind(each, kind)[0] is not False for each, kind in zip(value, kinds))
        return right, f"{len(kinds)} numbers" if set(kinds) <= set(NUMBERS) else f"a tuple of {len(kinds)}"
    if isinstance(hint, type) and typing.get_origin(hint) is None and hint is not Any:
        return isinstance(value, hint), "a text" if hint is str else hint.__name__
    if typing.get_origin(hint) is Callable:
        return callable(value), "a function"
    return None, "what its description says"


def _is_bool(value: Any) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")  # NumPy's too, which is not imported here
