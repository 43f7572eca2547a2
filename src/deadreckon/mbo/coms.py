"""COMs: conservative objective models (Trabucco, Kumar, Geng and Levine 2021).

A penalty keeps the model from predicting higher scores for designs found by gradient ascent than for those of the data. Its
weight is adapted until the difference is `margin`.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.mbo.designer import Designer, DesignInput, Proposals, starts
from deadreckon.mbo.surrogate import climb
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, host, static

# Margin in standard deviations of the score, and learning rate of the designs, of the public code (whose rate for discrete
# designs is 2.0, with standardised logits; the logits here are a quarter as large).
CONTINUOUS, DISCRETE = (0.5, 0.05), (2.0, 0.5)
FIRST = 0.1  # initial weight of the penalty


class State(NamedTuple):
    """The model and the logarithm of the penalty's weight, each with its optimiser state."""

    net: MLP
    opt: optax.OptState
    log_alpha: Float[Array, ""]
    alpha_opt: optax.OptState


class Conservative(eqx.Module):
    """The learner: the model and the weight of its penalty."""

    settings: "COMs"  # resolved: `margin` and `design_lr` are not None

    def needs(self, spec):
        """Batches of designs and scores."""
        return BatchSpec(columns=(), batch_size=self.settings.batch_size)

    def init(self, spec, key):
        """An initial model and weight of the penalty, and their optimiser states."""
        net = MLP.create(spec.size, self.settings.hidden, 1, key, activation="relu")
        log_alpha = jnp.log(jnp.float32(FIRST))
        return State(net, init_opt(net), log_alpha, init_opt(log_alpha))

    def update(self, state: State, batch: Batch, *, step, key):
        """One update of the model and one of the penalty's weight, which grows while the difference is above the margin."""
        assert batch.extra is not None
        x, y = batch.extra["x"], batch.extra["y"]
        beyond = jax.lax.stop_gradient(self.adversaries(state.net, x))
        alpha = jnp.exp(state.log_alpha)
        grads, metrics = jax.grad(self.loss, has_aux=True)(state.net, x, y, beyond, alpha)
        net, opt = apply_gradients(state.net, grads, state.opt, self.settings.lr)
        slack = self.settings.margin - metrics["overestimation"]
        log_alpha, alpha_opt = apply_gradients(state.log_alpha, slack, state.alpha_opt, self.settings.alpha_lr)
        return State(net, opt, log_alpha, alpha_opt), metrics | {"alpha": alpha}

    def adversaries(self, net: MLP, x: Array) -> Array:
        """The coordinates that gradient ascent from those of the data reaches."""
        rise = lambda _, x: x + self.settings.design_lr * jax.grad(lambda x: predicted_score(net, x).sum())(x)  # noqa: E731
        return jax.lax.fori_loop(0, self.settings.ascent_steps, rise, x)

    def loss(self, net: MLP, x: Array, y: Array, beyond: Array, alpha: Array):
        """Squared error plus `alpha` times the difference between the mean predictions at `beyond` and on the data."""
        on = predicted_score(net, x)
        error = jnp.square(on - y).mean()
        more = predicted_score(net, beyond).mean() - on.mean()
        return error + alpha * more, {"error": error, "overestimation": more}


def predicted_score(net: MLP, x: Float[Array, "b z"]) -> Float[Array, "b"]:
    """The model's prediction of the standardised score."""
    return net(x)[..., 0]


class COMs(Designer):
    """A model that is penalised for higher predictions away from the data, and gradient ascent on it."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"ascent": "ascent_steps"}

    hidden: Sizes = static((2048, 2048))  # width of each hidden layer
    steps: Count = host(5000)  # updates of the model
    batch_size: Count = static(128)  # batch size (designs per update)
    lr: NonNegative = 3e-4  # learning rate of the model
    alpha_lr: NonNegative = 0.01  # learning rate of the logarithm of the penalty's weight
    margin: NonNegative | None = None
    """allowed overestimation, in standard deviations of the score; None: 0.5, or 2.0 for discrete designs"""
    ascent_steps: Count = static(50)  # gradient steps that move the designs, in training and after it
    design_lr: NonNegative | None = None
    """step size of the designs, times the square root of the number of coordinates; None: 0.05, or 0.5 for discrete designs"""

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Gradient ascent from the best designs of the data."""
        view, start = setting.data.coordinates, starts(setting.data, setting.n)
        margin, rate = DISCRETE if view.discrete else CONTINUOUS
        margin = margin if self.margin is None else self.margin
        rate = (rate if self.design_lr is None else self.design_lr) * view.size**0.5
        learner = Conservative(self.replace(margin=margin, design_lr=rate))
        found: list[Any] = []
        for seed, state in zip(setting.seeds, setting.train(learner, self.steps, "coms")):
            x = climb(predicted_score, state.net, start, self.ascent_steps, rate, *setting.bounds)
            found.append(self.decoded(setting, seed, x, lambda x, net=state.net: (predicted_score(net, x), None)))
        return found
