"""What methods share: learners of several networks, gradient ascent on a model of the score, and weights of designs."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets.mlp import MLP, ensemble
from deadreckon.nets.optim import apply_gradients, init_opt

MOST = 5.0  # largest weight of a design


class Surrogate(eqx.Module):
    """The learner: several networks from coordinates to outputs; methods differ in `loss`.

    The rows may have a column `weight` (rows, members), the weight of each design for each network.
    """

    lr: float
    members: int = eqx.field(static=True)
    hidden: tuple[int, ...] = eqx.field(static=True)
    outputs: int = eqx.field(static=True)
    activation: str = eqx.field(static=True)
    batch_size: int = eqx.field(static=True)

    def needs(self, spec):
        """Batches of designs and scores."""
        return BatchSpec(columns=(), batch_size=self.batch_size)

    def init(self, spec, key):
        """Initial networks and their optimiser state."""
        make = lambda k: MLP.create(spec.size, self.hidden, self.outputs, k, activation=self.activation)  # noqa: E731
        nets = ensemble(make, self.members, key)
        return nets, init_opt(nets)

    def update(self, state, batch: Batch, *, step, key):
        """One update of every network."""
        assert batch.extra is not None
        nets, opt = state
        x, y = batch.extra["x"], batch.extra["y"]
        weight = batch.extra["weight"].T if "weight" in batch.extra else jnp.ones((self.members, len(y)))

        def total(nets: MLP) -> tuple[Array, dict[str, Array]]:
            losses, metrics = jax.vmap(lambda net, w: self.loss(net, x, y, w, key))(nets, weight)
            return losses.sum(), jax.tree.map(jnp.mean, metrics)

        grads, metrics = jax.grad(total, has_aux=True)(nets)
        nets, opt = apply_gradients(nets, grads, opt, self.lr)
        return (nets, opt), metrics

    def loss(self, net: MLP, x: Array, y: Array, weight: Array, key: Any) -> tuple[Array, dict[str, Array]]:
        """Loss and metrics of one network on one batch."""
        raise NotImplementedError


@eqx.filter_jit
def climb(
    value: Callable[[Any, Array], Float[Array, "m"]], nets: Any, start: Array, steps: int, lr: Any, low: Array, high: Array
) -> Float[Array, "m z"]:
    """Coordinates after `steps` of plain gradient ascent on `value(nets, x)` for each design of `start`, clipped to bounds."""

    def step(_: Any, x: Array) -> Array:
        slope = jax.grad(lambda x: value(nets, x).sum())(x)
        return jnp.clip(x + lr * slope, low, high)

    return jax.lax.fori_loop(0, steps, step, start)


def score_weights(y: np.ndarray, bins: int, smoothing: float, temperature: float) -> np.ndarray:
    """Weights of designs, larger for high scores (Kumar and Levine 2020, 3.3; Krishnamoorthy et al. 2023, 3.2).

    In a bin with N designs w = N / (N + K) exp(-(best - middle) / T) / N, scaled to the mean 1 and clipped at `MOST`, so that a
    few designs do not dominate.

    Args:
        y: (rows,) scores.
        bins: number of bins of the scores' range.
        smoothing: K, as a share of the rows: sparse bins have smaller weights.
        temperature: T, in ranges of the scores.

    Returns:
        (rows,) float32.
    """
    low, high = float(y.min()), float(y.max())
    u = (y - low) / (high - low)
    which = np.minimum((u * bins).astype(int), bins - 1)
    held = np.bincount(which, minlength=bins)
    worth = held / (held + smoothing * len(y)) * np.exp((np.arange(bins) + 0.5 - bins) / bins / temperature)
    weight = (worth / np.maximum(held, 1))[which]
    return np.minimum(weight / weight.mean(), MOST).astype(np.float32)
