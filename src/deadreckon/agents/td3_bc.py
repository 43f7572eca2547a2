"""TD3+BC (Fujimoto and Gu 2021): TD3 whose actor also imitates the log."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.td3 import TD3
from deadreckon.nets.mlp import q_values
from deadreckon.training.hyperparameters import NonNegative, static


class TD3BC(TD3):
    """TD3 with one more term in the actor's loss, and standardised observations."""

    revision: ClassVar[int] = 1
    supports_images: ClassVar[bool] = True

    alpha: NonNegative = 2.5  # weight of the value relative to imitation (eq. 5)
    standardise: bool = static(True)  # whether flat observations are standardised to mean 0 and standard deviation 1 (eq. 6)

    def actor_loss(self, actor, state, batch):
        """-lambda Q_1(s, pi(s)) + |pi(s) - a|^2 with lambda = alpha / mean |Q_1|, no gradient through lambda (eq. 3, 5)."""
        action = jnp.tanh(actor(batch.observation))
        first = jax.tree.map(lambda w: w[:1], state.critics)
        q = q_values(first, batch.observation, action)[0]
        weight = self.alpha / jax.lax.stop_gradient(jnp.abs(q).mean())
        return -weight * q.mean() + jnp.square(action - batch.action).mean()
