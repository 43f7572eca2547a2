"""CRR (Wang et al. 2020): imitation of the logged actions that are better than the current policy's.

Twin critics with squared errors stand for the paper's distributional ones, which `crr_d.py` has.
"""

from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.agent import capped_exp
from deadreckon.agents.awac import AWAC
from deadreckon.training.hyperparameters import Count, Positive, Sizes, static

Filter = Literal["binary", "exp"]


def filtered(advantage: Float[Array, "b"], by: Filter, temperature: Any, most: Any) -> Float[Array, "b"]:
    """Weights: 1 where the advantage is positive and 0 elsewhere, or exp(advantage / temperature), cut above (eq. 3, 4)."""
    return (advantage > 0).astype(jnp.float32) if by == "binary" else capped_exp(advantage / temperature, most)


class CRR(AWAC):
    """AWAC with several draws, and weights of 0 and 1, or exponential ones."""

    revision: ClassVar[int] = 1

    temperature: Positive = 1.0  # temperature that divides the advantage, with filter="exp" (beta in the paper)
    samples: Count = static(4)  # actions sampled from the policy to estimate its value
    max_weight: Positive = 20.0  # largest weight of a transition in the loss of the actor, with filter="exp"
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    standardise: bool = static(False)  # whether observations are standardised to mean 0 and standard deviation 1
    filter: Filter = static("binary")
    """weight of an action: 1 where its advantage is positive (binary), or exp(advantage)"""

    def weights(self, advantage):
        """See `filtered`."""
        return filtered(advantage, self.filter, self.temperature, self.max_weight)
