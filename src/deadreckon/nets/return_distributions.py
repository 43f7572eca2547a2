"""Distributions of returns by probabilities of fixed atoms (C51, Bellemare et al. 2017)."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def support(low: Any, high: Any, atoms: int) -> Float[Array, "z"]:
    """Evenly spaced returns from `low` to `high`."""
    return low + (high - low) * jnp.linspace(0.0, 1.0, atoms)


def project(
    probabilities: Float[Array, "*n b z"], reward: Float[Array, "b"], discount: Float[Array, "b"], atoms: Float[Array, "z"]
) -> Float[Array, "*n b z"]:
    """The distribution of r + discount Z on Z's own atoms: what falls between two of them is shared by nearness."""
    moved = jnp.clip(reward[:, None] + discount[:, None] * atoms, atoms[0], atoms[-1])
    share = jnp.clip(1.0 - jnp.abs(moved[:, None, :] - atoms[:, None]) / (atoms[1] - atoms[0]), 0.0, 1.0)  # (b, to, from)
    return jnp.einsum("btf,...bf->...bt", share, probabilities)


def cross_entropy(logits: Float[Array, "*b z"], target: Float[Array, "*b z"]) -> Float[Array, "*b"]:
    """-sum_z target_z log p_z; the target has no slope."""
    return -(jax.lax.stop_gradient(target) * jax.nn.log_softmax(logits)).sum(-1)


def mean(logits: Float[Array, "*b z"], atoms: Float[Array, "z"]) -> Float[Array, "*b"]:
    """The expected return."""
    return (jnp.exp(jax.nn.log_softmax(logits)) * atoms).sum(-1)
