"""Agents as the lanes of a run, and as recorded in its folder."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from deadreckon.agents import agent_class, known_agent
from deadreckon.agents.agent import Agent
from deadreckon.errors import UserError
from deadreckon.training.later_fields import told


def lanes_of(agent: Agent | str | Sequence[Agent], seeds: int) -> list[Agent]:
    """One agent per seed, from an agent, its name or a list of agents.

    Raises:
        UserError: an unknown name, or another number of agents.
    """
    found = agent_class(agent)() if isinstance(agent, str) else agent
    lanes = [found] * seeds if isinstance(found, Agent) else list(found)
    if len(lanes) != seeds:
        raise UserError(f"one agent per seed is needed, got {len(lanes)} agents and {seeds} seeds")
    return lanes


def fields_of(lanes: Sequence[Agent]) -> dict[str, Any]:
    """Hyperparameters by name, as `told` has them; those that differ between lanes as a list."""
    out = {}
    for f in told(*lanes):
        values = [getattr(lane, f.name) for lane in lanes]
        out[f.name] = values[0] if all(v == values[0] for v in values) else values
    return out


def agents_of(config: dict[str, Any]) -> list[Agent]:
    """The agents of a run's `config`, one per seed: the inverse of `fields_of`.

    Raises:
        UserError: the agent's module has not been imported; a folder must not choose code that is executed.
    """
    name, written = str(config["agent"]["name"]), config["agent"]["fields"]
    if not known_agent(name):
        module = name.partition(":")[0]
        raise UserError(f"the run's agent is {name}, which is not part of deadreckon: import {module} first")
    kind = agent_class(name)
    fixed = {f.name for f in dataclasses.fields(kind) if f.metadata.get("static")}
    tuples: Callable[[Any], Any] = lambda value: tuple(map(tuples, value)) if isinstance(value, list) else value  # noqa: E731

    def of_lane(name: str, lane: int) -> Any:
        # JSON has only lists: for a field that may differ between lanes, a list has one value per lane.
        return tuples(written[name]) if name in fixed or not isinstance(written[name], list) else written[name][lane]

    return [kind(**{name: of_lane(name, lane) for name in written}) for lane in range(len(config["seeds"]))]
