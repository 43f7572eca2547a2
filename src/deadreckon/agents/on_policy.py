"""Shared code of on-policy agents: statistics of their last steps, values and advantages."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.agent import traced_advantage
from deadreckon.data.normalizer import STD_FLOOR
from deadreckon.nets.mlp import MLP


class Moments(NamedTuple):
    """Mean, variance and number of all that was seen so far."""

    mean: Array
    variance: Array
    number: Array

    @classmethod
    def none(cls, *shape: int) -> "Moments":
        """Before anything was seen: mean 0 and variance 1."""
        return cls(jnp.zeros(shape), jnp.ones(shape), jnp.float32(0.0))

    def seeing(self, rows: Float[Array, "n *s"]) -> "Moments":
        """With some more rows (Chan et al. 1979)."""
        n = self.number + len(rows)
        gap = rows.mean(0) - self.mean
        spread = self.variance * self.number + rows.var(0) * len(rows) + jnp.square(gap) * self.number * len(rows) / n
        return Moments(self.mean + gap * len(rows) / n, spread / n, n)

    @property
    def deviation(self) -> Array:
        """One for what hardly moves."""
        std = jnp.sqrt(self.variance)
        return jnp.where(std < STD_FLOOR, 1.0, std)


def folded(net: MLP, seen: Moments) -> MLP:
    """The network on raw observations that does what `net` does on standardised ones."""
    first = net.weights[0] / seen.deviation[:, None]
    return MLP((first, *net.weights[1:]), (net.biases[0] - seen.mean @ first, *net.biases[1:]), net.activation)


def scaled_value(critic: MLP, observations: Moments, returns: Moments, observation: Float[Array, "*b o"]) -> Float[Array, "*b"]:
    """A critic of standardised observations that speaks in units of the returns, on raw ones and in returns."""
    return returns.mean + returns.deviation * folded(critic, observations)(observation)[..., 0]


def advantages(
    value: Callable[[Array], Array], rows: dict[str, Float[Array, "t c *s"]], discount: Any, trace: Any
) -> tuple[Float[Array, "t c"], Float[Array, "t c"]]:
    """Generalised advantages (Schulman et al. 2016), and the returns that a critic is to learn.

    Args:
        value: of observations.
        rows: steps of several copies: observation, reward, next_observation, terminal and timeout.
        discount: per step.
        trace: lambda: 0 trusts the critic, 1 the returns.
    """
    now, following = value(rows["observation"]), value(rows["next_observation"])
    error = rows["reward"] + discount * (1.0 - rows["terminal"]) * following - now
    goes_on = 1.0 - jnp.maximum(rows["terminal"], rows["timeout"])
    advantage = traced_advantage(error, goes_on, discount * trace)
    return advantage, advantage + now
