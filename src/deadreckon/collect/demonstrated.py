"""Experience of an agent that is shown how: demonstrations, then its own blocks of steps, as `DAPG.digest` sees them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.agents.dapg import DAPG, Actor
from deadreckon.collect.on_policy import OnPolicy, observing
from deadreckon.data.batch import Rows
from deadreckon.data.dataset import Dataset
from deadreckon.errors import DivergedError
from deadreckon.training.fit import fit


class Demonstrated(OnPolicy):
    """The last block, and what was demonstrated. Observations are standardised by what is known before the first block."""

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
        # A Gaussian's density is that of what it drew, which the environment clips afterwards.
        out = rows.copy()
        out[..., self._action] = self.view.scaled(rows[..., self._action])
        return out

    def _before(self, learner: Any, states: Any, step: int) -> Any:
        if step:
            return states
        if self.shown is None:
            return observing(learner, states, self.last(self.settings.explore)["observation"])
        states = _seen_alike(learner, states, self.shared[0]["observation"])
        net = self._cloned(self.shown, learner) if self.agent.pretrain else states.actor.net
        spread = jnp.log(jnp.maximum(self.shared[0]["action"].std(0), 1e-3))
        return states._replace(actor=Actor(net, jnp.broadcast_to(spread, states.actor.log_std.shape)))

    def _cloned(self, log: Dataset, learner: Any) -> Any:
        """(lanes, ...) networks that do as demonstrated."""
        lanes = [jax.tree.map(lambda leaf, i=i: float(leaf[i]), learner.cloning) for i in range(len(self.seeds))]
        result = fit(lanes, Rows(log, lanes[0].needs(log.spec)), self.seeds, self.agent.pretrain)
        if any(result.failures):
            raise DivergedError(f"behavior_error: cloning {log.name} gave numbers that are not finite; lower pretrain_lr")
        return result.states.net


@eqx.filter_jit
def _seen_alike(learner: Any, states: Any, observation: Float[Array, "n o"]) -> Any:
    """The states of all lanes, which have seen the same observations."""
    return jax.vmap(lambda agent, state: agent.observing(state, observation))(learner, states)
