"""What `fit` trains: a pair of pure functions with hyperparameters, and how several of them share one program."""

import dataclasses
import math
import typing
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, PRNGKeyArray

from deadreckon.data.batch import Batch, Needs
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError

Metrics = dict[str, Array]
L = TypeVar("L", bound=eqx.Module)


class Learner(Protocol):
    """Anything iterative: agents, behaviour models, value estimates, dynamics ensembles.

    Optional, found by name: `prepare(state, rows, key, fit) -> state`, called on the host before the first update and,
    where the learner has a positive `refresh`, again every `refresh` updates; `fit(learner, steps, key)` trains another
    learner on the same rows and gives its state.
    """

    def needs(self, spec: Spec) -> Needs:
        """What every batch must hold."""
        ...

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The first state, a pytree of arrays."""
        ...

    def update(self, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> tuple[Any, Metrics]:
        """One pure update. `step` is shared by all lanes; metrics are scalars under fixed names."""
        ...


def static(default: Any) -> Any:
    """A field that is part of the program's shape: not traced, and the same in all lanes of one program."""
    return eqx.field(static=True, default=default)


def described(learner: eqx.Module) -> str:
    """All hyperparameters as text, by which results are told apart; `str` leaves out those that have their default's value."""
    values = ((f.name, getattr(learner, f.name)) for f in dataclasses.fields(learner))
    parts = (f"{name}={described(value) if isinstance(value, eqx.Module) else repr(value)}" for name, value in values)
    return f"{type(learner).__name__}({', '.join(parts)})"


# What hyperparameters may be, by name or by the end of it: names are the field's own, so one table serves every learner.
_RANGES: dict[str, tuple[float, float]] = {
    "lr": (0.0, math.inf), "discount": (0.0, 1.0), "target_rate": (0.0, 1.0), "min_weight": (0.0, 1.0),
    "noise": (0.0, math.inf), "noise_clip": (0.0, math.inf), "alpha": (0.0, math.inf), "multiplier": (0.0, math.inf),
    "temperature": (1e-30, math.inf), "bandwidth": (1e-30, math.inf), "density_clip": (1.0, math.inf),
    "delta": (1e-6, 1.0), "damping": (0.0, math.inf), "ratio_min": (0.0, math.inf), "ratio_max": (0.0, math.inf),
    "warm_start": (0, math.inf), "refresh": (0, math.inf), "range": (-math.inf, math.inf), "confidence": (0.0, 1.0),
    "max_weight": (1e-30, math.inf), "decay": (0.0, math.inf), "penalty": (0.0, math.inf), "atoms": (2, math.inf),
    "logged_rows": (0, math.inf), "familiar": (0.0, 1.0), "conservatism": (0.0, math.inf),
    "horizon": (0, math.inf), "trace": (0.0, 1.0), "clip": (0.0, math.inf), "smoothing": (0.0, 1.0), "norm": (1e-30, math.inf),
    "pretrain": (0, math.inf), "weight": (0.0, math.inf), "bins": (2, math.inf), "expectile": (1e-6, 1.0),
    "sharpness": (0.0, math.inf), "reach": (0.0, math.inf), "diversity": (0.0, math.inf),
    "gap": (0.0, math.inf), "threshold": (0.0, math.inf), "margin": (0.0, math.inf), "kl": (0.0, math.inf),
    "share": (1e-6, 1.0), "dropout": (0.0, 1.0 - 1e-6), "warm_up": (1, math.inf),
    "regularisation": (0.0, math.inf), "imitation": (0.0, math.inf), "exponent": (1.0 + 1e-6, math.inf),
}  # fmt: skip


def _range(name: str, kind: type) -> tuple[float, float]:
    found = _RANGES.get(name) or _RANGES.get(name.rpartition("_")[2])
    return found or ((1, math.inf) if kind is int else (-math.inf, math.inf))


def _check(name: str, field: str, value: Any, kind: Any) -> None:
    if kind not in (int, float):
        return
    low, high = _range(field, kind)
    what = "a whole number" if kind is int else "a finite number"
    right = isinstance(value, int if kind is int else (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not right or not low <= value <= high:
        bounds = (f" >= {low:g}" if low > -math.inf else "") + (f" and <= {high:g}" if high < math.inf else "")
        raise UserError(f"{name} takes {what}{bounds}, got {value!r}")


def check_fields(learner: eqx.Module) -> None:
    """Refuses hyperparameters of the wrong type or size before anything is compiled. None passes where it is allowed.

    Raises:
        UserError: names the field and what it takes.
    """
    hints = typing.get_type_hints(type(learner))
    for f in dataclasses.fields(learner):
        value, hint = getattr(learner, f.name), hints[f.name]
        name = f"{type(learner).__name__}.{f.name}"
        arguments = typing.get_args(hint)
        if type(None) in arguments:
            if value is None:
                continue
            hint = next(a for a in arguments if a is not type(None))
            arguments = typing.get_args(hint)
        if typing.get_origin(hint) is typing.Literal and value not in arguments:
            raise UserError(f"{name} takes {' or '.join(map(repr, arguments))}, got {value!r}")
        if typing.get_origin(hint) is tuple:
            if not isinstance(value, tuple):
                raise UserError(f"{name} takes a tuple of numbers, got {value!r}")
            for entry in value:
                _check(name, f.name, entry, arguments[0])
                if entry <= 0 and f.name.rpartition("_")[2] != "range":
                    raise UserError(f"{name} takes numbers above 0, got {value!r}")
        else:
            _check(name, f.name, value, hint)


def lift(learners: Sequence[L]) -> L:
    """One learner whose float fields are (lanes,) arrays; all other fields must agree, they are the program's shape.

    Raises:
        UserError: a field that is not a float differs between the learners.
    """
    first = learners[0]
    for other in learners[1:]:
        if type(other) is not type(first):
            raise UserError(f"lanes of one program must be of one type, got {type(first).__name__}, {type(other).__name__}")
        for f in dataclasses.fields(first):
            one, two = getattr(first, f.name), getattr(other, f.name)
            if (one is None) != (two is None) or (f.metadata.get("static") and one != two):
                raise UserError(f"{type(first).__name__}.{f.name} shapes the program and must be the same in all lanes")
    return jax.tree.map(lambda *values: jnp.asarray(values, jnp.float32), *learners)
