"""Optimiser steps whose learning rate may be traced, and target networks."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.core import Tracer
from jaxtyping import Array

ADAM = optax.scale_by_adam()


def init_opt(params: Any) -> optax.OptState:
    """Adam's state before the first step, all of it zeros."""
    if _traced(params):
        return ADAM.init(params)
    moments = [jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), params) for _ in range(2)]
    return jax.device_put(optax.ScaleByAdamState(np.zeros((), np.int32), *moments))


def apply_gradients(
    params: Any, grads: Any, opt: optax.OptState, lr: Any, weight_decay: Any = None
) -> tuple[Any, optax.OptState]:
    """One step of Adam (beta 0.9 and 0.999, epsilon 1e-8), or of AdamW with a decoupled decay of the parameters.

    Args:
        params: before the step.
        grads: of the loss.
        opt: state of the optimiser.
        lr: learning rate; may differ along a vmapped axis.
        weight_decay: share of the parameters, in learning rates, that a step takes away; None: nothing.
    """
    updates, opt = ADAM.update(grads, opt)
    new = jax.tree.map(lambda p, u: p - lr * u, params, updates)
    if weight_decay is not None:
        new = jax.tree.map(lambda n, p: n - lr * weight_decay * p, new, params)
    return new, opt


def cosine_decay(lr: Any, step: Array, steps: Any) -> Array:
    """A learning rate that falls to 0 along half a cosine over `steps` updates (Loshchilov and Hutter 2017); 0: it is constant.

    As `optax.cosine_decay_schedule`, for numbers of updates that may be traced.
    """
    share = jnp.clip(step / jnp.maximum(steps, 1.0), 0.0, 1.0)
    return jnp.where(jnp.asarray(steps) > 0, lr * 0.5 * (1.0 + jnp.cos(jnp.pi * share)), lr)


def clip_by_norm(grads: Any, norm: Any) -> Any:
    """Gradients, all made shorter by one factor where together they are longer than `norm`."""
    length = optax.tree.norm(grads)
    return jax.tree.map(lambda g: g * jnp.minimum(1.0, norm / (length + 1e-12)), grads)


def polyak_update(target: Any, online: Any, rate: Any) -> Any:
    """Polyak averaging: target <- (1 - rate) target + rate online."""
    return jax.tree.map(lambda t, o: t + rate * (o - t), target, online)


def renewed(target: Any, online: Any, step: Array, period: int) -> Any:
    """Target networks that are copied from the online ones at the end of every `period` updates, and rest in between."""
    over = (step + 1) % period == 0
    return jax.tree.map(lambda t, o: jnp.where(over, o, t), target, online)


def copy(tree: Any) -> Any:
    """Arrays of their own, so that a target network is never an alias of the online one."""
    return jax.tree.map(jnp.copy, tree) if _traced(tree) else jax.device_put(jax.tree.map(np.array, tree))


def _traced(tree: Any) -> bool:
    """Whether a program is being made. Where not, zeros and copies come from the host: on the device each shape compiles."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))
