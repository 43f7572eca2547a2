"""MOBILE (Sun et al. 2023): values lowered where the networks of the model disagree about what comes after.

    y = max(r - penalty u(s, a) + discount (1 - d) min_j Q'_j(s', a'), min_target)
    u(s, a) = std over networks i of  mean over s'_i ~ p_i(s, a) of  min_j Q'_j(s'_i, a'_i),   a'_i ~ pi(s'_i)

which is the inconsistency of the Bellman backup under the model. Logged rows are not penalised. As in the public code the
targets hold no entropy bonus and are cut below, at `min_target`, and the temperature never exceeds 1.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.agents.sac import State
from deadreckon.data.batch import Batch
from deadreckon.dynamics import Ensemble
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, minimum, q_values
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Number, static


class MOBILE(OfflineMBRL):
    """SAC on rollouts whose values are penalised by the model's Bellman inconsistency."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"floor": "min_target", "penalty_coef": "penalty", "draws": "samples"}
    largest_temperature: ClassVar[float] = 1.0

    entropy_backup: bool = static(False)  # whether the critics' targets include the entropy bonus
    min_target: Number | None = 0.0  # smallest target; None: no limit, which rewards that are all negative need
    penalty: NonNegative = 1.5  # penalty per unit of Bellman inconsistency (published: 0.1 to 5, by log)
    samples: Count = static(10)  # next observations sampled from each network

    def resolve(self, spec, steps):
        """Refuses a single network, which has no disagreement, and a lower limit that would apply to every target."""
        agent = super().resolve(spec, steps)
        if self.elites < 2:
            raise UserError(f"MOBILE.elites must be 2 or more, got {self.elites}")
        if spec.rows and self.min_target is not None and spec.reward.max <= 0.0 <= self.min_target:
            raise UserError(
                f"MOBILE.min_target is {self.min_target:g}, the smallest target of the critics, but no reward of {spec.name} "
                "is above 0, so that all targets would be the same: give min_target=None"
            )
        return agent

    def mixed(self, state, batch, key):
        """Lowers the rewards of made-up rows, which lowers their targets by as much."""
        k_rows, k_penalty = keys(key, "mixed", "inconsistency")
        rows = super().mixed(state, batch, k_rows)
        made_up = jnp.arange(self.batch_size) >= self.real_batch_size
        inconsistency = jnp.where(made_up, self.inconsistency(state, state.model.ensemble, rows, k_penalty), 0.0)
        return rows._replace(reward=rows.reward - self.penalty * inconsistency)

    def inconsistency(self, state: State, ensemble: Ensemble, rows: Batch, key: Array) -> Float[Array, "b"]:
        """u above, with the target critics, over the elites."""
        k_model, k_policy = keys(key, "model", "policy")
        inputs = ensemble.standardise(jnp.concatenate([rows.observation, rows.action], -1))
        inputs = jnp.broadcast_to(inputs, (self.elites, *inputs.shape))
        mean, log_variance, _ = self.model.heads(ensemble.best(), inputs)
        noise = jax.random.normal(k_model, (self.samples, *mean.shape))
        change = (mean + jnp.exp(0.5 * log_variance) * noise)[..., :-1]
        following = (rows.observation + change).reshape(-1, change.shape[-1])
        assert isinstance(state.actor, MLP)  # its actions are continuous
        action = jnp.tanh(dist.sample(dist.gaussian_head(state.actor(following)), k_policy))
        value = minimum(q_values(state.target_critics, following, action))
        return value.reshape(self.samples, self.elites, -1).mean(0).std(0, ddof=1)

    def target(self, state, batch, key):
        """SAC's, cut at the floor."""
        target = super().target(state, batch, key)
        return target if self.min_target is None else jnp.maximum(target, self.min_target)
