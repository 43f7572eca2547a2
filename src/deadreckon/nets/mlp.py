"""Dense networks whose every leaf is an array, so that they can be carried, stacked, saved and vmapped as they are."""

import functools
import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray


@jax.custom_jvp
def softplus(x: Array) -> Array:
    """log(1 + e^x) to 1e-7, in half the time of `jax.nn.softplus`, most of which is spent on its slope."""
    return jnp.maximum(x, 0.0) + jnp.log(1.0 + jnp.exp(-jnp.abs(x)))


@softplus.defjvp
def _(primals, tangents):
    (x,), (tangent,) = primals, tangents
    small = jnp.exp(-jnp.abs(x))
    return softplus(x), tangent * jnp.where(x >= 0, 1.0, small) / (1.0 + small)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "relu": jax.nn.relu,
    "gelu": jax.nn.gelu,
    "tanh": jnp.tanh,
    "swish": jax.nn.swish,
    "softplus": softplus,
}


class Init(NamedTuple):
    """How a network begins.

    Attributes:
        weights: "uniform" in +-1/sqrt(inputs), PyTorch's; "orthogonal" with gain sqrt(2); "glorot", uniform; "lecun", normal
            with variance 1/inputs, cut at two deviations; or "truncated_normal", with deviation 1/(2 sqrt(inputs))
            before it is cut at two deviations (models of PETS and MBPO).
        bias: of all layers but the last one of uniform networks; None: uniform in +-1/sqrt(inputs) as the weights.
        last: bound of the last layer's weights and biases, uniform; None: as the others.
    """

    weights: Literal["uniform", "orthogonal", "glorot", "lecun", "truncated_normal"] = "uniform"
    bias: float | None = None
    last: float | None = None


# The value or logit of an illegal action: no maximum, softmax or draw takes it, and times a probability of zero it is zero.
ILLEGAL = -1e9
UNIFORM, ORTHOGONAL, GLOROT = Init(), Init("orthogonal", 0.0), Init("glorot", 0.0)
LECUN, TRUNCATED = Init("lecun", 0.0), Init("truncated_normal", 0.0)

# By name, of actors and of critics: "rlkit" are those of the codes that descend from it.
FirstWeights = Literal["uniform", "glorot", "orthogonal", "rlkit"]
FIRST_WEIGHTS: dict[FirstWeights, tuple[Init, Init]] = {
    "uniform": (UNIFORM, UNIFORM),
    "glorot": (GLOROT, GLOROT),
    "orthogonal": (ORTHOGONAL, ORTHOGONAL),
    "rlkit": (Init(bias=0.1, last=1e-3), Init(bias=0.1, last=3e-3)),
}


class MLP(eqx.Module):
    """Dense layers on the last axis.

    Attributes:
        weights: one (inputs, outputs) matrix a layer.
        biases: one (outputs,) vector a layer.
        activation: between the layers, a name of `ACTIVATIONS`.
        normalise: whether the units behind each activation are standardised in every row (layer normalisation, whose own
            scale and shift the next layer has already).
        mask: how many of the last inputs are 0 where an output is of an illegal action, whose value or logit is then `ILLEGAL`;
            0: all outputs are free. A multiple of as many outputs is masked part by part.
    """

    weights: tuple[Float[Array, "*stack _ _"], ...]
    biases: tuple[Float[Array, "*stack _"], ...]
    activation: str = eqx.field(static=True, default="relu")
    normalise: bool = eqx.field(static=True, default=False)
    mask: int = eqx.field(static=True, default=0)

    @classmethod
    def create(
        cls, inputs: int, hidden: Sequence[int], outputs: int, key: PRNGKeyArray, *, activation: str = "relu",
        normalise: bool = False, init: Init = UNIFORM, mask: int = 0,
    ) -> "MLP":  # fmt: skip
        """A fresh network; weights and biases are uniform in +-1/sqrt(inputs) unless an agent's authors have it otherwise."""
        sizes = (inputs, *hidden, outputs)
        keys = jax.random.split(key, len(sizes) - 1)
        weights, biases = [], []
        for layer, (k, i, o) in enumerate(zip(keys, sizes, sizes[1:])):
            w, b = _layer(k, i, o, init._replace(last=init.last if layer == len(hidden) else None))
            weights.append(w)
            biases.append(b)
        return cls(tuple(weights), tuple(biases), activation, normalise, mask)

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        """The network's output."""
        out = self.after_first(x @ self.weights[0] + self.biases[0])
        if not self.mask:
            return out
        parts = out.reshape(*out.shape[:-1], -1, self.mask)
        return jnp.where(x[..., None, -self.mask :] > 0.5, parts, ILLEGAL).reshape(out.shape)

    def beside(self, row: Float[Array, "*#n i1"], many: Float[Array, "*#n i2"]) -> Float[Array, "*#n o"]:
        """The output for each of `many`, joined behind its row."""
        # Doing the rows' part of the first layer once saves products of narrow inputs, and costs more than that: its gradient
        # is a sum over `many`, which XLA does slowly on a CPU (measured: 34 ms instead of 14 for 10 actions of 256 rows).
        rows = jnp.broadcast_to(row, (*many.shape[:-1], row.shape[-1]))
        joined = jnp.concatenate([rows, many], -1)
        return self(joined.reshape(-1, joined.shape[-1])).reshape(*many.shape[:-1], -1)

    def after_first(self, pre: Float[Array, "*b h"]) -> Float[Array, "*b o"]:
        """The rest of the network from the first layer's output before its activation."""
        x = pre
        for w, b in zip(self.weights[1:], self.biases[1:]):
            x = ACTIVATIONS[self.activation](x)
            x = (standardised(x) if self.normalise else x) @ w + b
        return x


