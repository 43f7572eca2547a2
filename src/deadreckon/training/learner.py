"""Learners, which `fit` trains: pure functions with hyperparameters, several of which can share one program."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import on_device

Metrics = dict[str, Array]
L = TypeVar("L", bound=eqx.Module)


class Learner(Protocol):
    """Anything that is trained by updates: agents, behaviour models, value estimates, dynamics ensembles.

    Optional, found by name: `prepare(state, rows, key, fit) -> state`, called on the host before the first update and,
    where the learner has a positive `refresh`, again every `refresh` updates; `fit(learner, steps, key)` trains another learner
    on the same rows and returns its state. `learned(batch) -> batch` changes every training batch, for example the scale of
    rewards.
    """

    def needs(self, spec: Spec) -> BatchSpec:
        """The contents of every batch."""
        ...

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The first state, a pytree of arrays."""
        ...

    def update(self, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> tuple[Any, Metrics]:
        """One pure update. `step` is shared by all lanes; metrics are scalars under fixed names."""
        ...


def lift(learners: Sequence[L]) -> L:
    """One learner whose float fields are (lanes,) arrays; all other fields must agree, as they shape the compiled program.

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
    return jax.tree.map(lambda *values: jax.device_put(np.asarray(values, np.float32)), *map(on_device, learners))


# These work on the host, which compiles nothing; on the device each shape of a leaf would be another program.
def unstack(tree: Any, count: int) -> list[Any]:
    """The parts of a (lanes, ...) tree that belong to each of `count` lanes."""
    host = jax.device_get(tree)
    return [jax.device_put(jax.tree.map(lambda leaf, i=i: leaf[i], host)) for i in range(count)]


def lane_of(tree: Any, index: int) -> Any:
    """The part of a (lanes, ...) tree that belongs to one lane."""
    return jax.device_put(jax.tree.map(lambda leaf: leaf[index], jax.device_get(tree)))


def stack(parts: Sequence[Any]) -> Any:
    """A (lanes, ...) tree of the parts that belong to each lane."""
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *jax.device_get(list(parts))))
