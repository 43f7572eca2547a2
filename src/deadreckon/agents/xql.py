"""XQL (Garg et al. 2023): IQL whose values are a soft maximum over the log's actions, by Gumbel regression."""

import jax
import jax.numpy as jnp

from deadreckon.agents.iql import IQL
from deadreckon.training.hyperparameters import NonNegative, Positive


class XQL(IQL):
    """IQL with the Gumbel loss instead of expectiles (the field `expectile` has no part in it)."""

    temperature: Positive = 2.0  # beta: large is the mean of the log's actions, small the best of them (published: 0.55 to 10)
    most_gap: NonNegative = 7.0  # of (Q - V) / temperature in the loss, beyond which its slope is 0

    def value_loss(self, value, batch, q):
        """E[ e^z - z - 1 ], z = (Q - V) / temperature, cut above; its minimum is temperature log E[ e^(Q / temperature) ].

        As in the public code the batch's loss is divided by e^(max z), where that is more than 1/e: slopes would be 1,000
        while values are far too low.
        """
        z = jnp.minimum((q - value(batch.observation)[..., 0]) / self.temperature, self.most_gap)
        most = jax.lax.stop_gradient(jnp.maximum(z.max(), -1.0))
        return (jnp.exp(z - most) - (z + 1.0) * jnp.exp(-most)).mean()
