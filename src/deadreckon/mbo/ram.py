"""RaM: models trained to rank (Tan et al. 2025).

Gradient ascent needs only the order of designs, not their scores; so lists of designs are drawn from the data, and the model is
trained to rank them (ListNet's cross-entropy). Its output is then standardised over the data, so that the step size is
comparable to that of other methods.
"""

from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.mbo.designer import Designer, DesignInput, Proposals, starts
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.surrogate import Surrogate, climb
from deadreckon.nets.mlp import MLP
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static


class Ranking(Surrogate):
    """The learner: a network whose softmax over a batch approximates that of the scores."""

    def loss(self, net: MLP, x, y, weight, key):
        """ListNet's loss: cross-entropy between the softmaxes of scores and outputs over a batch, which is one list."""
        wanted = jax.nn.softmax(y)
        out = net(x)[..., 0]
        error = -(wanted * jax.nn.log_softmax(out)).sum()
        return error, {"listnet": error, "agreement": agreement(out, y)}


def agreement(out: Float[Array, "b"], y: Float[Array, "b"]) -> Array:
    """Pearson's correlation of outputs and scores of a list; 0 if either are all the same.

    Where most designs have the same score, many lists have no order. Not a number would be taken for a fit that diverged.
    """
    ordered = (jnp.ptp(out) > 0) & (jnp.ptp(y) > 0)
    return jnp.where(ordered, jnp.corrcoef(out, y)[0, 1], 0.0)


@jax.jit
def ranked(nets: tuple[MLP, Any, Any], x: Array) -> Array:
    """The standardised output of the model; `nets` holds the network, and mean and standard deviation of its output."""
    net, mean, std = nets
    return (jax.tree.map(lambda leaf: leaf[0], net)(x)[..., 0] - mean) / std


class RaM(Designer):
    """A ranking model, and gradient ascent on it."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"ascent": "ascent_steps"}

    hidden: Sizes = static((1024, 1024))  # width of each hidden layer
    steps: Count = static(5000)  # updates of the model
    list_size: Count = static(256)  # designs per list, one list per update
    lr: NonNegative = 3e-4  # learning rate of the model
    ascent_steps: Count = static(200)  # gradient steps that move the designs
    design_lr: NonNegative = 0.01  # step size of the designs, times the square root of the number of coordinates

    def _learner(self) -> Ranking:
        return Ranking(self.lr, 1, self.hidden, outputs=1, activation="relu", batch_size=self.list_size)

    def unseen(self, setting: DesignInput, x: np.ndarray, error: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(m,) outputs for other designs, greater for greater expected scores, and NaN for their standard deviations."""
        nets = setting.train(self._learner(), self.steps, "ram-held-out")[0][0]
        out = ranked((nets, 0.0, 1.0), jnp.asarray(setting.data.coordinates.encode(x)))
        return np.asarray(out, np.float64), np.full(len(x), np.nan)

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Gradient ascent from the best designs of the data; the model predicts an order, not scores."""
        learner = self._learner()
        view, start = setting.data.coordinates, starts(setting.data, setting.n)
        seen = jnp.asarray(view.encode(setting.data.x))
        found = []
        for seed, (nets, _) in zip(setting.seeds, setting.train(learner, self.steps, "ram")):
            out = jax.lax.map(lambda x, nets=nets: ranked((nets, 0.0, 1.0), x[None])[0], seen, batch_size=1024)
            scaled = nets, out.mean(), jnp.maximum(out.std(), 1e-6)
            x = climb(ranked, scaled, start, self.ascent_steps, self.design_lr * view.size**0.5, *setting.bounds)
            order = Fitted.of(setting.data, lambda x, scaled=scaled: (ranked(scaled, x), None), is_order=True)
            found.append(replace(self.decoded(setting, seed, x, climbed=partial(ranked, scaled)), fitted=order))
        return found
