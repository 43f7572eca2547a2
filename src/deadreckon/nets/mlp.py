"""Dense networks whose every leaf is an array, so that they can be carried, stacked, saved and vmapped as they are."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "relu": jax.nn.relu,
    "tanh": jnp.tanh,
    "swish": jax.nn.swish,
    "softplus": jax.nn.softplus,
}


class MLP(eqx.Module):
    """Dense layers on the last axis.

    Attributes:
        weights: one (inputs, outputs) matrix a layer.
        biases: one (outputs,) vector a layer.
        activation: between the layers, a name of `ACTIVATIONS`.
    """

    weights: tuple[Float[Array, "i o"], ...]
    biases: tuple[Float[Array, "o"], ...]
    activation: str = eqx.field(static=True, default="relu")

    @classmethod
    def create(
        cls, inputs: int, hidden: Sequence[int], outputs: int, key: PRNGKeyArray, *, activation: str = "relu"
    ) -> "MLP":
        """Weights and biases uniform in +-1/sqrt(inputs), the initialisation of the published agents."""
        sizes = (inputs, *hidden, outputs)
        keys = jax.random.split(key, len(sizes) - 1)
        weights, biases = [], []
        for k, i, o in zip(keys, sizes, sizes[1:]):
            kw, kb = jax.random.split(k)
            bound = 1.0 / jnp.sqrt(i)
            weights.append(jax.random.uniform(kw, (i, o), minval=-bound, maxval=bound))
            biases.append(jax.random.uniform(kb, (o,), minval=-bound, maxval=bound))
        return cls(tuple(weights), tuple(biases), activation)

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        """The network's output."""
        return self.after_first(x @ self.weights[0] + self.biases[0])

    def after_first(self, pre: Float[Array, "*b h"]) -> Float[Array, "*b o"]:
        """The rest of the network from the first layer's output before its activation."""
        x = pre
        for w, b in zip(self.weights[1:], self.biases[1:]):
            x = ACTIVATIONS[self.activation](x) @ w + b
        return x


N = TypeVar("N", bound=eqx.Module)


def ensemble(create: Callable[[PRNGKeyArray], N], count: int, key: PRNGKeyArray) -> N:
    """`count` networks stacked along a leading axis, each from its own key."""
    return jax.vmap(create)(jax.random.split(key, count))


def q_values(
    critics: MLP, observation: Float[Array, "b o"], action: Float[Array, "*n b a"]
) -> Float[Array, "k *n b"]:
    """Q of every critic of an ensemble, for one action a state or for several (leading axes of `action`).

    The first layer's product with the observations is done once, however many actions are asked for.
    """
    size = observation.shape[-1]

    def one(net: MLP) -> Array:
        # One action a state: a single product of the joined input is the cheaper form.
        if action.ndim == observation.ndim:
            return net(jnp.concatenate([observation, action], -1))[..., 0]
        pre = observation @ net.weights[0][:size] + net.biases[0] + action @ net.weights[0][size:]
        return net.after_first(pre)[..., 0]

    return jax.vmap(one)(critics)
