"""Soft actor-critic (Haarnoja et al. 2018) with automatic temperature; on a fixed log it is the thesis's SAC-off."""

import math
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics, loss_of_critics
from deadreckon.data.batch import BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import FIRST_WEIGHTS, MLP, FirstWeights, Init, all_q_values, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.policies.kinds import Categorical, create_actor, stochastic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Number, Positive, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later

HOTTEST = 1e6  # temperature beyond which none is raised


class State(NamedTuple):
    """Networks, target critics, log-temperature and optimisers."""

    actor: MLP | Categorical
    critics: MLP  # stacked
    target_critics: MLP
    log_temperature: Array
    actor_opt: optax.OptState
    critics_opt: optax.OptState
    temperature_opt: optax.OptState
    model: Any = None  # the model of model-based agents; other subclasses keep their additional state here


class SAC(Agent):
    """Soft actor-critic with several critics, a tanh-Gaussian actor and a target entropy."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = True
    online: ClassVar[bool] = True
    fine_tunes: ClassVar[bool] = True
    supports_images: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {"backup_entropy": "entropy_backup", "init_temperature": "temperature"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    critic_lr: NonNegative = 3e-4  # learning rate of the critics
    temperature_lr: NonNegative = 3e-4  # learning rate of the logarithm of the entropy temperature
    temperature: Positive = 1.0  # initial entropy temperature (alpha in the literature)
    target_entropy: Number | None = None
    """target entropy in nats; None: minus the action dimensions, or a tenth of the maximum for discrete actions"""
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    entropy_backup: bool = static(True)  # whether the critics' targets include the entropy bonus
    critics: Count = static(2)  # number of Q-networks, of which the minimum is used
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether flat observations are standardised to mean 0 and standard deviation 1
    first_weights: FirstWeights = later("uniform")
    """initial weights: uniform in +-1/sqrt(inputs), "glorot", "orthogonal" or "rlkit" (hidden biases 0.1, small last layers)"""

    def resolve(self, spec, steps):
        """Fills in the target entropy."""
        agent = super().resolve(spec, steps)
        if self.target_entropy is not None:
            return agent
        if not spec.discrete:
            return agent.replace(target_entropy=-float(spec.action_size))
        # A tenth of the maximum entropy, so that the policy is nearly greedy; of legal actions a bound from below of its mean,
        # E[log k] >= (E[k] - 1) / (n - 1) log n, since the logarithm is concave: a target above it could not be reached.
        most = math.log(spec.action_size)
        if spec.mask_size and spec.rows:
            most *= (float(spec.observation.mean[-spec.mask_size :].sum()) - 1.0) / max(spec.action_size - 1, 1)
        return agent.replace(target_entropy=0.1 * most)

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    @property
    def actor_init(self) -> Init:
        """How its actor begins."""
        return FIRST_WEIGHTS[self.first_weights][0]

    @property
    def critic_init(self) -> Init:
        """How its critics begin."""
        return FIRST_WEIGHTS[self.first_weights][1]

    def init(self, spec, key) -> Any:
        """Fresh networks; targets are copies."""
        ka, kc = keys(key, "actor", "critics")
        actor = create_actor(spec, self.hidden, ka, self.actor_init)
        critics = self.first_critics(spec, kc)
        log_temperature = jnp.log(jnp.asarray(self.temperature))
        opts = init_opt(actor), init_opt(critics), init_opt(log_temperature)
        return State(actor, critics, copy(critics), log_temperature, *opts)

    def first_critics(self, spec, key) -> MLP:
        """Fresh Q-networks."""
        return create_critics(spec, self.hidden, self.critics, key, init=self.critic_init)

    def min_q(self, values):
        """Minimum over the critics' values (k, *b)."""
        return minimum(values)

    def target_q(self, values):
        """Value of the next state from the target critics' values (k, *b)."""
        return self.min_q(values)

    def actor_rate(self, step: Array) -> Any:
        """Learning rate of the actor at an update."""
        return self.actor_lr

    @property
    def entropy_target(self):
        """The entropy that the temperature is tuned to, in nats."""
        return self.target_entropy

    def entropy_cost(self, state, d, pre, observation):
        """The quantity that the temperature multiplies: log-probability of the actions (`pre` before the tanh)."""
        return dist.log_prob(d, pre)

    def act(self, state, observation, noise):
        """Actions sampled from the present actor with standard normal `noise`, and their entropy bonus in the values."""
        d = dist.gaussian_head(state.actor(observation))
        pre = d.mean + jnp.exp(d.log_std) * noise
        if not self.entropy_backup:
            return jnp.tanh(pre), jnp.zeros(pre.shape[:-1])
        return jnp.tanh(pre), -jnp.exp(state.log_temperature) * self.entropy_cost(state, d, pre, observation)

    def value(self, state, observation, noise):
        """min_j Q'_j(s, a) - temperature log pi(a|s), a from the actor; for discrete actions the expectation over all."""
        if isinstance(state.actor, Categorical):
            q = self.target_q(all_q_values(state.target_critics, observation))
            return self.expected_value(state.actor, q, observation, state.log_temperature)
        action, bonus = self.act(state, observation, noise)
        return self.target_q(q_values(state.target_critics, observation, action)) + bonus

    def expected_value(self, actor: Categorical, q: Array, observation: Array, log_temperature: Array) -> Array:
        """sum_a pi(a|s) (Q(s, a) - temperature log pi(a|s)) for values (..., b, n); without the bonus if not entropy_backup."""
        log_prob = actor.log_probs(observation)
        bonus = -jnp.exp(log_temperature) * log_prob if self.entropy_backup else 0.0
        return (jnp.exp(log_prob) * (q + bonus)).sum(-1)

    def target(self, state, batch, key) -> Any:
        """r + discount (min_j Q'_j(s', a') - temperature log pi(a'|s')), a' from the present actor."""
        noise = jax.random.normal(key, batch.action.shape)
        return backup(batch, self.discount, self.value(state, batch.next_observation, noise))

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors of all critics."""
        return bellman_loss(critics, batch, target)

    def actor_loss(self, actor, state, batch, key):
        """temperature log pi(a|s) - min_j Q_j(s, a), a reparameterised; also returns the mean log-probability.

        For discrete actions it is the expectation over all actions.
        """
        if isinstance(actor, Categorical):
            log_prob = actor.log_probs(batch.observation)
            q = self.min_q(all_q_values(state.critics, batch.observation))
            loss = (jnp.exp(log_prob) * (jnp.exp(state.log_temperature) * log_prob - q)).sum(-1).mean()
            return loss, (jnp.exp(log_prob) * log_prob).sum(-1).mean()
        d = dist.gaussian_head(actor(batch.observation))
        pre = dist.sample(d, key)
        log_prob = self.entropy_cost(state, d, pre, batch.observation)
        q = self.min_q(q_values(state.critics, batch.observation, jnp.tanh(pre)))
        return (jnp.exp(state.log_temperature) * log_prob - q).mean(), log_prob.mean()

    def update(self, state, batch, *, step, key):
        """Critics, actor, temperature, targets."""
        k_target, k_critics, k_actor = keys(key, "target", "critic_loss", "actor_loss")
        state, metrics = self.update_critics(state, batch, k_target, k_critics)
        state, loss, log_prob = self.update_actor(state, batch, step, k_actor)
        state = self.update_temperature(state, log_prob)
        state = state._replace(target_critics=polyak_update(state.target_critics, state.critics, self.tau))
        return state, metrics | {"actor_loss": loss, "entropy": -log_prob, "temperature": jnp.exp(state.log_temperature)}

    def update_critics(self, state, batch, k_target, k_critics) -> tuple[Any, dict[str, Array]]:
        """One step of all critics towards their target."""
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(self.critic_loss, has_aux=True)(state.critics, state, batch, target, k_critics)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        return state._replace(critics=critics, critics_opt=critics_opt), metrics

    def update_actor(self, state, batch, step, key) -> tuple[Any, Array, Array]:
        """One step of the actor; its loss, and the mean log-probability of its actions."""
        (loss, log_prob), grads = jax.value_and_grad(self.actor_loss, has_aux=True)(state.actor, state, batch, key)
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_rate(step))
        return state._replace(actor=actor, actor_opt=actor_opt), loss, log_prob

    def update_temperature(self, state, log_prob) -> Any:
        """The temperature falls while the entropy exceeds its target: d/dlog T of -log T (log pi + target entropy)."""
        slope = -(log_prob + self.entropy_target)
        value, opt = apply_gradients(state.log_temperature, slope, state.temperature_opt, self.temperature_lr)
        # A target that no policy reaches would raise it for ever.
        return state._replace(log_temperature=jnp.minimum(value, math.log(HOTTEST)), temperature_opt=opt)

    def representation_loss(self, state, batch, *, step, key):
        """That of the critics."""
        return loss_of_critics(self, state, batch, key)

    def policy(self, state):
        """The actor; greedy actions are its mean, or the most probable action."""
        return stochastic(state.actor)

    def q_value(self, state, observation, action):
        """Minimum over the critics; includes the entropy bonus of later steps."""
        return self.min_q(q_values(state.critics, observation, action))
