"""Action distributions as pure functions of a network's output. All densities are over actions in (-1, 1)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0  # those of the common SAC codes; outside, densities overflow float32


class Gaussian(NamedTuple):
    """A diagonal Gaussian before the tanh: `mean` and `log_std`, (*b, a)."""

    mean: Float[Array, "*b a"]
    log_std: Float[Array, "*b a"]


def gaussian_head(output: Float[Array, "*b o"], low: float = LOG_STD_MIN, high: float = LOG_STD_MAX) -> Gaussian:
    """Splits a network's output into mean and log standard deviation, clipped to `low` .. `high`."""
    mean, log_std = jnp.split(output, 2, axis=-1)
    return Gaussian(mean, jnp.clip(log_std, low, high))


def sample(d: Gaussian, key: PRNGKeyArray, count: tuple[int, ...] = ()) -> Float[Array, "*nb a"]:
    """Reparameterised draws BEFORE the tanh, `count` of them along new leading axes."""
    noise = jax.random.normal(key, (*count, *d.mean.shape))
    return d.mean + jnp.exp(d.log_std) * noise


def log_prob(d: Gaussian, pre: Float[Array, "*nb a"]) -> Float[Array, "*nb"]:
    """Log-density of the action tanh(pre), from the value before the tanh (so that nothing saturates).

    log N(pre; mean, std) - sum log(1 - tanh(pre)^2), the second term as 2 (log 2 - x - softplus(-2x)).
    """
    z = (pre - d.mean) * jnp.exp(-d.log_std)
    normal = -0.5 * jnp.square(z) - d.log_std - 0.5 * jnp.log(2 * jnp.pi)
    squash = 2.0 * (jnp.log(2.0) - pre - jax.nn.softplus(-2.0 * pre))
    return (normal - squash).sum(-1)


def kl(p: Gaussian, q: Gaussian) -> Float[Array, "*b"]:
    """KL(p || q) of the two diagonal Gaussians; the tanh, a bijection that both share, leaves it unchanged."""
    ratio = jnp.square(jnp.exp(p.log_std - q.log_std))
    shift = jnp.square((p.mean - q.mean) * jnp.exp(-q.log_std))
    return 0.5 * (ratio + shift - 1.0).sum(-1) + (q.log_std - p.log_std).sum(-1)
