"""REM (Agarwal et al. 2020; thesis 7.4): SAC on random mixtures of many critics.

Every update draws weights w on the simplex and asks that the mixture agree with its own target,

    L = E[ ( sum_k w_k Q_k(s, a) - r - discount sum_k w_k Q'_k(s', a') )^2 ];

the actor follows the mean of the critics. REM was made for discrete actions, of which it takes the best by that mean.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.sac import SAC
from deadreckon.nets.mlp import q_values
from deadreckon.training.hyperparameters import Count, static


class REM(SAC):
    """SAC on mixtures of critics."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = False
    supports_discrete: ClassVar[bool] = True

    critics: Count = static(10)  # number of Q-networks (published, as heads of one network: 200)

    def min_q(self, values):
        """The mean."""
        return values.mean(0)

    def target_q(self, values):
        """All of them: what is linear can be mixed later."""
        return values

    def critic_loss(self, critics, state, batch, target, key):
        """The squared error of one random mixture, of critics and of their targets."""
        weight = simplex(key, self.critics)
        q = q_values(critics, batch.observation, batch.action)
        error = jnp.square(weight @ (q - jax.lax.stop_gradient(target)))
        return error.mean(), {"critic_loss": error.mean(), "q": q.mean()}


def simplex(key: Array, count: int) -> Float[Array, "k"]:
    """Uniform numbers divided by their sum."""
    drawn = jax.random.uniform(key, (count,))
    return drawn / drawn.sum()
