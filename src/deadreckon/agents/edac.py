"""EDAC (An et al. 2021): SAC-N whose critics are kept apart, so that fewer of them do.

The critics' slopes in the logged actions are made to point in different ways: to their squared errors comes

    diversity E[ 1 / (N - 1) sum_{i != j} <g_i, g_j> ],   g_i = grad_a Q_i(s, a) / |grad_a Q_i(s, a)|.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.sac_n import SACN
from deadreckon.data.batch import Batch
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.training.hyperparameters import Count, NonNegative, static


class EDAC(SACN):
    """SAC-N with diversified critics."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"eta": "diversity"}

    critics: Count = static(10)
    """number of Q-networks, of which the minimum is used (published: halfcheetah and walker2d 10, hopper 50)"""
    diversity: NonNegative = 1.0
    """weight of the similarity of the critics' gradients (eta; published: 0 to 5 in Gym-MuJoCo, by log)"""

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors, and the likeness of slopes."""
        loss, metrics = super().critic_loss(critics, state, batch, target, key)
        alike = likeness(critics, batch)
        return loss + self.diversity * alike, metrics | {"likeness": alike}


def likeness(critics: MLP, batch: Batch) -> Float[Array, ""]:
    """Mean over rows of what each critic's unit slope has in common with the others': N where all are the same (eq. 9)."""

    def total(critic: MLP, action: Array) -> Array:
        return q_values(jax.tree.map(lambda leaf: leaf[None], critic), batch.observation, action)[0].sum()

    slopes = jax.vmap(lambda critic: jax.grad(total, 1)(critic, batch.action))(critics)  # (N, b, a)
    unit = slopes / (jnp.sqrt(jnp.square(slopes).sum(-1, keepdims=True) + 1e-20) + 1e-10)
    # The sum over pairs is the square of the sum, less what each has in common with itself.
    pairs = jnp.square(unit.sum(0)).sum(-1) - jnp.square(unit).sum((0, -1))
    return pairs.mean() / max(len(slopes) - 1, 1)
