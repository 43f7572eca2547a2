"""BCQ (Fujimoto et al. 2019; thesis 7.4): the critics' choice of a few actions that a model of the log makes, a little moved.

A VAE makes actions like the log's; a network moves each by `reach` at most, towards what the critics like better. Of discrete
actions (Fujimoto et al. 2019b) the choice is among those that a model of the log finds at least `share` times as likely as the
likeliest; nothing is moved.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import MLP, all_q_values, least, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.nets.vae import VAE
from deadreckon.policies import behavior as models
from deadreckon.policies.kinds import Categorical, GreedyQ, Moved, Supported, moved, supported
from deadreckon.training.hyperparameters import Count, Fraction, NonNegative, Share, Sizes, static


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

    supports_discrete: ClassVar[bool] = True

    actor_lr: NonNegative = 1e-3  # learning rate of what moves actions
    critic_lr: NonNegative = 1e-3  # learning rate of the critics
    behavior_lr: NonNegative = 1e-3  # learning rate of the VAE
    discount: Share = 0.99  # per step
    target_rate: Share = 0.005  # Polyak rate of the targets
    min_weight: Share = 0.75  # lambda: of the smaller critic in targets; the rest is of the larger
    reach: NonNegative = 0.05  # Phi: how far an action is moved at most
    share: Fraction = 0.3  # tau: of the likeliest discrete action's probability, which others need
    draws: Count = static(10)  # actions of the VAE that targets take the best of
    test_draws: Count = static(100)  # actions that the policy takes the best of
    hidden: Sizes = static((400, 300))  # width of each hidden layer
    behavior_hidden: Sizes = static((750, 750))  # of the VAE's layers
    batch_size: Count = static(100)  # rows a batch

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        kb, km, kc = jax.random.split(key, 3)
        if spec.discrete:
            behavior, mover = Categorical.create(spec, self.behavior_hidden, kb), None
        else:
            behavior = VAE.create(spec.observation_size, spec.action_size, self.behavior_hidden, kb)
            mover = MLP.create(spec.observation_size + spec.action_size, self.hidden, spec.action_size, km)
        critics = create_critics(spec, self.hidden, 2, kc)
        opts = init_opt(behavior), init_opt(mover), init_opt(critics)
        return State(behavior, mover, critics, copy(mover), copy(critics), *opts)

    def target(self, state, batch, key) -> Float[Array, "b"]:
        """r + discount max_i (lambda min_j Q'_j + (1 - lambda) max_j Q'_j)(s', a_i), a_i of the VAE, moved (eq. 13).

        Of discrete actions a_i are those that are likely enough.
        """
        if isinstance(state.behavior, Categorical):
            mixed = self.mixed(all_q_values(state.target_critics, batch.next_observation))
            likely = supported(state.behavior, self.share, batch.next_observation)
            return backup(batch, self.discount, jnp.where(likely, mixed, -jnp.inf).max(-1))
        drawn = jnp.tanh(state.behavior.sample(batch.next_observation, key, (self.draws,)))
        action = moved(state.target_mover, self.reach, batch.next_observation, drawn)
        q = q_values(state.target_critics, batch.next_observation, action)
        return backup(batch, self.discount, self.mixed(q).max(0))

    def mixed(self, q: Float[Array, "k *b"]) -> Float[Array, "*b"]:
        """lambda times the least of the critics and the rest of the greatest."""
        return self.min_weight * least(q) + (1.0 - self.min_weight) * q.max(0)

    def mover_loss(self, mover: MLP, state, batch, key) -> Array:
        """-Q_1(s, a + move), a drawn from the VAE (eq. 12)."""
        drawn = jax.lax.stop_gradient(jnp.tanh(state.behavior.sample(batch.observation, key)))
        first = jax.tree.map(lambda w: w[:1], state.critics)
        return -q_values(first, batch.observation, moved(mover, self.reach, batch.observation, drawn))[0].mean()

    def update(self, state, batch, *, step, key):
        """VAE, critics, mover, targets."""
        k_behavior, k_target, k_mover = jax.random.split(key, 3)
        fit = jax.grad(models.loss, has_aux=True)
        grads, of_behavior = fit(state.behavior, batch.observation, batch.action, k_behavior)
        behavior, behavior_opt = apply_gradients(state.behavior, grads, state.behavior_opt, self.behavior_lr)
        state = state._replace(behavior=behavior, behavior_opt=behavior_opt)
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(critics=critics, critics_opt=critics_opt)
        if state.mover is None:
            target_critics = polyak_update(state.target_critics, critics, self.target_rate)
            return state._replace(target_critics=target_critics), metrics | of_behavior
        loss, grads = jax.value_and_grad(self.mover_loss)(state.mover, state, batch, k_mover)
        mover, mover_opt = apply_gradients(state.mover, grads, state.mover_opt, self.actor_lr)
        targets = polyak_update((state.target_mover, state.target_critics), (mover, critics), self.target_rate)
        state = state._replace(mover=mover, mover_opt=mover_opt, target_mover=targets[0], target_critics=targets[1])
        return state, metrics | of_behavior | {"actor_loss": loss}

    def policy(self, state):
        """The best of some actions of the VAE, moved, by the first critic; or of the discrete ones that are likely enough."""
        first = jax.tree.map(lambda w: w[0], state.critics)
        if isinstance(state.behavior, Categorical):
            return Supported(state.behavior, first, jnp.asarray(self.share))
        return GreedyQ(Moved(state.behavior, state.mover, jnp.asarray(self.reach)), first, self.test_draws)

    def q_value(self, state, observation, action):
        """The smaller of the two critics."""
        return least(q_values(state.critics, observation, action))
