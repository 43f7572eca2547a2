"""Experience that is learned from once: the last block of steps, with advantages."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.ppo import PPO
from deadreckon.collect.online import Exploration


class OnPolicy(Exploration):
    """What the policies did in the last block, as `PPO.digest` sees it."""

    def _begin(self, agent: PPO) -> None:
        self.fields = learned_fields(self.columns)

    @property
    def count(self) -> int:
        """See `Experience`."""
        return self.settings.block

    def extend(self, learner: Any, states: Any, roots: PRNGKeyArray, step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`; observations of the block before, at first the random ones, are standardised with from here on."""
        self._collect(learner, states, roots, self.settings.explore)
        known = self.settings.explore if self.environment_steps == self.settings.explore else self.settings.block
        states = observing(learner, states, self.last(known)["observation"])
        self._collect(learner, states, roots, self.settings.steps(step + self.block))
        rows = self.last(self.settings.block)
        by_copy = {name: column.reshape(len(roots), -1, self.copies, *column.shape[2:]) for name, column in rows.items()}
        return digested(tuple(self.fields), learner, states, by_copy)


def learned_fields(columns: dict[str, tuple[int, ...]]) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """What `PPO.digest` makes of rows with these columns."""
    own = "observation", "action", "behavior_log_prob", "return_to_go", "advantage"
    return {name: (columns.get(name, ()), np.dtype(np.float32)) for name in own}


@eqx.filter_jit
def observing(learner: Any, states: Any, observation: Float[Array, "l n o"]) -> Any:
    """The states, which have seen some more observations."""
    return jax.vmap(lambda agent, state, seen: agent.observing(state, seen))(learner, states, observation)


@eqx.filter_jit
def digested(names: tuple[str, ...], learner: Any, states: Any, rows: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
    """The states, and the columns of all rows, in the order of `names`, in one matrix a lane."""
    states, columns = jax.vmap(lambda agent, state, own: agent.digest(state, own))(learner, states, rows)
    lanes = len(rows["reward"])
    count = rows["reward"][0].size
    return states, {"packed": jnp.concatenate([columns[name].reshape(lanes, count, -1) for name in names], -1)}
