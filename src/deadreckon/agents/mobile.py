"""MOBILE (Sun et al. 2023): values lowered where the networks of the model disagree about what comes after.

    y = max(r - penalty u(s, a) + discount (1 - d) min_j Q'_j(s', a'), floor)
    u(s, a) = std over networks i of  mean over s'_i ~ p_i(s, a) of  min_j Q'_j(s'_i, a'_i),   a'_i ~ pi(s'_i)

which is the inconsistency of the Bellman backup under the model. Logged rows are not doubted. As in the public code the targets
hold no entropy bonus and are cut at a floor.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.dreaming import Dreaming
from deadreckon.agents.sac import State
from deadreckon.data.batch import Batch
from deadreckon.dynamics import Ensemble
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, least, q_values
from deadreckon.training.hyperparameters import Count, NonNegative, Number, static


class MOBILE(Dreaming):
    """SAC on rollouts whose values are penalised by the model's Bellman inconsistency."""

    entropy_backup: bool = static(False)  # whether targets hold the entropy bonus too
    floor: Number | None = 0.0  # least target, where rewards are positive; None: none
    penalty: NonNegative = 1.5  # of a unit of inconsistency (published: 0.1 to 2, by log)
    draws: Count = static(10)  # next observations drawn from each network

    def resolve(self, spec, steps):
        """Refuses a single network, which has nobody to disagree with."""
        if self.elites < 2:
            raise UserError(f"MOBILE.elites must be 2 or more, got {self.elites}")
        return super().resolve(spec, steps)

    def mixed(self, state, batch, key):
        """Lowers the rewards of made-up rows, which lowers their targets by as much."""
        k_rows, k_draw = jax.random.split(key)
        rows = super().mixed(state, batch, k_rows)
        made_up = jnp.arange(self.batch_size) >= self.logged_rows
        doubt = jnp.where(made_up, self.inconsistency(state, state.model.ensemble, rows, k_draw), 0.0)
        return rows._replace(reward=rows.reward - self.penalty * doubt)

    def inconsistency(self, state: State, ensemble: Ensemble, rows: Batch, key: Array) -> Float[Array, "b"]:
        """u above, with the target critics, over the elites."""
        k_model, k_policy = jax.random.split(key)
        inputs = ensemble.standardise(jnp.concatenate([rows.observation, rows.action], -1))
        inputs = jnp.broadcast_to(inputs, (self.elites, *inputs.shape))
        mean, log_variance, _ = self.model.heads(ensemble.best(), inputs)
        noise = jax.random.normal(k_model, (self.draws, *mean.shape))
        change = (mean + jnp.exp(0.5 * log_variance) * noise)[..., :-1]
        following = (rows.observation + change).reshape(-1, change.shape[-1])
        assert isinstance(state.actor, MLP)  # its actions are continuous
        action = jnp.tanh(dist.sample(dist.gaussian_head(state.actor(following)), k_policy))
        value = least(q_values(state.target_critics, following, action))
        return value.reshape(self.draws, self.elites, -1).mean(0).std(0, ddof=1)

    def target(self, state, batch, key):
        """SAC's, cut at the floor."""
        target = super().target(state, batch, key)
        return target if self.floor is None else jnp.maximum(target, self.floor)
