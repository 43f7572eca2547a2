"""Experience of an agent that is shown how: demonstrations, then its own blocks of steps, as `DAPG.digest` sees them."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from deadreckon.agents.dapg import DAPG, Cloning, moments
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import STD_FLOOR
from deadreckon.errors import DivergedError
from deadreckon.online.on_policy import OnPolicy, observing
from deadreckon.randomness import key_for
from deadreckon.training.fit import fit
from deadreckon.training.learner import lift


class Demonstrated(OnPolicy):
    """The last block, and what was demonstrated. Observations are standardised by what is known before the first block."""

    revision: ClassVar[int] = 1

    def _begin(self, agent: DAPG) -> None:
        super()._begin(agent)
        self.agent = agent
        self.shown: Dataset | None = None

    def show(self, log: Dataset) -> None:
        """See `Exploration.show`."""
        self.shown = log
        unit = self.view.to_unit(np.asarray(log.actions, np.float32))
        self.shared = ({"observation": jnp.asarray(log.observations, jnp.float32), "action": jnp.asarray(unit)},)

    def _learnable(self, rows: np.ndarray) -> np.ndarray:
        # A Gaussian's density is that of what it drew, which is clipped before the environment gets it.
        out = rows.copy()
        out[..., self._action] = self.view.scaled(rows[..., self._action])
        return out

    def _before(self, learner: Any, states: Any, step: int) -> Any:
        if step:
            return states
        if self.shown is None:
            return observing(learner, states, self.last(self.settings.explore)["observation"])
        return _begun(learner, states, *self._cloned(self.shown, learner), self.shared[0])

    def _cloned(self, log: Dataset, learner: Any) -> tuple[Any, Any]:
        """What cloned each lane's demonstrations, and its states."""
        seen, action = moments(self.shared[0]["observation"]), self.shared[0]["action"]
        center, spread = action.mean(0), jnp.maximum(action.std(0), STD_FLOOR)
        lanes = [Cloning(float(lr), seen, center, spread, self.agent.hidden) for lr in learner.bc_lr]
        # Seeds of their own: with the run's, cloning would draw what the run draws.
        seeds = [int(jax.random.bits(key_for(jax.random.key(seed), "cloning"), dtype=jnp.uint32)) for seed in self.seeds]
        result = fit(lanes, TransitionSource(log, lanes[0].needs(log.spec)), seeds, self.agent.bc_steps)
        if any(result.failures):
            raise DivergedError(f"behavior_error: cloning {log.name} gave numbers that are not finite; lower bc_lr")
        return lift(lanes), result.states


@eqx.filter_jit
def _begun(learner: Any, states: Any, cloning: Any, clones: Any, shown: dict[str, Array]) -> Any:
    """The states of all lanes, whose policies are clones of what was demonstrated."""

    def one(agent: DAPG, state: Any, cloning: Cloning, clone: Any) -> Any:
        return agent.begun(agent.observing(state, shown["observation"]), cloning.means(clone), shown)

    return jax.vmap(one)(learner, states, cloning, clones)
