"""DQfD on a fixed log (Hester et al. 2018; thesis 4.4): TD3 whose critics hold the logged action above all others by a margin.

To the squared errors of each critic j comes, as the supervised loss of DQfD with actions that are drawn instead of enumerated,

    margin_weight E[ max_a (Q_j(s, a) + margin 1(a != a_log)) - Q_j(s, a_log) ],

the maximum over the logged action, the actor's, and `samples` uniform ones.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.td3 import TD3
from deadreckon.data.batch import Batch
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.training.hyperparameters import Count, NonNegative, static


class DQfD(TD3):
    """TD3 with a large-margin loss."""

    revision: ClassVar[int] = 1
    fine_tunes: ClassVar[bool] = False
    other_names: ClassVar[dict[str, str]] = {"draws": "samples"}

    margin: NonNegative = 0.8  # margin by which logged actions have to be better than others
    margin_weight: NonNegative = 1.0  # weight of the margin loss relative to the squared errors
    samples: Count = static(10)  # uniform actions that a logged one is compared with

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors, and how far the margin is missed."""
        loss, metrics = super().critic_loss(critics, state, batch, target, key)
        missed = self.missed(critics, state.actor, batch, key)
        return loss + self.margin_weight * missed.mean(-1).sum(), metrics | {"margin_missed": missed.mean()}

    def missed(self, critics: MLP, actor: MLP, batch: Batch, key: Array) -> Float[Array, "k b"]:
        """max_a (Q_j(s, a) + margin 1(a != a_log)) - Q_j(s, a_log), never below zero."""
        uniform = jax.random.uniform(key, (self.samples, *batch.action.shape), minval=-1.0, maxval=1.0)
        others = jnp.concatenate([jnp.tanh(actor(batch.observation))[None], uniform])
        best = q_values(critics, batch.observation, others).max(1)
        return jnp.maximum(best + self.margin - q_values(critics, batch.observation, batch.action), 0.0)
