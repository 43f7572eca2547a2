"""PETS (Chua et al. 2018): no policy is learned; actions are planned in an ensemble, anew at every step (thesis 5.4).

The cross-entropy method draws sequences of `horizon` actions, follows each with `particles` rollouts, each in one network all
along (TS-infinity), and moves its distribution towards the best sequences. The first action of its mean is done; the rest is
where the next step begins to plan. The reward is the ensemble's, as in MBPO, where PETS was told it.
"""

from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.modelled import LEARNED, ModelledOnline
from deadreckon.data.batch import Needs
from deadreckon.data.spec import Spec
from deadreckon.dynamics import Ensemble, Gaussian, ended
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.policies.policy import Inner
from deadreckon.tasks.registry import task
from deadreckon.training.learner import static


class State(NamedTuple):
    """The ensemble alone."""

    model: Ensemble


class Planner(Inner):
    """Plans in an ensemble of Gaussian networks by the cross-entropy method.

    Attributes:
        nets, bounds: of the networks, as `dynamics.Gaussian` has them.
        mean, std: of their inputs.
        size: of an action.
        ends: task that tells when episodes end, or "learned".
        horizon, population, chosen, iterations, particles, smoothing: see `PETS`.
    """

    nets: MLP
    bounds: Array
    mean: Array
    std: Array
    size: int = eqx.field(static=True)
    ends: str = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    population: int = eqx.field(static=True)
    chosen: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    particles: int = eqx.field(static=True)
    smoothing: float = eqx.field(static=True)

    def start(self, n: int) -> Float[Array, "n t a"]:
        """A plan of doing nothing for each environment."""
        return jnp.zeros((n, self.horizon, self.size))

    def act(self, step, carry, key, *, greedy):
        """The first action of every plan, and the plans for the next step; `greedy` changes nothing."""
        carry = jnp.where(jnp.asarray(step.first, bool)[:, None, None], 0.0, carry)
        # One environment after the other: a plan alone fills the cores, and memory.
        keys = jax.random.split(key, len(carry))
        plans = jax.lax.map(lambda each: self.plan(*each), (jnp.asarray(step.observation, jnp.float32), carry, keys))
        return plans[:, 0], jnp.concatenate([plans[:, 1:], jnp.zeros_like(plans[:, :1])], 1)

    def plan(self, observation: Float[Array, "o"], before: Float[Array, "t a"], key: PRNGKeyArray) -> Float[Array, "t a"]:
        """The mean of the last iteration's distribution, which begins around the plan from before."""

        def improve(i: Array, distribution: tuple[Array, Array]) -> tuple[Array, Array]:
            mean, variance = distribution
            k_draw, k_follow = jax.random.split(jax.random.fold_in(key, i))
            # Within two deviations of the mean, which do not reach beyond the bounds -1 and 1.
            near = jnp.minimum(jnp.square((mean + 1.0) / 2.0), jnp.square((1.0 - mean) / 2.0))
            noise = jax.random.truncated_normal(k_draw, -2.0, 2.0, (self.population, *mean.shape))
            actions = mean + jnp.sqrt(jnp.minimum(near, variance)) * noise
            best = actions[jax.lax.top_k(self.returns(observation, actions, k_follow), self.chosen)[1]]
            keep = self.smoothing
            return keep * mean + (1 - keep) * best.mean(0), keep * variance + (1 - keep) * best.var(0)

        return jax.lax.fori_loop(0, self.iterations, improve, (before, jnp.full_like(before, 0.25)))[0]

    def returns(self, observation: Float[Array, "o"], actions: Float[Array, "p t a"], key: PRNGKeyArray) -> Float[Array, "p"]:
        """Mean sum of rewards of each sequence, over its particles."""
        members = self.bounds.shape[0]
        rows = self.population * (self.particles // members)
        params = {"nets": self.nets, "bounds": self.bounds, "choices": jnp.zeros((members, 0, 0))}
        model, over = Gaussian(members), None if self.ends == LEARNED else task(self.ends).ends

        def step(carry: tuple[Array, Array, Array], now: tuple[Array, Array]) -> tuple[tuple[Array, Array, Array], None]:
            seen, alive, total = carry
            action, key = now
            k_draw, k_end = jax.random.split(key)
            done = jnp.broadcast_to(jnp.repeat(action, self.particles // members, 0), (members, rows, self.size))
            inputs = (jnp.concatenate([seen, done], -1) - self.mean) / self.std
            drawn, logit = model.sample(params, inputs, k_draw)
            following = seen + drawn[..., :-1]
            earned = jnp.where(alive > 0, drawn[..., -1], 0.0)  # whatever the numbers are after an end
            return (following, alive * (1.0 - ended(over, following, logit, k_end)), total + earned), None

        ones = jnp.ones((members, rows))
        begin = jnp.broadcast_to(observation, (members, rows, len(observation))), ones, 0.0 * ones
        keys = jax.random.split(key, self.horizon)
        total = jax.lax.scan(step, begin, (jnp.moveaxis(actions, 1, 0), keys))[0][2]
        found = total.reshape(members, self.population, -1).mean((0, 2))
        return jnp.where(jnp.isfinite(found), found, -jnp.inf)


class PETS(ModelledOnline):
    """Planning with trajectory sampling; its settings are those published for HalfCheetah."""

    online: ClassVar[bool] = True

    horizon: int = static(30)  # actions of a plan
    population: int = static(500)  # sequences drawn each time
    chosen: int = static(50)  # of them are moved towards
    iterations: int = static(5)  # of drawing and moving
    particles: int = static(20)  # rollouts of each sequence, as many in each elite
    smoothing: float = static(0.1)  # share of the old distribution that is kept
    batch_size: int = static(1)  # there are no updates to speak of

    @classmethod
    def small(cls, **fields: Any) -> Self:
        """A planner that a CPU can pay for: a 67th of the model's work at each step."""
        own: dict[str, Any] = {"horizon": 15, "population": 100, "chosen": 10, "iterations": 3, "particles": 5}
        return cls(**own | fields)

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """An environment; a fit of the model every 250 steps."""
        return {"copies": 1, "explore": 1000, "updates_per_step": 1 / 250, "block": 250}

    def resolve(self, spec: Spec, steps: int):
        """Checks what belongs together."""
        agent = super().resolve(spec, steps)
        if self.particles % self.elites:
            raise UserError(f"PETS.particles must be a multiple of elites ({self.elites}), got {self.particles}")
        if not 1 <= self.chosen <= self.population or self.horizon < 1:
            raise UserError(
                "PETS.chosen must be 1 .. population, and horizon 1 or more, "
                f"got {self.chosen} of {self.population} and {self.horizon}"
            )
        return agent

    def needs(self, spec):
        """Transitions."""
        return Needs(batch_size=self.batch_size)

    def init(self, spec, key):
        """The ensemble."""
        return State(self.unfitted(spec, key))

    def update(self, state, batch, *, step, key):
        """Nothing: `collect.modelled` fits the ensemble."""
        return state, {}

    def policy(self, state):
        """The planner."""
        best = state.model.best()
        size = state.model.mean.shape[-1] - (best["bounds"].shape[-1] - 1)
        assert self.ends is not None  # resolved
        return Planner(
            best["nets"], best["bounds"], state.model.mean, state.model.std, size, self.ends, self.horizon, self.population,
            self.chosen, self.iterations, self.particles, self.smoothing,
        )  # fmt: skip
