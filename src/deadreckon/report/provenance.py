"""Where a page's numbers come from: settings that differ from the defaults, versions, and the command that makes a run again."""

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Any

from deadreckon.agents import AGENTS, agent_class
from deadreckon.report.entries import Entry


def settings(entry: Entry) -> dict[str, Any]:
    """Hyperparameters that differ from the agent's defaults, also those that were derived from the log."""
    given = entry.config["agent"]["fields"]
    if entry.agent not in AGENTS:
        return given
    default = agent_class(entry.agent)()
    known = {f.name: _plain(getattr(default, f.name)) for f in dataclasses.fields(default)}
    return {name: value for name, value in given.items() if name not in known or known[name] != value}


def command(entry: Entry) -> str:
    """The command line that makes this run again."""
    config = entry.config
    data, every = config["data"], config.get("evaluation", {})
    source = data.get("provenance", {}).get("path") or data["name"]
    words = ["deadreckon", "train", "--agent", entry.agent, "--data", source]
    words += ["--task", config["task"]] if config["task"] else []
    words += ["--steps", config["steps"], "--seeds", len(entry.seeds)]
    words += ["--seed", entry.seeds[0]] if entry.seeds[:1] != [0] else []
    if every.get("every") not in (None, max(config["steps"] // 10, 1)):
        words += ["--evaluate-every", every["every"]]
    words += ["--episodes", every["episodes"]] if every.get("episodes") not in (None, 20) else []
    for name, value in settings(entry).items():
        words += _option(name.replace("_", "-"), value)
    return shlex.join(map(str, [*words, "--out", entry.folder.path]))


def _option(name: str, value: Any) -> list[Any]:
    if isinstance(value, bool):
        return [f"--agent.{name}" if value else f"--agent.no-{name}"]
    if value is None:
        return [f"--agent.{name}", "None"]
    return [f"--agent.{name}", *(value if isinstance(value, Sequence) and not isinstance(value, str) else [value])]


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, (tuple, list)) else value


def versions(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """What the runs were made with; several values where they differ."""
    names = dict.fromkeys(name for e in entries for name in e.config.get("versions", {}) if name != "lanes")
    return [(name, ", ".join(dict.fromkeys(str(e.config.get("versions", {}).get(name)) for e in entries))) for name in names]
