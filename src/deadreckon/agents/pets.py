"""PETS (Chua et al. 2018): no policy is learned; actions are planned in an ensemble, again at every step (thesis 5.4).

The cross-entropy method draws sequences of `horizon` actions, follows each with `particles` rollouts, each in one network all
along (TS-infinity), and moves its distribution towards the best sequences. The first action of its mean is done; the rest is
where the next step begins to plan. The reward is the ensemble's, as in MBPO, while published PETS knows it.
"""

from typing import Any, ClassVar, NamedTuple, Self

from deadreckon.agents.model_based import OnlineModelBasedAgent
from deadreckon.data.batch import BatchSpec
from deadreckon.data.spec import Spec
from deadreckon.dynamics import Ensemble
from deadreckon.errors import UserError
from deadreckon.policies.planner import Planner
from deadreckon.training.hyperparameters import Count, CountOrZero, UnitInterval, static


class State(NamedTuple):
    """The ensemble alone."""

    model: Ensemble


class PETS(OnlineModelBasedAgent):
    """Planning with trajectory sampling; its settings are those published for HalfCheetah."""

    revision: ClassVar[int] = 2
    online: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {"chosen": "cem_elites", "iterations": "cem_iterations"}

    horizon: CountOrZero = static(30)  # planning horizon in steps
    population: Count = static(500)  # action sequences sampled per iteration of CEM
    cem_elites: Count = static(50)  # best sequences that the distribution is refitted to
    cem_iterations: Count = static(5)  # iterations of CEM per step
    particles: Count = static(20)  # rollouts per action sequence, spread evenly over the elites
    smoothing: UnitInterval = static(0.1)  # share of the previous distribution that is kept in an iteration
    batch_size: Count = static(1)  # unused: the planner has no gradient updates

    @classmethod
    def small(cls, **fields: Any) -> Self:
        """A planner that a CPU can pay for: a 67th of the model's work at each step."""
        own: dict[str, Any] = {"horizon": 15, "population": 100, "cem_elites": 10, "cem_iterations": 3, "particles": 5}
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
        if not 1 <= self.cem_elites <= self.population or self.horizon < 1:
            raise UserError(
                "PETS.cem_elites must be 1 .. population, and horizon 1 or more, "
                f"got {self.cem_elites} of {self.population} and {self.horizon}"
            )
        return agent

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key):
        """The ensemble."""
        return State(self.unfitted(spec, key))

    def update(self, state, batch, *, step, key):
        """Nothing: `online.model_learning` fits the ensemble."""
        return state, {}

    def policy(self, state):
        """The planner."""
        best = state.model.best()
        size = state.model.mean.shape[-1] - (best["bounds"].shape[-1] - 1)
        assert self.termination is not None  # resolved
        return Planner(
            best["nets"], best["bounds"], state.model.mean, state.model.std, size, self.termination, self.horizon,
            self.population, self.cem_elites, self.cem_iterations, self.particles, self.smoothing,
        )  # fmt: skip