@functools.partial(jax.jit, static_argnums=(1, 2, 3))  # one program a shape: an operation at a time takes twice as long
def _layer(key: PRNGKeyArray, inputs: int, outputs: int, init: Init) -> tuple[Float[Array, "i o"], Float[Array, "o"]]:
    """Weights and biases of a layer; `init.last` is None in all but the last."""
    k_weights, k_biases = jax.random.split(key)  # both are drawn alike
    bound = _bound(inputs) if init.last is None else init.last
    if init.bias is None or init.last is not None:
        biases = jax.random.uniform(k_biases, (outputs,), minval=-bound, maxval=bound)
    else:
        biases = jnp.full(outputs, init.bias)
    shape = (inputs, outputs)
    if init.weights == "uniform" or init.last is not None:
        return jax.random.uniform(k_weights, shape, minval=-bound, maxval=bound), biases
    if init.weights == "orthogonal":
        return jax.nn.initializers.orthogonal(math.sqrt(2.0))(k_weights, shape), biases
    if init.weights == "glorot":
        return jax.nn.initializers.glorot_uniform()(k_weights, shape), biases
    if init.weights == "lecun":
        return jax.nn.initializers.lecun_normal()(k_weights, shape), biases
    return jax.random.truncated_normal(k_weights, -2.0, 2.0, shape) * bound / 2.0, biases  # "truncated_normal"


def _bound(inputs: int) -> np.float32:
    """1/sqrt(inputs)."""
    return np.float32(1.0) / np.sqrt(np.float32(inputs))


def standardised(x: Float[Array, "*b h"]) -> Float[Array, "*b h"]:
    """Each row less its mean, in its standard deviation."""
    x = x - x.mean(-1, keepdims=True)
    return x * jax.lax.rsqrt(jnp.square(x).mean(-1, keepdims=True) + 1e-6)


FEW = 8  # critics whose least is a chain of comparisons
N = TypeVar("N", bound=eqx.Module)
T = TypeVar("T")


def ensemble(create: Callable[[PRNGKeyArray], N], count: int, key: PRNGKeyArray) -> N:
    """`count` networks stacked along a leading axis, each from its own key."""
    return jax.vmap(create)(jax.random.split(key, count))


def stacks() -> int:
    """Into how many stacks to `split` networks: two on a CPU (more are no faster), one on a GPU, which does all at once."""
    return 2 if jax.default_backend() == "cpu" else 1


def split(stack: T, parts: int) -> tuple[T, ...]:
    """A stack of networks as several, as equal as can be. XLA does products of one stack one after the other on a CPU, those of
    several beside each other, which keeps its cores busier."""
    count = jax.tree.leaves(stack)[0].shape[0]
    ends = [count * i // parts for i in range(parts + 1)]
    return tuple(jax.tree.map(lambda leaf, a=a, b=b: leaf[a:b], stack) for a, b in pairwise(ends) if b > a)


def joined(stacks: Sequence[T]) -> T:
    """What `split` came from."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *stacks)


def q_values(
    critics: MLP, observation: Float[Array, "*#n o"], action: Float[Array, "*#n a"] | Int[Array, "*#n"]
) -> Float[Array, "k *#n"]:
    """Q of every critic of an ensemble, for one action a state or for several (leading axes of `action`).

    Of discrete actions, which are integers, critics have an output each.
    """
    if jnp.issubdtype(action.dtype, jnp.integer):
        return jnp.take_along_axis(all_q_values(critics, observation), action[None, :, None], -1)[..., 0]
    return jax.vmap(lambda net: net.beside(observation, action)[..., 0])(critics)


def all_q_values(critics: MLP, observation: Float[Array, "b o"]) -> Float[Array, "k b n"]:
    """Q of every critic of an ensemble for every discrete action."""
    return jax.vmap(lambda net: net(observation))(critics)


def minimum(values: Float[Array, "k *b"]) -> Float[Array, "*b"]:
    """The smallest along the first axis, with a slope that is always one of theirs.

    The slope of `values.min(0)` divides by how many of `values` equal the smallest. XLA may compute them once more for it, a
    little differently, and then there are none.
    """
    if len(values) > FEW:  # a chain would take long to compile
        which = jax.lax.stop_gradient(values).argmin(0)
        return jnp.take_along_axis(values, which[None], 0)[0]
    return functools.reduce(lambda a, b: jnp.where(a <= b, a, b), values)
