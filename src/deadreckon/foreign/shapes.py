"""Declared shapes of JSON values, checked before anything looks into them.

A shape is what annotations say: `TypedDict` classes for objects (`NotRequired` keys may be absent, further keys are kept) and
dataclasses (fields with defaults may be absent, further keys are refused),
`list[X]`, `dict[str, X]`, `tuple[X, Y]` for lists of a fixed length, `X | None`, `Literal`, `int`, `float`, `bool`, `str` and
`Any`.
"""

import dataclasses
import functools
import operator
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NotRequired, Required, Union

from deadreckon.errors import UserError, unknown

_WORDS: dict[Any, str] = {int: "a whole number", float: "a number", bool: "true or false", str: "a text", type(None): "null"}
_OBJECTS, _LISTS = (dict, Mapping), (list, Sequence)
_CONTAINERS = (*_OBJECTS, *_LISTS)
_LEAST, _MOST = -(2**63), 2**64  # of whole numbers: those that arrays hold


def checked(value: Any, shape: Any, path: Path | str) -> Any:
    """`value`, if it has a shape.

    Args:
        value: of JSON's types.
        shape: see the module.
        path: of the file that it is from, for the error.

    Raises:
        UserError: names the file, the field and what it must be.
    """
    _check(value, shape, path, "")
    return value


def wrong(path: Path | str, field: str, needed: str, value: Any) -> UserError:
    """The error for a field that is not what it must be."""
    shown = f"{value!r:.60}" if not isinstance(value, dict | list) else f"{_named(value)} of {len(value)}"
    place = f"{path}: {field}" if field else f"{path}: what it holds"
    return UserError(f"{place} must be {needed}, got {shown}")


def same_length(path: Path | str, field: str, values: Any, count: int) -> None:
    """Refuses a list of another length than `count`."""
    if len(values) != count:
        raise wrong(path, field, f"a list of {count}", values)


def _check(value: Any, shape: Any, path: Path | str, field: str) -> None:
    if shape is Any:
        return
    origin = typing.get_origin(shape)
    if origin in (Union, types.UnionType):
        return _check_union(value, shape, path, field)
    if origin in (NotRequired, Required):
        return _check(value, typing.get_args(shape)[0], path, field)
    if not _fits(value, shape):
        raise wrong(path, field, words(shape), value)
    if dataclasses.is_dataclass(shape):
        known = [each.name for each in dataclasses.fields(shape)]
        if odd := [key for key in value if key not in known]:
            raise UserError(f"{path}: {field or 'it'}: {unknown('entry', odd[0], known)}")
    if typing.is_typeddict(shape) or dataclasses.is_dataclass(shape):
        for key, (part, needed) in _fields(shape).items():
            if key in value:
                # A field of a dataclass that may be left out: null is not among what its error proposes (TOML has none).
                part = part if needed or typing.is_typeddict(shape) or value[key] is None else _without_null(part)
                _check(value[key], part, path, f"{field}.{key}" if field else key)
            elif needed:
                raise UserError(f"{path}: {field or 'it'} lacks {key}")
    elif origin in _CONTAINERS or _endless(shape):
        part = typing.get_args(shape)[0 if _endless(shape) else -1]
        if part is not Any:
            for key, each in value.items() if isinstance(value, dict) else enumerate(value):
                _check(each, part, path, f"{field}[{key!r:.40}]" if isinstance(value, dict) else f"{field}[{key}]")
    elif origin is tuple:
        for key, (each, part) in enumerate(zip(value, typing.get_args(shape), strict=True)):
            _check(each, part, path, f"{field}[{key}]")


def _check_union(value: Any, shape: Any, path: Path | str, field: str) -> None:
    """The kind of value says which of the shapes is meant, so that an error within it can be told."""
    fitting = [each for each in typing.get_args(shape) if _fits(value, each)]
    if not fitting:
        raise wrong(path, field, words(shape), value)
    for number, each in enumerate(fitting, 1):
        try:
            return _check(value, each, path, field)
        except UserError:
            if number == len(fitting):
                raise


def _fits(value: Any, shape: Any) -> bool:
    """Whether the kind of a value is right; what it holds is looked at afterwards."""
    origin = typing.get_origin(shape)
    if shape is Any:
        return True
    if shape is int:
        return type(value) is int and _LEAST <= value < _MOST
    if shape is float:
        return type(value) is float or (type(value) is int and abs(value) < 1e300)
    if origin is Literal:
        return any(value == each and type(value) is type(each) for each in typing.get_args(shape))
    if typing.is_typeddict(shape) or dataclasses.is_dataclass(shape) or origin in _OBJECTS or shape is dict:
        return isinstance(value, dict)
    if origin in _LISTS or shape is list or _endless(shape):
        return isinstance(value, list)
    if origin is tuple:
        return isinstance(value, list) and len(value) == len(typing.get_args(shape))
    return type(value) is (type(None) if shape is None else shape)


def words(shape: Any) -> str:
    """What a shape asks for."""
    origin, parts = typing.get_origin(shape), typing.get_args(shape)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(words, parts)))
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if origin in _LISTS or shape is list or _endless(shape):
        if not parts or parts[0] is Any:
            return "a list"
        return f"a list of {_WORDS[parts[0]].removeprefix('a ')}s" if parts[0] in _WORDS else "a list of entries"
    if origin is tuple:
        return f"a list of {len(parts)}"
    return _WORDS.get(shape, "an object")


def _without_null(shape: Any) -> Any:
    if typing.get_origin(shape) not in (Union, types.UnionType):
        return shape
    return functools.reduce(operator.or_, (part for part in typing.get_args(shape) if part is not type(None)))


def _endless(shape: Any) -> bool:
    return typing.get_origin(shape) is tuple and Ellipsis in typing.get_args(shape)


def _named(value: Any) -> str:
    return "an object" if isinstance(value, dict) else "a list"


@functools.cache
def _fields(shape: Any) -> dict[str, tuple[Any, bool]]:
    """{key: (shape, whether it is needed)}"""
    hints = typing.get_type_hints(shape)
    if dataclasses.is_dataclass(shape):
        missing = dataclasses.MISSING
        bare = [each for each in dataclasses.fields(shape) if each.default is missing and each.default_factory is missing]
        needed = {each.name for each in bare}
    else:
        needed = shape.__required_keys__
    return {key: (hint, key in needed) for key, hint in hints.items()}
