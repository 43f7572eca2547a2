"""What `fit` trains: a pair of pure functions with hyperparameters, and how several of them share one program."""

import dataclasses
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


def check_fields(learner: eqx.Module) -> None:
    """Refuses hyperparameters of the wrong type or sign before anything is compiled.

    Raises:
        UserError: names the field and what it takes.
    """
    hints = typing.get_type_hints(type(learner))
    for f in dataclasses.fields(learner):
        value, hint = getattr(learner, f.name), hints[f.name]
        name = f"{type(learner).__name__}.{f.name}"
        if hint is float and (isinstance(value, bool) or not isinstance(value, (int, float)) or not jnp.isfinite(value)):
            raise UserError(f"{name} takes a finite number, got {value!r}")
        if hint is int and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
            raise UserError(f"{name} takes a whole number >= 0, got {value!r}")
        if typing.get_origin(hint) is typing.Literal and value not in typing.get_args(hint):
            raise UserError(f"{name} takes {' or '.join(map(repr, typing.get_args(hint)))}, got {value!r}")


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
            if f.metadata.get("static") and getattr(other, f.name) != getattr(first, f.name):
                raise UserError(f"{type(first).__name__}.{f.name} shapes the program and must be the same in all lanes")
    return jax.tree.map(lambda *values: jnp.asarray(values, jnp.float32), *learners)
