"""Experience that is used once: the last block of steps, with advantages."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from deadreckon.online.exploration import Exploration


class OnPolicy(Exploration):
    """The policies' steps in the last block, as processed by `PPO.digest`.

    Attributes:
        shared: further arguments of `digest`, the same for all lanes.
    """

    revision: ClassVar[int] = 1
    _as_it_is = False
    _sums = False

    def _begin(self, agent: Any) -> None:
        self.fields = learned_fields(agent, self.columns)
        self.shared: tuple[Any, ...] = ()

    @property
    def count(self) -> int:
        """See `Experience`."""
        return self.settings.block

    def extend(self, learner: Any, states: Any, roots: Key[Array, "lanes"], step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`."""
        self._collect(learner, states, roots, self.settings.explore)
        states = self._before(learner, states, step)
        self._collect(learner, states, roots, self.settings.steps(step + self.block))
        rows = self.last(self.settings.block)
        by_copy = {name: column.reshape(len(roots), -1, self.copies, *column.shape[2:]) for name, column in rows.items()}
        return digested(tuple(self.fields), learner, states, by_copy, *self.shared)

    def _before(self, learner: Any, states: Any, step: int) -> Any:
        """The states before acting, after the last block, or at first the random steps, has entered their standardisation."""
        known = self.settings.explore if step == 0 else self.settings.block
        return observing(learner, states, self.last(known)["observation"])


def learned_fields(agent: Any, columns: dict[str, tuple[int, ...]]) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Shapes and types of the columns that the agent's `digest` returns for rows with these columns."""
    return {name: (columns.get(name, ()), np.dtype(np.float32)) for name in agent.digests}


@eqx.filter_jit
def observing(learner: Any, states: Any, observation: Float[Array, "l n o"]) -> Any:
    """The states, with these observations in their standardisation."""
    return jax.vmap(lambda agent, state, seen: agent.observing(state, seen))(learner, states, observation)


@eqx.filter_jit
def digested(
    names: tuple[str, ...], learner: Any, states: Any, rows: dict[str, Array], *shared: Any
) -> tuple[Any, dict[str, Array]]:
    """The states, and the columns of all rows, in the order of `names`, in one matrix a lane."""
    states, columns = jax.vmap(lambda agent, state, own: agent.digest(state, own, *shared))(learner, states, rows)
    lanes = len(rows["reward"])
    count = rows["reward"][0].size
    return states, {"packed": jnp.concatenate([columns[name].reshape(lanes, count, -1) for name in names], -1)}
