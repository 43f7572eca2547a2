"""An agent whose losses and targets are programs: done one operation at a time, each operation would be compiled alone."""

from typing import Any

import equinox as eqx

PROGRAMS = ("actor_loss", "advantage", "away", "bellman_weight", "critic_loss", "future", "missed", "mover_loss",
            "returns", "set_loss", "target", "value_loss", "weighted_loss")  # fmt: skip


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
