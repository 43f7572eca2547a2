"""Forward models: one network or a bootstrapped ensemble of the score, and gradient ascent on its prediction (thesis 6.5).

The settings are those of the public baselines: two hidden layers of 2048 units, a Gaussian likelihood, and 200 steps of size
0.01 sqrt(d) from the best designs, where d is the number of coordinates. The public "mean" ensemble takes the minimum of its
members; here "mean" is their mean and "min" their minimum.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.data.batch import redrawn
from deadreckon.mbo.designer import Designer, DesignInput, Proposals, starts
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted, covariance_of_members, in_blocks
from deadreckon.mbo.replicates import row_weights
from deadreckon.mbo.surrogate import Surrogate, climb
from deadreckon.mbo.validation import Predict, Quality, held_out, judged, unseen
from deadreckon.nets.mlp import MLP, minimum
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static

HELD = 2000  # largest number of designs that are held out to evaluate a model
LOG_STD = -5.0, 2.0  # bounds of the predicted log standard deviation, for standardised scores


class Gaussian(Surrogate):
    """The learner: mean and log standard deviation of the score by maximum likelihood."""

    def loss(self, net: MLP, x, y, weight, key):
        """Weighted negative log-likelihood, and metrics."""
        mean, log_std = believed(net, x)
        error = 0.5 * jnp.square((y - mean) / jnp.exp(log_std)) + log_std
        return (error * weight).mean(), {"nll": error.mean(), "error": jnp.square(y - mean).mean()}


def believed(net: MLP, x: Float[Array, "b z"]) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
    """Predicted mean and log standard deviation of the standardised score."""
    out = net(x)
    return out[..., 0], jnp.clip(out[..., 1], *LOG_STD)


@jax.jit
def means_of(nets: MLP, x: Array) -> Float[Array, "k b"]:
    """The mean predicted by each member."""
    return jax.vmap(lambda net: believed(net, x)[0])(nets)


@jax.jit
def mean_of(nets: MLP, x: Array) -> Array:
    """The mean of the members' predictions."""
    return means_of(nets, x).mean(0)


@jax.jit
def least_of(nets: MLP, x: Array) -> Array:
    """The least of the members' predictions."""
    return minimum(means_of(nets, x))


@jax.jit
def mixture(nets: MLP, x: Array) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
    """Mean and standard deviation of the members' mixture; its variance is their mean variance plus that of their means."""
    mean, log_std = jax.vmap(lambda net: believed(net, x))(nets)
    return mean.mean(0), jnp.sqrt(jnp.exp(2 * log_std).mean(0) + mean.var(0))


class Forward(Designer):
    """A model of the score and gradient ascent on its mean; several members form an ensemble, fitted on bootstrap resamples."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"ascent": "ascent_steps"}

    members: Count = static(1)  # number of networks, each fitted on a bootstrap resample of the designs
    objective: Literal["mean", "min"] = static("mean")  # prediction to maximise: mean or minimum over the networks
    hidden: Sizes = static((2048, 2048))  # width of each hidden layer
    steps: Count = static(5000)  # updates of the networks
    batch_size: Count = static(128)  # batch size (designs per update)
    lr: NonNegative = 3e-4  # learning rate of the networks
    ascent_steps: Count = static(200)  # gradient steps that move the designs
    design_lr: NonNegative = 0.01  # step size of the designs, times the square root of the number of coordinates

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "Forward" if self.members == 1 else f"Ensemble, {self.objective}"

    @property
    def _value(self) -> Callable[[MLP, Array], Array]:
        """The prediction, which gradient ascent maximises."""
        return mean_of if self.objective == "mean" else least_of

    def _learner(self) -> Gaussian:
        return Gaussian(self.lr, self.members, self.hidden, outputs=2, activation="relu", batch_size=self.batch_size)

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Gradient ascent from the best designs of the data."""
        learner = self._learner()
        # The same bootstrap resamples for all seeds, because the lanes of one program share their rows.
        weight = {"weight": redrawn(len(setting.data), self.members, 0)}
        states = setting.train(learner, self.steps, "forward", weight)
        view, start = setting.data.coordinates, starts(setting.data, setting.n)
        value = self._value
        found = []
        for seed, (nets, _) in zip(setting.seeds, states):
            x = climb(value, nets, start, self.ascent_steps, self.design_lr * view.size**0.5, *setting.bounds)
            believed = lambda x, nets=nets: (value(nets, x), mixture(nets, x)[1])  # noqa: E731
            made = self.decoded(setting, seed, x, believed, climbed=partial(value, nets))
            found.append(replace(made, fitted=self._fitted(made.fitted, setting.data, nets)))
        quality = on_held_out(self, setting) if setting.validate else None
        return found if quality is None else [each.calibrated(quality) for each in found]

    def _fitted(self, fitted: Fitted | None, data: Designs, nets: MLP) -> Fitted | None:
        """The model; for an ensemble with the covariance of averages over designs, by that of its members."""
        if fitted is None or self.members < 2 or self.objective != "mean":
            return fitted

        def averages(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            z = data.coordinates.encode(x.reshape(-1, x.shape[-1]))
            parts = in_blocks(lambda z: np.asarray(means_of(nets, z), np.float64), z)
            each = data.coordinates.score(np.concatenate(parts, 1)[:, : len(z)]).reshape(self.members, *x.shape[:2])
            return each.mean(0), covariance_of_members(each)

        return replace(fitted, averages=averages, freedom=self.members - 1)

    def unseen(self, setting: DesignInput, x: np.ndarray, error: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(m,) predicted means and standard deviations, noise included, of scores of other designs; `error` is ignored."""
        learner, data = self._learner(), setting.data
        weight = {"weight": redrawn(len(data), self.members, 0)}
        nets = setting.train(learner, self.steps, "held-out", weight)[0][0]
        view = data.coordinates
        z = jnp.asarray(view.encode(x))
        mean, std = (np.asarray(each, np.float64) for each in (self._value(nets, z), mixture(nets, z)[1]))
        return view.score(mean), view.y_std * std


def on_held_out(method: Any, setting: DesignInput, scored: bool = True) -> Quality | None:
    """The quality of a method's predictions of held-out designs, by which it is also calibrated (`validation.held_out`).

    Args:
        method: has `unseen`, which fits it to some designs and predicts others.
        setting: with all designs.
        scored: whether it predicts scores, and not only their order.

    Returns:
        The quality; None if there are too few designs.
    """
    data = setting.data
    if (out := held_out(data, HELD)) is None:
        return None
    held, rest, fold = out

    def model(part: Designs) -> Predict:
        return partial(method.unseen, setting._replace(data=part, seeds=setting.seeds[:1]))

    mean, std = unseen(data, held, rest, model)
    found = judged(data.y[held], mean, std, fold, method.label, scored=scored, weight=row_weights(data)[held])
    return replace(found, units=data.units[held], rows=held)
