"""CRR (Wang et al. 2020): imitation of the logged actions that are better than what the present policy does.

Twin critics with squared errors stand for the paper's distributional ones.
"""

from typing import Literal

import jax.numpy as jnp

from deadreckon.agents.awac import AWAC
from deadreckon.training.hyperparameters import Count, Positive, static


class CRR(AWAC):
    """AWAC with several draws, and weights of 0 and 1, or exponential ones."""

    draws: Count = static(4)  # actions of the policy that its value is the mean of
    max_weight: Positive = 20.0  # of a row in the actor's loss, where it is exponential
    filter: Literal["binary", "exp"] = static("binary")  # whether an action counts where it is better, or by exp(advantage)

    def weights(self, advantage):
        """1 where the advantage is positive and 0 elsewhere, or exp(advantage / temperature), cut above (eq. 3, 4)."""
        return (advantage > 0).astype(jnp.float32) if self.filter == "binary" else super().weights(advantage)
