"""Networks of all policies at once: stacked (members, policies, ...), fed the same rows, and what they say about actions.

With continuous actions a network sees (observation, action) and has one output; with discrete ones it sees the observation
and has an output an action.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.spec import Spec
from deadreckon.data.view import View
from deadreckon.nets.mlp import MLP, ensemble

BLOCK = 512  # rows at a time: with 11 policies, 10 samples and 256 units, hidden layers of 60 MB


def create(spec: Spec, hidden: tuple[int, ...], members: int, policies: int, key: PRNGKeyArray) -> MLP:
    """Fresh networks (members, policies, ...)."""
    inputs = spec.observation_size + (0 if spec.discrete else spec.action_size)
    make = lambda k: MLP.create(inputs, hidden, spec.action_size if spec.discrete else 1, k)  # noqa: E731
    return ensemble(lambda k: ensemble(make, policies, k), members, key)


def taken(critics: MLP, observation: Float[Array, "b o"], action: Array) -> Float[Array, "m p b"]:
    """Every critic's value of one action a row, the same for all critics."""
    if action.ndim == 1:
        out = _each(critics, observation)
        return jnp.take_along_axis(out, action[None, None, :, None], -1)[..., 0]
    return _each(critics, jnp.concatenate([observation, action], -1))[..., 0]


def expected(
    critics: MLP, observation: Float[Array, "b o"], table: Array, through: Callable[[Array], Array] = lambda x: x
) -> Float[Array, "m p b"]:
    """Every critic's mean value over what its policy does, of a table (b, policies, samples, size) or (b, policies, n).

    `through` is applied to the networks' outputs before the mean.
    """
    if table.ndim == 3:
        return jnp.einsum("mpbn,bpn->mpb", through(_each(critics, observation)), table)

    def one(net: MLP, own: Float[Array, "b s a"]) -> Float[Array, "b"]:
        # The first layer's product with the observations is done once, however many samples there are.
        size = observation.shape[-1]
        if own.shape[1] == 1:
            return through(net(jnp.concatenate([observation, own[:, 0]], -1))[..., 0])
        pre = (observation @ net.weights[0][:size] + net.biases[0])[:, None] + own @ net.weights[0][size:]
        return through(net.after_first(pre)[..., 0]).mean(1)

    return jax.vmap(lambda member: jax.vmap(one, (0, 1))(member, table))(critics)


def _each(critics: MLP, inputs: Float[Array, "b i"]) -> Float[Array, "m p b o"]:
    return jax.vmap(jax.vmap(lambda net: net(inputs)))(critics)


_expected, _taken = jax.jit(expected), jax.jit(taken)


class Fitted(NamedTuple):
    """Critics that have been fitted, on the scale of returns.

    Attributes:
        critics: (members, policies, ...).
        unit: what their 1 stands for.
        view: the coordinates of their inputs.
    """

    critics: MLP
    unit: float
    view: View

    def values(self, observations: Any, table: np.ndarray) -> np.ndarray:
        """(members, policies, rows) values of states, of raw observations and what the policies do there."""
        return self._of(_expected, observations, table)

    def of_actions(self, observations: Any, actions: np.ndarray) -> np.ndarray:
        """(members, policies, rows) values of the environment's actions."""
        return self._of(_taken, observations, np.asarray(self.view.to_unit(np.asarray(actions))))

    def _of(self, function: Any, observations: Any, other: np.ndarray) -> np.ndarray:
        of = lambda seen, part: function(self.critics, self.view.observe(seen), part)  # noqa: E731
        return self.unit * in_blocks(of, observations, other)


def in_blocks(function: Callable[..., Any], *columns: Any) -> np.ndarray:
    """`function` of columns, a block of rows at a time; rows are the last axis of what it gives.

    All blocks have the same shape, so that one compiled program serves.
    """
    rows = len(columns[0])
    size = min(BLOCK, 1 << (rows - 1).bit_length())
    out: np.ndarray | None = None
    for start in range(0, rows, size):
        parts = [np.asarray(column[start : start + size]) for column in columns]
        count = len(parts[0])
        if count < size:
            parts = [np.concatenate([part, np.repeat(part[-1:], size - count, 0)]) for part in parts]
        found = np.asarray(function(*parts))[..., :count]
        if out is None:
            out = np.empty((*found.shape[:-1], rows), np.float32)
        out[..., start : start + count] = found
    assert out is not None
    return out
