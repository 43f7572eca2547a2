"""SAC-N (An et al. 2021): SAC on a fixed log with enough critics that their minimum keeps it close to the log.

The order of steps is temperature, actor, critics, and networks are initialised as in the public code: biases of hidden layers
are 0.1,
last layers are close to zero.
"""

from typing import ClassVar

import jax.numpy as jnp

from deadreckon.agents.sac import SAC
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.nets.mlp import FirstWeights
from deadreckon.nets.optim import polyak_update
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Sizes, static
from deadreckon.training.later_fields import later


class SACN(ScaledRewards, SAC):
    """SAC with an ensemble of critics."""

    revision: ClassVar[int] = 2
    supports_discrete: ClassVar[bool] = False
    online: ClassVar[bool] = False

    critics: Count = static(10)
    """number of Q-networks, of which the minimum is used (published: halfcheetah 10, walker2d 20, hopper 500)"""
    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    first_weights: FirstWeights = later("rlkit")  # initial weights: "uniform", "glorot", "orthogonal" or "rlkit"

    def update(self, state, batch, *, step, key):
        """Temperature, actor, critics, targets: each by what those before it have become."""
        k_target, k_critics, k_entropy, k_actor = keys(key, "target", "critic_loss", "entropy", "actor_loss")
        _, log_prob = self.actor_loss(state.actor, state, batch, k_entropy)
        state = self.update_temperature(state, log_prob)
        state, loss, log_prob = self.update_actor(state, batch, step, k_actor)
        state, metrics = self.update_critics(state, batch, k_target, k_critics)
        state = state._replace(target_critics=polyak_update(state.target_critics, state.critics, self.tau))
        return state, metrics | {"actor_loss": loss, "entropy": -log_prob, "temperature": jnp.exp(state.log_temperature)}

    def q_value(self, state, observation, action):
        """Minimum over the critics, in the log's units; includes the entropy bonus of later steps."""
        return self.logged_value(super().q_value(state, observation, action))
