"""AWR (Peng et al. 2019; thesis 7.4): regression on the returns of the log's actions, and imitation weighted by it.

No Q-function is learned and no action outside of the log valued. With V fitted to returns of the log, by TD(lambda) within a
window of consecutive rows, an action counts for the actor by

    w = min(exp(A / temperature), max_weight),   A = (TD(lambda) return - V(s)), standardised over the batch.
"""

import dataclasses
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent, advantage_in_windows, backup, capped_exp, imitation_loss, rows_of_windows
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets.mlp import FIRST_WEIGHTS, MLP, FirstWeights
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies.kinds import Categorical, Likelihood, TanhMeanGaussian, create_imitator, stochastic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later


class State(NamedTuple):
    """Networks and optimisers."""

    actor: MLP | Categorical | TanhMeanGaussian
    value: MLP
    actor_opt: optax.OptState
    value_opt: optax.OptState


class AWR(Agent):
    """Advantage-weighted regression."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"trace": "td_lambda", "lambda": "td_lambda", "beta": "temperature"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    critic_lr: NonNegative = 3e-4  # learning rate of the values
    discount: UnitInterval = 0.99  # discount factor per step
    td_lambda: UnitInterval = 0.95  # lambda of the TD(lambda) returns: 0 trusts the values, 1 the logged returns
    temperature: Positive = 1.0  # temperature that divides the standardised advantage (beta in the paper)
    max_weight: Positive = 20.0  # largest weight of a transition in the loss of the actor
    likelihood: Likelihood = static("normal")
    """likelihood of logged actions: normal around tanh of a network, or tanh-normal"""
    action_std: Positive = 0.4  # standard deviation of actions in [-1, 1], with likelihood="normal" (published: 0.2 on Ant)
    window: Count = static(16)  # consecutive transitions after which the value stands for the rest of the return
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update), in windows of the length above
    standardise: bool = static(True)  # whether observations are standardised to mean 0 and standard deviation 1
    first_weights: FirstWeights = later("uniform")
    """initial weights: "uniform", "orthogonal", "rlkit", or "glorot" with a last layer of the actor within 0.01 (authors)"""

    def needs(self, spec):
        """Windows of transitions."""
        size = max(self.batch_size // self.window, 1)
        return BatchSpec((*BatchSpec.columns, "time"), size, window=self.window, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks."""
        ka, kv = keys(key, "actor", "value")
        first, first_value = FIRST_WEIGHTS[self.first_weights]
        first = first._replace(last=0.01) if self.first_weights == "glorot" else first
        actor = create_imitator(spec, self.hidden, ka, self.likelihood, self.action_std, first)
        value = MLP.create(spec.observation_size, self.hidden, 1, kv, init=first_value)
        return State(actor, value, init_opt(actor), init_opt(value))

    def returns(self, value: MLP, batch: Batch) -> tuple[Float[Array, "b w"], Float[Array, "b w"]]:
        """TD(lambda) returns of all rows of the windows, and their advantages over the values as they are."""
        now, following = value(batch.observation)[..., 0], value(batch.next_observation)[..., 0]
        error = backup(batch, self.discount, following) - now
        advantage = advantage_in_windows(batch, error, self.discount * self.td_lambda)
        return advantage + now, advantage

    def update(self, state, batch, *, step, key):
        """Values, then the actor by the advantages over them."""
        mask = rows_of_windows(batch, self.window)
        target, _ = self.returns(state.value, batch)
        value_loss, grads = jax.value_and_grad(
            lambda value: (mask * jnp.square(value(batch.observation)[..., 0] - target)).mean()
        )(state.value)
        value, value_opt = apply_gradients(state.value, grads, state.value_opt, self.critic_lr)
        _, advantage = self.returns(value, batch)
        weight = self.weights(advantage, mask)
        actor_loss, grads = jax.value_and_grad(imitation_loss)(state.actor, batch, mask * weight)
        if isinstance(grads, TanhMeanGaussian):
            grads = dataclasses.replace(grads, log_std=jnp.zeros_like(grads.log_std))
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_lr)
        metrics = {"actor_loss": actor_loss, "value_loss": value_loss, "weight": (mask * weight).mean()}
        return State(actor, value, actor_opt, value_opt), metrics

    def weights(self, advantage: Float[Array, "b w"], mask: Float[Array, "b w"]) -> Float[Array, "b w"]:
        """exp of the advantages, standardised over the rows that are there, cut above; `mask` has mean one."""
        away = advantage - (mask * advantage).mean()
        deviation = jnp.sqrt((mask * jnp.square(away)).mean())
        return capped_exp(away / (deviation + 1e-5) / self.temperature, self.max_weight)

    def policy(self, state):
        """The actor; greedy is its mean."""
        return stochastic(state.actor)
