"""Experience with demonstrations: first these, then blocks of the agent's steps, as processed by `DAPG.digest`."""

import warnings
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

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
    """The last block, and demonstrations. Observations are standardised by those that are known before the first block."""

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
        # The density of a Gaussian is that of the action that it drew, which is clipped only for the environment.
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
        """The learners that cloned the demonstrations for each lane, as one, and their states."""
        seen, action = moments(self.shared[0]["observation"]), self.shared[0]["action"]
        center, spread = action.mean(0), jnp.maximum(action.std(0), STD_FLOOR)
        lanes = [Cloning(float(lr), seen, center, spread, self.agent.hidden) for lr in learner.bc_lr]
        # Separate seeds: with those of the run, cloning would use the same random numbers as the run.
        seeds = [int(jax.random.bits(key_for(jax.random.key(seed), "cloning"), dtype=jnp.uint32)) for seed in self.seeds]
        result = fit(lanes, TransitionSource(log, lanes[0].needs(log.spec)), seeds, self.agent.bc_steps)
        failed = np.array([failure is not None for failure in result.failures])
        if failed.all():
            raise DivergedError(f"behavior_error: cloning {log.name} gave numbers that are not finite; lower bc_lr")
        for seed in np.array(self.seeds)[failed]:
            warnings.warn(f"seed {seed}: cloning {log.name} gave numbers that are not finite; lower bc_lr", stacklevel=2)
        # NaN in its state marks a lane as failed; the others continue.
        return lift(lanes), jax.tree.map(lambda leaf: _without(leaf, failed), result.states)


def _without(leaf: Array, failed: Bool[np.ndarray, "l"]) -> Array:
    """An array of all lanes (l, ...), with NaN in those that failed if it holds real numbers."""
    if not jnp.issubdtype(leaf.dtype, jnp.floating):
        return leaf
    return jnp.where(failed.reshape(-1, *[1] * (leaf.ndim - 1)), jnp.nan, leaf)


@eqx.filter_jit
def _begun(learner: Any, states: Any, cloning: Any, clones: Any, shown: dict[str, Array]) -> Any:
    """The states of all lanes, with policies cloned from the demonstrations."""

    def one(agent: DAPG, state: Any, cloning: Cloning, clone: Any) -> Any:
        return agent.begun(agent.observing(state, shown["observation"]), cloning.means(clone), shown)

    return jax.vmap(one)(learner, states, cloning, clones)
