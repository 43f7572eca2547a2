"""Settings of agents that were published: for single logs or domains (`presets`), and values that papers varied (`space`)."""

import functools
import importlib.resources
import json
import re
from typing import Any

from deadreckon.errors import UserError, unknown


def agent_key(name: str) -> str:
    """An agent's key in `AGENTS` and here, from a name such as `td3-bc` or `TD3+BC`."""
    return name.lower().replace("-", "_").replace("+", "_")


@functools.cache
def presets() -> dict[str, dict[str, dict[str, Any]]]:
    """Published settings for single logs or domains: by agent, then by the logs that they are for, then by field.

    A preset's name is the beginning of those logs' names: a task or domain (`maze2d`), or one log of it (`hopper-medium`).
    """
    return json.loads(importlib.resources.files("deadreckon.agents").joinpath("presets.json").read_text())


def preset(agent: str, name: str) -> dict[str, Any]:
    """The fields of one preset: those of its domain, and its own where it has others.

    Raises:
        UserError: the agent has no preset of this name.
    """
    known = presets().get(agent_key(agent), {})
    if name not in known:
        raise unknown(f"preset of {agent}", name, known) if known else UserError(f"{agent} has no presets; leave {name!r} out")
    fields = known.get(name.partition("-")[0], {}) | known[name]
    return {field: tuple(value) if isinstance(value, list) else value for field, value in fields.items()}


def preset_for(agent: str, log: str) -> str | None:
    """The preset that was published for a log such as `hopper-medium-v2@dr1`, if there is one: its own, or its task's."""
    known = presets().get(agent_key(agent), {})
    own = re.sub(r"-v\d+(@.*)?$", "", log)
    return next((name for name in (own, own.partition("-")[0]) if name in known), None)


def space(agent: str) -> dict[str, list[Any]]:
    """Values of an agent's fields that its paper, or papers about it, varied: what to try where nothing else is known.

    Raises:
        UserError: none are known.
    """
    known = json.loads(importlib.resources.files("deadreckon.agents").joinpath("spaces.json").read_text())
    if agent_key(agent) not in known:
        raise UserError(f"no values to try are known for {agent}; name some, such as --values lr=1e-4,3e-4")
    return known[agent_key(agent)]
