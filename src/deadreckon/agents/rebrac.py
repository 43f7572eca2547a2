"""ReBRAC (Tarasov et al. 2023): TD3+BC with penalties of their own for actor and critics, and normalised critics."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.agent import backup
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.agents.td3 import TD3
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import FIRST_WEIGHTS, minimum, q_values
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static


class ReBRAC(ScaledRewards, TD3):
    """TD3 with imitation in the actor's loss and in the critics' targets, each with its weight."""

    revision: ClassVar[int] = 2
    fine_tunes: ClassVar[bool] = False
    actor_init, critic_init = FIRST_WEIGHTS["rlkit"]
    other_names: ClassVar[dict[str, str]] = {"actor_bc_coef": "actor_penalty", "critic_bc_coef": "critic_penalty"}

    actor_lr: NonNegative = 1e-3  # learning rate of the actor
    critic_lr: NonNegative = 1e-3  # learning rate of the critics
    actor_penalty: NonNegative = 0.01  # weight of imitation in the actor loss (published: 0.001 to 0.1, by log)
    critic_penalty: NonNegative = 0.01  # weight of imitation in the targets (published: 0 to 0.5, by log)
    layer_norm: bool = static(True)  # whether the critics use layer normalisation
    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    batch_size: Count = static(1024)  # batch size (transitions per update)

    def needs(self, spec):
        """Transitions, and the next logged actions."""
        return BatchSpec((*BatchSpec.columns, "next_action", "follows"), self.batch_size, standardise=self.standardise)

    def target(self, state, batch, key):
        """r + discount (min_j Q'_j(s', a') - critic_penalty |a' - a'_log|^2), a' as TD3's (eq. 5)."""
        action = self.next_action(state, batch, key)
        # Where a recording ends it is not known what the log did next.
        penalty = batch.follows * jnp.square(action - batch.next_action).sum(-1)
        future = minimum(q_values(state.target_critics, batch.next_observation, action)) - self.critic_penalty * penalty
        return backup(batch, self.discount, future)

    def actor_loss(self, actor, state, batch):
        """E[ actor_penalty |pi(s) - a|^2 - min_j Q_j(s, pi(s)) / mean |Q| ], no gradient through the division (eq. 4)."""
        action = jnp.tanh(actor(batch.observation))
        q = minimum(q_values(state.critics, batch.observation, action))
        scale = 1.0 / (jax.lax.stop_gradient(jnp.abs(q).mean()) + 1e-8)
        return (self.actor_penalty * jnp.square(action - batch.action).sum(-1) - scale * q).mean()

    def q_value(self, state, observation, action):
        """The smaller of the two critics, in the log's units; it holds the penalties that are paid later."""
        return self.logged_value(super().q_value(state, observation, action))
