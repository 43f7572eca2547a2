"""MOPO (Yu et al. 2020): model-based policy optimisation on a log, with rewards lowered where the model is unsure of itself.

    r~(s, a) = r(s, a) - penalty max_i ||sigma_i(s, a)||

over the networks i of the ensemble, whose deviations are of the observation's change and the reward. As in OfflineRL-Kit the
temperature never exceeds 1.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.dynamics import Branch, Ensemble, Gaussian
from deadreckon.training.hyperparameters import NonNegative


class MOPO(OfflineMBRL):
    """SAC on rollouts whose rewards are penalised by the model's deviation."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"lambda": "penalty", "penalty_coef": "penalty"}
    largest_temperature: ClassVar[float] = 1.0

    penalty: NonNegative = 1.0  # penalty per unit of predicted standard deviation (lambda; published: 0.5 to 5, by log)

    def penalised(self, ensemble, found, rows):
        """Lowers the rewards."""
        penalties = [self.penalty * deviation(self.model, ensemble, branch) for branch in found]
        return [branch._replace(reward=branch.reward - penalty) for branch, penalty in zip(found, penalties)]


@eqx.filter_jit
def deviation(model: Gaussian, ensemble: Ensemble, branch: Branch) -> Float[Array, "n"]:
    """The greatest norm of a network's standard deviations, over all networks."""
    inputs = ensemble.standardise(jnp.concatenate([branch.observation, branch.action], -1))
    _, log_variance, _ = model.heads(ensemble.params, jnp.broadcast_to(inputs, (model.members, *inputs.shape)))
    return jnp.sqrt(jnp.exp(log_variance).sum(-1)).max(0)
