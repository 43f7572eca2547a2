"""BCQ (Fujimoto et al. 2019; thesis 7.4): the critics' choice of a few actions that a model of the log samples, perturbed.

A VAE makes actions like the log's; a network perturbs each by `max_perturbation` at most, towards higher values. Of
discrete actions (Fujimoto et al. 2019b) the choice is among those that a model of the log finds at least `threshold` times as
probable as the most probable one; none is perturbed.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import MLP, all_q_values, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.nets.vae import VAE
from deadreckon.policies import behavior as models
from deadreckon.policies.candidates import GreedyQ, PerturbedPolicy, ThresholdedPolicy, perturbed, probable_enough
from deadreckon.policies.kinds import Categorical
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Fraction, NonNegative, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later


class State(NamedTuple):
    """Networks, targets and optimisers."""

    behavior: VAE | Categorical
    mover: MLP | None  # None where actions are discrete
    critics: MLP  # stacked: leading axis 2
    target_mover: MLP | None
    target_critics: MLP
    behavior_opt: optax.OptState
    mover_opt: optax.OptState
    critics_opt: optax.OptState


class BCQ(Agent):
    """Batch-constrained Q-learning."""

    revision: ClassVar[int] = 2
    supports_discrete: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {
        "reach": "max_perturbation", "phi": "max_perturbation", "share": "threshold", "lambda": "min_weight",
        "lmbda": "min_weight", "draws": "samples", "test_draws": "test_samples",
    }  # fmt: skip

    actor_lr: NonNegative = 1e-3  # learning rate of the perturbation network
    critic_lr: NonNegative = 1e-3  # learning rate of the critics
    behavior_lr: NonNegative = 1e-3  # learning rate of the model of the log
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target networks, per update
    min_weight: UnitInterval = 0.75  # weight of the smaller critic in the targets (lambda); the rest is of the larger
    max_perturbation: NonNegative = 0.05  # largest change of an action by the perturbation network (Phi)
    threshold: Fraction = 0.3
    """smallest probability of a discrete action, relative to the most probable one (tau in the paper)"""
    samples: Count = static(10)  # actions sampled from the VAE for the targets, of which the best counts
    test_samples: Count = static(100)  # actions sampled by the policy, of which the best is taken
    hidden: Sizes = static((400, 300))  # width of each hidden layer
    behavior_hidden: Sizes = static((750, 750))  # width of each hidden layer of the VAE
    batch_size: Count = static(100)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether observations are standardised to mean 0 and standard deviation 1

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        kb, km, kc = keys(key, "behavior", "mover", "critics")
        if spec.discrete:
            behavior, mover = Categorical.create(spec, self.behavior_hidden, kb), None
        else:
            behavior = VAE.create(spec.observation_size, spec.action_size, self.behavior_hidden, kb)
            mover = MLP.create(spec.observation_size + spec.action_size, self.hidden, spec.action_size, km)
        critics = create_critics(spec, self.hidden, 2, kc)
        opts = init_opt(behavior), init_opt(mover), init_opt(critics)
        return State(behavior, mover, critics, copy(mover), copy(critics), *opts)

    def target(self, state, batch, key) -> Float[Array, "b"]:
        """r + discount max_i (lambda min_j Q'_j + (1 - lambda) max_j Q'_j)(s', a_i), a_i of the VAE, perturbed (eq. 13).

        Of discrete actions a_i are those that are likely enough.
        """
        if isinstance(state.behavior, Categorical):
            mixed = self.mixed(all_q_values(state.target_critics, batch.next_observation))
            likely = probable_enough(state.behavior, self.threshold, batch.next_observation)
            return backup(batch, self.discount, jnp.where(likely, mixed, -jnp.inf).max(-1))
        drawn = jnp.tanh(state.behavior.sample(batch.next_observation, key, (self.samples,)))
        action = perturbed(state.target_mover, self.max_perturbation, batch.next_observation, drawn)
        q = q_values(state.target_critics, batch.next_observation, action)
        return backup(batch, self.discount, self.mixed(q).max(0))

    def mixed(self, q: Float[Array, "k *b"]) -> Float[Array, "*b"]:
        """lambda times the least of the critics and the rest of the greatest."""
        return self.min_weight * minimum(q) + (1.0 - self.min_weight) * q.max(0)

    def mover_loss(self, mover: MLP, state, batch, key) -> Array:
        """-Q_1(s, a + move), a drawn from the VAE (eq. 12)."""
        drawn = jax.lax.stop_gradient(jnp.tanh(state.behavior.sample(batch.observation, key)))
        first = jax.tree.map(lambda w: w[:1], state.critics)
        return -q_values(first, batch.observation, perturbed(mover, self.max_perturbation, batch.observation, drawn))[0].mean()

    def update(self, state, batch, *, step, key):
        """VAE, critics, mover, targets."""
        k_behavior, k_target, k_mover = keys(key, "behavior", "target", "mover_loss")
        fit = jax.grad(models.loss, has_aux=True)
        grads, of_behavior = fit(state.behavior, batch.observation, batch.action, k_behavior)
        behavior, behavior_opt = apply_gradients(state.behavior, grads, state.behavior_opt, self.behavior_lr)
        state = state._replace(behavior=behavior, behavior_opt=behavior_opt)
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(critics=critics, critics_opt=critics_opt)
        if state.mover is None:
            target_critics = polyak_update(state.target_critics, critics, self.tau)
            return state._replace(target_critics=target_critics), metrics | of_behavior
        loss, grads = jax.value_and_grad(self.mover_loss)(state.mover, state, batch, k_mover)
        mover, mover_opt = apply_gradients(state.mover, grads, state.mover_opt, self.actor_lr)
        targets = polyak_update((state.target_mover, state.target_critics), (mover, critics), self.tau)
        state = state._replace(mover=mover, mover_opt=mover_opt, target_mover=targets[0], target_critics=targets[1])
        return state, metrics | of_behavior | {"actor_loss": loss}

    def policy(self, state):
        """The best by the first critic of perturbed actions of the VAE, or of discrete ones that are probable enough."""
        first = jax.tree.map(lambda w: w[0], state.critics)
        if isinstance(state.behavior, Categorical):
            return ThresholdedPolicy(first, state.behavior, jnp.asarray(self.threshold))
        actor = PerturbedPolicy(state.behavior, state.mover, jnp.asarray(self.max_perturbation))
        return GreedyQ.of(actor, first, self.test_samples)

    def q_value(self, state, observation, action):
        """The smaller of the two critics."""
        return minimum(q_values(state.critics, observation, action))
