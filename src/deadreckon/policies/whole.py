"""Whether the parts of a policy that a file names are of the right kinds and fit together, before it is asked for an action."""

import dataclasses
import functools
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, Union

import equinox as eqx
import jax
import jax.numpy as jnp

from deadreckon.errors import UserError, as_one_line
from deadreckon.foreign.shapes import words
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.mlp import MLP
from deadreckon.policies.deployed import History, Mixture, Seeing, first_actions
from deadreckon.policies.file import ROWS, observation_sizes
from deadreckon.policies.portable import KINDS

_SCALARS = (int, float, str, bool, type(None))


def check_whole(path: Path | str, policy: Any) -> None:
    """Refuses a policy that cannot act.

    Args:
        path: of its file, for errors.
        policy: an `EnvPolicy`.

    Raises:
        UserError: names the field that is of another kind; or says that the parts do not fit together.
    """
    _check(path, policy, "policy")
    _check_together(path, policy)


def _check_together(path: Path | str, policy: Any) -> None:
    """Refuses a policy whose parts do not fit together."""
    if isinstance(policy.inner, Mixture | History):
        for member in policy.inner.members if isinstance(policy.inner, Mixture) else (policy.inner.member,):
            _check_together(path, member)
        return
    if isinstance(policy.inner, Seeing):
        _check_together(path, policy.inner.member)
        _check_encoder(path, policy)
        return
    ends = ((net.weights[0].shape[-2], net.weights[-1].shape[-1]) for net in _networks(policy) if net.weights)
    shapes = [policy.mean.shape] if policy.mean is not None else [(size,) for size in observation_sizes(ends)]
    error = None
    for shape in shapes if type(policy.inner).__name__ in KINDS else ():  # others take more than an observation, or draw long
        try:
            _try(policy, shape, jnp.float32)
        except Exception as found:  # noqa: BLE001 - whatever arrays of wrong shapes make JAX raise
            error = error or found
        else:
            return
    if error is not None:
        raise UserError(f"{path}: the parts of its policy do not fit together ({as_one_line(error)})") from error


def _check_encoder(path: Path | str, policy: Any) -> None:
    """Refuses a policy on pictures that cannot act on those of its encoder's shape."""
    try:
        _try(policy, policy.inner.encoder.shape, jnp.uint8)
    except Exception as found:
        raise UserError(f"{path}: the parts of its policy do not fit together ({as_one_line(found)})") from found


def _try(policy: Any, shape: tuple[int, ...], kind: Any) -> None:
    """Traces actions on different numbers of observations, since a layer may fit one number of them alone."""
    for rows in ROWS:
        seen = jax.ShapeDtypeStruct((rows, *shape), kind)
        action = jax.eval_shape(lambda one: first_actions(policy, one, jax.random.key(0), True), seen)
        if action.shape[0] != rows:
            raise ValueError(f"{rows} observations give {action.shape[0]} actions")


def _networks(part: Any) -> Iterator[MLP | LayerNormMLP]:
    if isinstance(part, MLP | LayerNormMLP):
        yield part
    elif dataclasses.is_dataclass(part):
        for field in dataclasses.fields(part):
            yield from _networks(getattr(part, field.name))
    elif isinstance(part, tuple):
        for each in part:
            yield from _networks(each)


def _check(path: Path | str, value: Any, name: str) -> None:
    hints = _hints(type(value))
    for field in dataclasses.fields(value):
        part, hint = getattr(value, field.name), hints[field.name]
        if not _fits(part, hint):
            shown = type(part).__name__ if not isinstance(part, _SCALARS) else f"{part!r:.60}"
            raise UserError(f"{path}: {name}.{field.name} must be {_words(hint)}, got {shown}; the file is damaged")
        for number, each in enumerate(part if isinstance(part, tuple) else (part,)):
            if isinstance(each, eqx.Module):
                _check(path, each, f"{name}.{field.name}" + (f"[{number}]" if isinstance(part, tuple) else ""))


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _fits(value: Any, hint: Any) -> bool:
    origin = typing.get_origin(hint)
    if hint is Any:
        return True
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in typing.get_args(hint))
    if origin is tuple:
        parts = typing.get_args(hint)
        if not isinstance(value, tuple):
            return False
        kinds = [parts[0]] * len(value) if Ellipsis in parts else parts
        return len(kinds) == len(value) and all(map(_fits, value, kinds))
    if origin is Literal:
        return isinstance(value, str) and value in typing.get_args(hint)
    if hint is int:
        return type(value) is int and abs(value) < 2**31
    if hint is float:
        return isinstance(value, float | int | jax.Array) and not isinstance(value, bool)
    if hint in (str, bool, type(None)):
        return type(value) is hint
    if origin is Callable or not isinstance(hint, type):
        return True
    if _of_arrays(hint):
        return isinstance(value, jax.Array) and value.dtype.kind in "fiub"
    return isinstance(value, hint)


def _of_arrays(hint: Any) -> bool:
    return hint is jax.Array or hasattr(hint, "array_type")  # jaxtyping's


def _words(hint: Any) -> str:
    if typing.get_origin(hint) in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_words, typing.get_args(hint))))
    if typing.get_origin(hint) is tuple:
        return "a list"
    if isinstance(hint, type) and issubclass(hint, eqx.Module):
        return f"of the kind {hint.__name__}"
    return "an array of numbers" if _of_arrays(hint) else words(hint)
