"""Behaviour cloning: maximum likelihood of the logged actions. The row that every other agent has to beat."""

from collections.abc import Callable
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import optax

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import BatchSpec
from deadreckon.errors import UserError
from deadreckon.nets.mlp import FIRST_WEIGHTS, MLP, FirstWeights
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.nets.vae import VAE
from deadreckon.policies import behavior
from deadreckon.policies.kinds import Categorical, Likelihood, TanhMeanGaussian, create_imitator
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static
from deadreckon.training.later_fields import later


class State(NamedTuple):
    """Model and its optimiser."""

    model: MLP | VAE | behavior.Clipped | TanhMeanGaussian | Categorical
    opt: optax.OptState


class BC(Agent):
    """Behaviour cloning with a tanh-Gaussian network, the VAE that the thesis used as its baseline (A.4), or, for logs with
    many actions at the bounds, a Gaussian whose draws are clipped, with or without a tanh around its mean."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = True
    supports_images: ClassVar[bool] = True

    lr: NonNegative = 3e-4  # learning rate of the policy
    model: Literal["gaussian", "vae", "clipped", "normal"] = static("gaussian")
    """model of the policy: tanh-Gaussian, VAE (thesis A.4), clipped Gaussian, or normal around tanh of a network"""
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether flat observations are standardised to mean 0 and standard deviation 1
    first_weights: FirstWeights = later("uniform")
    """initial weights of a Gaussian or normal model, or of logits: "uniform", "glorot", "orthogonal" or "rlkit" (as SAC's)"""

    def resolve(self, spec, steps):
        """Of discrete actions there is one model."""
        if spec.discrete and self.model != "gaussian":
            raise UserError(f"BC.model: of discrete actions it is a network's logits; leave {self.model!r} out")
        if self.first_weights != "uniform" and self.model not in ("gaussian", "normal"):
            raise UserError(f"BC.first_weights={self.first_weights!r} needs model='gaussian' or 'normal', got {self.model!r}")
        return super().resolve(spec, steps)

    def needs(self, spec):
        """Observations and actions."""
        return BatchSpec(("observation", "action"), self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """A fresh model."""
        if self.model in ("gaussian", "normal"):
            likelihood: Likelihood = "normal" if self.model == "normal" else "tanh_normal"
            model = create_imitator(spec, self.hidden, key, likelihood, init=FIRST_WEIGHTS[self.first_weights][0])
        elif self.model == "clipped":
            model = behavior.Clipped.create(spec, self.hidden, key)
        else:
            model = behavior.create(self.model, spec, self.hidden, key)
        return State(model, init_opt(model))

    def update(self, state, batch, *, step, key):
        """One step on the negative log-likelihood (or the VAE's bound)."""
        grad = jax.grad(behavior.loss, has_aux=True)
        grads, metrics = grad(state.model, batch.observation, batch.action, key)
        model, opt = apply_gradients(state.model, grads, state.opt, self.lr)
        return State(model, opt), metrics

    def representation_loss(self, state, batch, *, step, key):
        """That of the model."""
        return behavior.loss(state.model, batch.observation, batch.action, key)[0]

    def policy(self, state):
        """The model itself."""
        return behavior.policy(state.model)


def cloned(
    agent: Any, fit: Callable[..., Any], key: Any, likelihood: Likelihood = "tanh_normal"
) -> MLP | TanhMeanGaussian:
    """A model of the log's policy, as `behavior_lr` and `behavior_steps` of an agent say.

    Args:
        agent: whose networks are as wide and begin alike, and whose batches are as large and in the same coordinates.
        fit: trains a learner on the agent's log, as `prepare` gets it.
        key: of the training.
        likelihood: of its actions.
    """
    model = "normal" if likelihood == "normal" else "gaussian"
    same = {name: getattr(agent, name) for name in ("hidden", "batch_size", "standardise", "first_weights")}
    clone = BC(lr=float(agent.behavior_lr), model=model, **same)
    return fit(clone, agent.behavior_steps, key).model
