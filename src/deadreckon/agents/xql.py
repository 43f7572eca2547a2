"""XQL (Garg et al. 2023): IQL whose values are a soft maximum over the log's actions, by Gumbel regression."""

import jax.numpy as jnp

from deadreckon.agents.iql import IQL


class XQL(IQL):
    """IQL with the Gumbel loss instead of expectiles (the field `expectile` has no part in it)."""

    temperature: float = 2.0  # beta of the values: large is the mean of the log's actions, small the best (published: 1 to 10)
    most_gap: float = 7.0  # of (Q - V) / temperature in the loss, beyond which its slope is 0

    def value_loss(self, value, batch, q):
        """E[ e^z - z - 1 ], z = (Q - V) / temperature, cut above; its minimum is temperature log E[ e^(Q / temperature) ]."""
        z = jnp.minimum((q - value(batch.observation)[..., 0]) / self.temperature, self.most_gap)
        return (jnp.exp(z) - z - 1.0).mean()
