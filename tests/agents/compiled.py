"""An agent whose losses and targets are programs: done one operation at a time, each operation would be compiled alone."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

PROGRAMS = ("actor_loss", "advantage", "away", "bellman_weight", "critic_loss", "future", "loss", "missed", "mover_loss",
            "observing", "returns", "set_loss", "target", "value", "value_loss", "values", "weighted_loss")  # fmt: skip


class Compiled:
    """The agent, whose methods among `PROGRAMS` are compiled as wholes; all else is its own."""

    def __init__(self, agent: Any):
        self.agent = agent

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.agent, name)
        return eqx.filter_jit(found) if name in PROGRAMS else found

    def replace(self, **changes: Any) -> "Compiled":
        """The agent with other fields."""
        return Compiled(self.agent.replace(**changes))


def begun(agent: Any, spec: Any) -> Any:
    """The agent's first state, by one program."""
    return jax.jit(lambda key: agent.init(spec, key))(jax.random.key(0))


def moved(state: Any, names: tuple[str, ...]) -> Any:
    """The state with noise on those of its networks, each its own, so that none is another's copy."""
    noise = lambda w, k: 0.3 * np.asarray(jax.random.normal(jax.random.key(k), w.shape))  # noqa: E731
    each = lambda tree, k: jax.tree.map(lambda w: np.asarray(w) + noise(w, k), tree)  # noqa: E731
    return state._replace(**{name: each(getattr(state, name), k) for k, name in enumerate(names)})
