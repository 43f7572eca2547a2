"""Forward models: one network or a bootstrapped ensemble of the score, and gradient ascent on its prediction (thesis 6.5).

Settings of the public baselines: 2048 x 2048, Gaussian likelihood, 200 steps of 0.01 sqrt(d) from the best designs. Their
"mean" ensemble takes the minimum; here both are what they are called.
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
from deadreckon.mbo.designer import Designer, DesignInput, Proposals, Search
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted, covariance_of_members, in_blocks
from deadreckon.mbo.surrogate import Surrogate, climb
from deadreckon.mbo.validation import Predict, Quality, held_out, judged, unseen
from deadreckon.nets.mlp import MLP, minimum
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static

HELD = 2000  # designs at most that are held out to judge a model
LOG_STD = -5.0, 2.0  # bounds of the predicted log-deviation, in deviations of the score


class Gaussian(Surrogate):
    """Mean and log-deviation of the score by maximum likelihood."""

    def loss(self, net: MLP, x, y, weight, key):
        """Negative log-likelihood, weighted by how often a design counts."""
        mean, log_std = believed(net, x)
        error = 0.5 * jnp.square((y - mean) / jnp.exp(log_std)) + log_std
        return (error * weight).mean(), {"nll": error.mean(), "error": jnp.square(y - mean).mean()}


def believed(net: MLP, x: Float[Array, "b z"]) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
    """Mean and log-deviation."""
    out = net(x)
    return out[..., 0], jnp.clip(out[..., 1], *LOG_STD)


@jax.jit
def means_of(nets: MLP, x: Array) -> Float[Array, "k b"]:
    """What each member believes."""
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
    """Mean and deviation of the members' mixture: what each is unsure of, and how far they disagree."""
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
        """What tables call it."""
        return "Forward" if self.members == 1 else f"Ensemble, {self.objective}"

    @property
    def _value(self) -> Callable[[MLP, Array], Array]:
        """What it predicts, and climbs."""
        return mean_of if self.objective == "mean" else least_of

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """From the best designs of the data, up the gradient."""
        learner = Gaussian(self.lr, self.members, self.hidden, 2, "relu", self.batch_size)
        # The same bootstrap samples whatever the seed: lanes of one program share their rows.
        weight = {"weight": redrawn(len(setting.data), self.members, 0)}
        states = setting.train(learner, self.steps, "forward", weight)
        view, start = setting.data.coordinates, Search.start(setting.data, setting.n)
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
        """The model, with how averages over designs go together: as the members' do, where these are several."""
        if fitted is None or self.members < 2 or self.objective != "mean":
            return fitted

        def averages(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            z = data.coordinates.encode(x.reshape(-1, x.shape[-1]))
            parts = in_blocks(lambda z: np.asarray(means_of(nets, z), np.float64), z)
            each = data.coordinates.score(np.concatenate(parts, 1)[:, : len(z)]).reshape(self.members, *x.shape[:2])
            return each.mean(0), covariance_of_members(each)

        return replace(fitted, averages=averages, freedom=self.members - 1)

    def unseen(self, setting: DesignInput, x: np.ndarray, error: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """What it says of scores of other designs: (m,) means and deviations with noise, whatever standard errors are known."""
        learner, data = Gaussian(self.lr, self.members, self.hidden, 2, "relu", self.batch_size), setting.data
        weight = {"weight": redrawn(len(data), self.members, 0)}
        nets = setting.train(learner, self.steps, "held-out", weight)[0][0]
        view = data.coordinates
        z = jnp.asarray(view.encode(x))
        mean, std = (np.asarray(each, np.float64) for each in (self._value(nets, z), mixture(nets, z)[1]))
        return view.score(mean), view.y_std * std


def on_held_out(method: Any, setting: DesignInput, scored: bool = True) -> Quality | None:
    """How well a method predicts designs that it is not fitted on and that calibrate it (`validation.held_out`).

    Args:
        method: with `unseen`, which fits it on some designs and predicts others.
        setting: with all the designs.
        scored: whether it predicts scores, and not their order alone.

    Returns:
        None where there are too few designs.
    """
    data = setting.data
    if (out := held_out(data, HELD)) is None:
        return None
    held, rest, fold = out

    def model(part: Designs) -> Predict:
        return partial(method.unseen, setting._replace(data=part, seeds=setting.seeds[:1]))

    mean, std = unseen(data, held, rest, model)
    return replace(judged(data.y[held], mean, std, fold, method.label, scored=scored), units=data.units[held])
