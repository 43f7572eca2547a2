"""XQL (Garg et al. 2023): IQL whose values are a soft maximum over the log's actions, by Gumbel regression."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.iql import IQL
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import Fraction, NonNegative, Positive, static


class XQL(IQL):
    """IQL with the Gumbel loss instead of expectiles."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"temperature": "loss_temperature", "most_gap": "max_clip"}

    expectile: Fraction = IQL.expectile  # not used: the Gumbel loss takes its place, with loss_temperature
    layer_norm: bool = static(True)  # whether the value network uses layer normalisation
    loss_temperature: Positive = 2.0
    """temperature of the Gumbel loss, beta in the paper: large is the mean, small the maximum (published: 0.55 to 10)"""
    max_clip: NonNegative = 7.0  # largest (Q - V) / loss_temperature in the loss; its gradient is 0 beyond

    def resolve(self, spec, steps):
        """IQL's; an expectile would have no effect."""
        if self.expectile != IQL.expectile:
            raise UserError(f"XQL has no expectile but loss_temperature; leave it out, got {self.expectile:g}")
        return super().resolve(spec, steps)

    def value_loss(self, value, batch, q):
        """E[ e^z - z - 1 ], z = (Q - V) / temperature, cut above; its minimum is temperature log E[ e^(Q / temperature) ].

        As in the public code the batch's loss is divided by e^(max z), where that is more than 1/e: slopes would be 1,000
        while values are far too low.
        """
        z = jnp.minimum((q - value(batch.observation)[..., 0]) / self.loss_temperature, self.max_clip)
        most = jax.lax.stop_gradient(jnp.maximum(z.max(), -1.0))
        return (jnp.exp(z - most) - (z + 1.0) * jnp.exp(-most)).mean()
