"""The network of D4PG, CRR-D and FQE-D: that of DeepMind's Acme (Hoffman et al. 2020, `LayerNormMLP`) but for first weights."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray


class LayerNormMLP(eqx.Module):
    """Dense layers; the first is normalised and goes through a tanh, the others through an ELU (Acme's LayerNormMLP)."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    gain: Array
    shift: Array

    @classmethod
    def create(cls, sizes: tuple[int, ...], key: PRNGKeyArray, last: float = 1.0) -> "LayerNormMLP":
        """Uniform in +-1/sqrt(inputs), in the last layer times `last`, with zero biases."""
        keys = jax.random.split(key, len(sizes) - 1)
        weights = tuple(
            jax.random.uniform(k, (i, o), minval=-1.0, maxval=1.0) / jnp.sqrt(i) for k, i, o in zip(keys, sizes, sizes[1:])
        )
        weights = (*weights[:-1], last * weights[-1])
        first = sizes[1] if len(sizes) > 2 else 0
        return cls(weights, tuple(jnp.zeros(o) for o in sizes[1:]), jnp.ones(first), jnp.zeros(first))

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        """The network's output."""
        last = len(self.weights) - 1
        for i, (w, b) in enumerate(zip(self.weights, self.biases)):
            x = x @ w + b
            if i == last:
                break
            if i == 0:
                x = (x - x.mean(-1, keepdims=True)) * jax.lax.rsqrt(x.var(-1, keepdims=True) + 1e-5)
                x = jnp.tanh(x * self.gain + self.shift)
            else:
                x = jax.nn.elu(x)
        return x
