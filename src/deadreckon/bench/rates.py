"""How many updates a second an accelerator makes of what a job learns: measured, or estimated from what was measured."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

from deadreckon.bench.jobs import Job
from deadreckon.files import read_json, write_json

BASE = "td3_bc"  # the agent by whose rates others are estimated


class Rate(NamedTuple):
    """Updates of a seed per second, the sum over the lanes of a program.

    Attributes:
        value: how many.
        measured: on this kind of device, for this agent and its sizes; else it is an estimate.
    """

    value: float
    measured: bool


class _Entry(NamedTuple):
    device: str
    agent: str
    settings: dict[str, Any]
    lanes: Sequence[int]
    rates: Sequence[float]

    def of(self, device: str, job: Job) -> bool:
        """Whether it was measured on such a device, for such networks."""
        alike = all(job.settings.get(name) == value for name, value in self.settings.items())
        return self.device in device and self.agent == job.agent and alike


class _Kept(TypedDict):
    """An entry, as a file has it."""

    device: str
    agent: str
    settings: dict[str, Any]
    lanes: list[int]
    rates: list[float]


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads(files("deadreckon.bench").joinpath("rates.toml").read_text("utf-8"))


@dataclass
class Rates:
    """Rates of a device.

    Attributes:
        device: its kind, as JAX calls it.
        path: of the file that keeps what is measured here; None keeps nothing.
        cores: of the machine.
    """

    device: str
    path: Path | None = None
    cores: int = field(default_factory=lambda: _table()["device"]["cores"])

    def __post_init__(self):
        known = read_json(self.path, list[_Kept]) if self.path is not None and self.path.exists() else []
        own = [entry for entry in known if entry["device"] == self.device]
        # The newest first, and those of the package last.
        self._entries = [_Entry(**entry) for entry in [*reversed(own), *_table()["measured"]]]

    @property
    def ready(self) -> float:
        """Seconds from the start of a program's process to its first update."""
        return float(_table()["device"]["ready"])

    def rate(self, job: Job, lanes: int) -> Rate:
        """The rate of a program of that many lanes like this job.

        Measured rates of another number of lanes are scaled as those of `BASE` grow with lanes. Where there are none, the rate
        is that of `BASE` divided by how much more work an update is, and never above it.
        """
        own = [(count, rate) for entry in self._entries if entry.of(self.device, job)
               for count, rate in zip(entry.lanes, entry.rates)]  # fmt: skip
        if not own:
            return Rate(_base(lanes) / max(work(job.agent, job.settings) / _table()["work"][BASE], 1.0), False)
        count, rate = min(own, key=lambda one: abs(math.log(one[0] / lanes)))  # the first of equals: the newest
        return Rate(rate * _base(lanes) / _base(count), True)

    def note(self, job: Job, lanes: int, rate: float) -> None:
        """Keeps a rate that was measured here."""
        shape = {name: value for name, value in job.settings.items() if not isinstance(value, float)}
        entry = _Entry(self.device, job.agent, shape, [lanes], [float(f"{rate:.4g}")])
        self._entries.insert(0, entry)
        if self.path is not None:
            known = read_json(self.path, list[_Kept]) if self.path.exists() else []
            same = entry._replace(rates=[])._asdict()
            write_json(self.path, [one for one in known if one | {"rates": []} != same] + [entry._asdict()])

    def judging(self, job: Job, lanes: int) -> float:
        """Seconds of one core for all evaluations of a program of that many lanes like this job."""
        from deadreckon.tasks.registry import of_log

        task = of_log(job.on)
        if task is None:
            return 0.0
        known = _table()["judged"]
        speed = next((rate for name, rate in known.items() if task.name.startswith(name)), min(known.values()))
        times = -(-job.options["steps"] // job.options["every"])
        return times * job.options["episodes"] * lanes * task.horizon / speed


def work(agent: str, settings: Mapping[str, Any]) -> float:
    """Millions of operations of an update: the agent's by default, scaled by batch, widths and critics; the most if unknown."""
    known = _table()["work"]
    if agent not in known:
        return max(known.values())
    usual = _usual(agent)
    scale = _size(settings.get("hidden")) / _size(usual["hidden"])
    scale *= (settings.get("critics") or 1) / (usual["critics"] or 1)  # nearly all of the work where there are many
    return known[agent] * scale * (settings.get("batch_size") or 1) / (usual["batch_size"] or 1)


@cache
def _usual(agent: str) -> dict[str, Any]:
    """The sizes that an agent of the package has by default."""
    from deadreckon.agents import AGENTS, agent_class

    own = agent_class(agent)() if agent in AGENTS else None
    return {name: getattr(own, name, None) for name in ("hidden", "batch_size", "critics")}


def has_work(agent: str) -> bool:
    """Whether the work of an update is known of the agent itself."""
    return agent in _table()["work"]


def _size(hidden: Any) -> float:
    """What products of layers of these widths take; the first and the last layer count as 24 wide."""
    return float(sum(a * b for a, b in pairwise([24, *hidden, 24]))) if hidden else 1.0


def _base(lanes: int) -> float:
    """The rate of `BASE`, in between by straight lines of logarithms; beyond the most lanes that of the most."""
    [entry] = [one for one in _table()["measured"] if one["agent"] == BASE]
    points = [(math.log(count), math.log(rate)) for count, rate in zip(entry["lanes"], entry["rates"])]
    at = math.log(lanes)
    for (x0, y0), (x1, y1) in pairwise(points):
        if at <= x1:
            return math.exp(y0 + (y1 - y0) * (at - x0) / (x1 - x0))
    return math.exp(points[-1][1])


def assumed_device() -> str:
    """The kind of device that is planned for where there is none."""
    return _table()["device"]["name"]
