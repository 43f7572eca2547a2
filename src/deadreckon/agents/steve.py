"""Stochastic ensemble value expansion (Buckman et al. 2018) on top of SAC: targets of all horizons, weighted by certainty.

From a real transition every network of the model makes a rollout of its own, and every target critic closes it after each of
its steps. With mean and variance over both,

    y = sum_{h=0}^{H} w_h mean_h,    w_h proportional to 1 / variance_h

so that the model is used as far as networks and critics agree on it. The horizons of a row share their draws of the policy.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.model_based import ModelBasedSAC
from deadreckon.dynamics import ended
from deadreckon.errors import UserError
from deadreckon.nets.mlp import q_values
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, CountOrZero, static

_LEAST = 1e-8  # variance, where all agree


class Target(NamedTuple):
    """What critics are held to, and the mean horizon that it comes from."""

    value: Float[Array, "b"]
    horizon: Float[Array, "b"]


class STEVE(ModelBasedSAC):
    """SAC whose targets weigh all horizons of an ensemble's rollouts."""

    revision: ClassVar[int] = 1

    horizon: CountOrZero = static(3)  # largest rollout horizon H in steps of the model
    critics: Count = static(4)  # number of Q-networks, whose variance is part of the weights

    def resolve(self, spec, steps):
        """Refuses one critic, whose targets without a step in the model have no variance, and so all of the weight."""
        agent = super().resolve(spec, steps)
        if agent.critics < 2:
            raise UserError(f"STEVE.critics must be 2 or more, got {agent.critics}")
        return agent

    def target(self, state, batch, key):
        """y above."""
        targets = self.targets(state, batch, key)
        weight = 1.0 / (targets.var((1, 2)) + _LEAST)
        weight = weight / weight.sum(0)
        horizon = jnp.arange(self.horizon + 1.0)[:, None]
        return Target((weight * targets.mean((1, 2))).sum(0), (weight * horizon).sum(0))

    def targets(self, state, batch, key) -> Float[Array, "h e c b"]:
        """Targets of every horizon, network and critic."""
        elites, model = self.elites, state.model
        spread = lambda x: jnp.broadcast_to(x, (elites, *x.shape))  # noqa: E731
        observation, so_far = spread(batch.next_observation), spread(batch.reward)
        discount = spread(self.discount * (1.0 - batch.terminal))
        found = []
        for h in range(self.horizon + 1):
            k_act, k_draw, k_end = keys(jax.random.fold_in(key, h), "act", "next", "end")
            action, bonus = self.act(state, observation, jax.random.normal(k_act, batch.action.shape))
            value = q_values(state.target_critics, observation, action) + bonus
            found.append(so_far[:, None] + discount[:, None] * jnp.moveaxis(value, 0, 1))
            if h == self.horizon:
                break
            inputs = model.standardise(jnp.concatenate([observation, action], -1))
            drawn, logit = self.model.sample(model.best(), inputs, k_draw)
            following = observation + drawn[..., :-1]
            over = ended(self.over, following, logit, k_end)
            # A step with NaN or infinite numbers does not count: the rollout stays where it was.
            lost = ~jnp.isfinite(drawn).all(-1)
            so_far = jnp.where(lost, so_far, so_far + discount * (drawn[..., -1] + bonus))
            discount = jnp.where(lost, discount, discount * self.discount * (1.0 - over))
            observation = jnp.where(lost[..., None], observation, following)
        return jnp.stack(found)

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors of all critics; also tells the mean horizon."""
        loss, metrics = super().critic_loss(critics, state, batch, target.value, key)
        return loss, metrics | {"horizon": target.horizon.mean()}
