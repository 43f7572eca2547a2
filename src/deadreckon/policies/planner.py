"""A policy that plans in a learned model by the cross-entropy method (PETS, Chua et al. 2018)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.terminations import LEARNED, termination
from deadreckon.dynamics import Gaussian, ended
from deadreckon.nets.mlp import MLP
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.randomness import keys


class Planner(NormalizedPolicy):
    """Plans in an ensemble of Gaussian networks by the cross-entropy method.

    Attributes:
        nets, bounds: of the networks, as `dynamics.Gaussian` has them.
        mean, std: of their inputs.
        size: of an action.
        termination: task that tells when episodes end, or "learned".
        horizon, population, cem_elites, cem_iterations, particles, smoothing: see `PETS`.
    """

    nets: MLP
    bounds: Array
    mean: Array
    std: Array
    size: int = eqx.field(static=True)
    termination: str = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    population: int = eqx.field(static=True)
    cem_elites: int = eqx.field(static=True)
    cem_iterations: int = eqx.field(static=True)
    particles: int = eqx.field(static=True)
    smoothing: float = eqx.field(static=True)

    def start(self, n: int) -> Float[Array, "n t a"]:
        """A plan of doing nothing for each environment."""
        return jnp.zeros((n, self.horizon, self.size))

    def act(self, step, carry, key, *, greedy):
        """The first action of every plan, and the plans for the next step; `greedy` plans all draw the same."""
        carry = jnp.where(jnp.asarray(step.first, bool)[:, None, None], 0.0, carry)
        # One environment after the other: a plan alone fills the cores, and memory.
        own = jnp.broadcast_to(jax.random.key(0), len(carry)) if greedy else jax.random.split(key, len(carry))
        plans = jax.lax.map(lambda each: self.plan(*each), (jnp.asarray(step.observation, jnp.float32), carry, own))
        return plans[:, 0], jnp.concatenate([plans[:, 1:], jnp.zeros_like(plans[:, :1])], 1)

    def plan(self, observation: Float[Array, "o"], before: Float[Array, "t a"], key: PRNGKeyArray) -> Float[Array, "t a"]:
        """The mean of the last iteration's distribution, which begins around the plan from before."""

        def improve(i: Array, distribution: tuple[Array, Array]) -> tuple[Array, Array]:
            mean, variance = distribution
            k_draw, k_follow = keys(jax.random.fold_in(key, i), "population", "particles")
            # Within two deviations of the mean, which do not reach beyond the bounds -1 and 1.
            near = jnp.minimum(jnp.square((mean + 1.0) / 2.0), jnp.square((1.0 - mean) / 2.0))
            noise = jax.random.truncated_normal(k_draw, -2.0, 2.0, (self.population, *mean.shape))
            actions = mean + jnp.sqrt(jnp.minimum(near, variance)) * noise
            best = actions[jax.lax.top_k(self.returns(observation, actions, k_follow), self.cem_elites)[1]]
            keep = self.smoothing
            return keep * mean + (1 - keep) * best.mean(0), keep * variance + (1 - keep) * best.var(0)

        return jax.lax.fori_loop(0, self.cem_iterations, improve, (before, jnp.full_like(before, 0.25)))[0]

    def returns(self, observation: Float[Array, "o"], actions: Float[Array, "p t a"], key: PRNGKeyArray) -> Float[Array, "p"]:
        """Mean sum of rewards of each sequence, over its particles."""
        members = self.bounds.shape[0]
        rows = self.population * (self.particles // members)
        params = {"nets": self.nets, "bounds": self.bounds, "choices": jnp.zeros((members, 0, 0))}
        model, over = Gaussian(members), None if self.termination == LEARNED else termination(self.termination).ends

        def step(carry: tuple[Array, Array, Array], now: tuple[Array, Array]) -> tuple[tuple[Array, Array, Array], None]:
            seen, alive, total = carry
            action, own = now
            k_draw, k_end = keys(own, "next", "end")
            done = jnp.broadcast_to(jnp.repeat(action, self.particles // members, 0), (members, rows, self.size))
            inputs = (jnp.concatenate([seen, done], -1) - self.mean) / self.std
            drawn, logit = model.sample(params, inputs, k_draw)
            following = seen + drawn[..., :-1]
            earned = jnp.where(alive > 0, drawn[..., -1], 0.0)  # whatever the numbers are after an end
            return (following, alive * (1.0 - ended(over, following, logit, k_end)), total + earned), None

        ones = jnp.ones((members, rows))
        begin = jnp.broadcast_to(observation, (members, rows, len(observation))), ones, 0.0 * ones
        steps = jax.random.split(key, self.horizon)
        total = jax.lax.scan(step, begin, (jnp.moveaxis(actions, 1, 0), steps))[0][2]
        found = total.reshape(members, self.population, -1).mean((0, 2))
        return jnp.where(jnp.isfinite(found), found, -jnp.inf)
