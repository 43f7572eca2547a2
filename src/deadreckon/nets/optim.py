"""Optimiser steps whose learning rate may be traced, and target networks."""

from typing import Any

import jax
import jax.numpy as jnp
import optax

ADAM = optax.scale_by_adam()


def begin(params: Any) -> optax.OptState:
    """Adam's state before the first step."""
    return ADAM.init(params)


def descend(params: Any, grads: Any, opt: optax.OptState, lr: Any) -> tuple[Any, optax.OptState]:
    """One Adam step (beta 0.9 and 0.999, epsilon 1e-8). `lr` may differ along a vmapped axis."""
    updates, opt = ADAM.update(grads, opt)
    return jax.tree.map(lambda p, u: p - lr * u, params, updates), opt


def clipped(grads: Any, norm: Any) -> Any:
    """Gradients, all made shorter by one factor where together they are longer than `norm`."""
    length = optax.tree.norm(grads)
    return jax.tree.map(lambda g: g * jnp.minimum(1.0, norm / (length + 1e-12)), grads)


def track(target: Any, online: Any, rate: Any) -> Any:
    """Polyak averaging: target <- (1 - rate) target + rate online."""
    return jax.tree.map(lambda t, o: t + rate * (o - t), target, online)


def copy(tree: Any) -> Any:
    """Arrays of their own, so that a target network is never an alias of the online one."""
    return jax.tree.map(jnp.copy, tree)
