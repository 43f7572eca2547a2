"""MOReL (Kidambi et al. 2020): rollouts end, and are punished, where the networks of the model disagree too much.

    disc(s, a) = max_{i, j} ||mu_i(s, a) - mu_j(s, a)||

over the networks' means of the standardised changes and reward. Beyond a threshold the rollout falls into a state where nothing
follows, which is worth less than the worst that the log's rewards allow: a pessimistic world. Here its policy is SAC's; the
paper's is a natural policy gradient.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.dynamics import Ensemble, Gaussian
from deadreckon.dynamics.model import unsaid
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import NonNegative, Positive

ROWS = 10_000  # of the log, from which the threshold is taken
LEAST = 1e-6  # deviation of what changes


class MOReL(OfflineMBRL):
    """SAC in a world that ends where the model does not know it."""

    # 3: what ends a rollout is worse than any other way to go on, also where rewards are negative; 4: what never changes in the
    # log does not count in the disagreement
    revision: ClassVar[int] = 4

    threshold: Positive = 1.0 / 3.0
    """disagreement beyond which rollouts end, in multiples of the largest on 10,000 logged transitions"""
    penalty: NonNegative = 30.0  # distance of the value of unknown states below the worst that logged rewards allow

    def resolve(self, spec, steps):
        """Refuses one network, which has no disagreement, and a discount under which negative rewards have no worst value."""
        agent = super().resolve(spec, steps)
        if agent.members < 2:
            raise UserError(f"MOReL.members must be 2 or more, got {agent.members}")
        if agent.discount >= 1.0 and spec.rows and spec.reward.min < 0.0:
            raise UserError("MOReL.discount must be below 1 where rewards are negative: unknown states must be worse than any")
        return agent

    def penalised(self, ensemble, found, rows):
        """Ends rollouts where the model is not to be trusted."""
        known = rows.take(np.linspace(0, rows.count - 1, min(ROWS, rows.count)).astype(int))
        scale = units(known)
        usual = disagreement(self.model, ensemble, scale, *(jnp.asarray(known[name]) for name in ("observation", "action")))
        limit = self.threshold * usual.max()
        worst = float(rows.log.spec.reward.min)
        # The paper's halting state is absorbing: to end with one reward would be better than to go on with many negative ones.
        least = (worst / (1.0 - self.discount) if worst < 0.0 else worst) - self.penalty
        trusted, kept = jnp.ones(len(found[0].reward), bool), []
        for branch in found:
            lost = ~(disagreement(self.model, ensemble, scale, branch.observation, branch.action) <= limit)  # NaN is lost, too
            reward = jnp.where(lost, least, branch.reward)
            kept.append(branch._replace(reward=reward, terminal=branch.terminal | lost, running=branch.running & trusted))
            trusted = trusted & ~lost
        return kept


def units(known: dict[str, np.ndarray]) -> Float[Array, "d"]:
    """What disagreement is counted in: the deviations of changes and of the reward over some rows.

    Of what never changes, such as zeros that pad an observation or a reward of 1 a step, it is 1: in units of nothing, errors
    of the fit there would be all that counts.
    """
    change = known["next_observation"] - known["observation"]
    told = ~unsaid(known["observation"], known["next_observation"], np.reshape(known["terminal"], -1))
    deviation = np.append(change[told].std(0) if told.any() else np.zeros(change.shape[1]), known["reward"].std())
    return jnp.asarray(np.where(deviation < LEAST, 1.0, deviation + LEAST))


@eqx.filter_jit
def disagreement(
    model: Gaussian, ensemble: Ensemble, scale: Array, observation: Array, action: Array
) -> Float[Array, "n"]:
    """The greatest distance between the means of two networks, each number in units of `scale`."""
    inputs = ensemble.standardise(jnp.concatenate([observation, action], -1))
    mean = model.heads(ensemble.params, jnp.broadcast_to(inputs, (model.members, *inputs.shape)))[0] / scale
    return jnp.linalg.norm(mean[:, None] - mean[None], axis=-1).max((0, 1))
