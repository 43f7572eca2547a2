"""From a log to policies in a run folder: the one place where an agent meets its judge."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
import pyarrow as pa

from deadreckon.agents import short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.files import file_part, read_json, safe_name
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.runs.folder import Folder
from deadreckon.runs.lanes import lanes_of
from deadreckon.runs.settings import TrainOptions, TrainSettings
from deadreckon.runs.together import train_lanes
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Failure


@dataclasses.dataclass
class Run:
    """A finished (or failed) run: its folder, and what it learned.

    Attributes:
        path: the run folder.
        config: what was asked for.
        seeds: one per lane.
        policies: one per seed; of a failed lane, the last good one.
        failures: per seed None, or the metric and step at which it diverged.
    """

    path: Path
    config: dict[str, Any]
    seeds: list[int]
    policies: list[EnvPolicy]
    failures: list[Failure | None]

    @property
    def policy(self) -> EnvPolicy:
        """The first seed's policy."""
        return self.policies[0]

    @property
    def metrics(self) -> pa.Table:
        """step, seed and one column a metric, a row per chunk and seed."""
        return Folder(self.path).table("metrics")

    @property
    def evaluations(self) -> pa.Table:
        """One row an episode of every periodic evaluation."""
        return Folder(self.path).table("evaluations")

    @property
    def taught(self) -> np.ndarray | None:
        """(learning,) uint64 `episode_ids` of the episodes that it learned from; None for folders from before it was noted."""
        return Folder(self.path).episodes("taught")

    @property
    def held(self) -> np.ndarray | None:
        """(held,) uint64 `episode_ids` of the episodes of its log that it did not learn from; None as for `taught`."""
        return Folder(self.path).episodes("held")

    def __repr__(self) -> str:
        return f"Run({self.path}, {self.config['agent']['name']}, seeds {self.seeds})"


def train(
    agent: Agent | str | Sequence[Agent],
    data: Dataset | str | Path,
    *,
    steps: int = 100_000,
    seeds: int = 1,
    seed: int = 0,
    task: Task | str | Literal[False] | None = None,
    out: Path | str | None = None,
    **settings: Unpack[TrainOptions],
) -> Run:
    """Trains an agent on a log, several seeds as one compiled program, and judges it as it goes.

    Args:
        agent: an agent, its name, or one agent a seed that differ in float fields only.
        data: a log, the name of a known one, or a file.
        steps: number of updates.
        seeds: number of independent runs, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        task: the simulator to evaluate in; None takes that of a known log, and none for others; False: none.
        out: run folder; None is `runs/AGENT-LOG`, with dashes for what cannot be in a folder's name.
        **settings: `evaluate_every`, `episodes`, `chunk`, `resume`, `stream`, `strict`, `holdout`, `history` and `watch`;
            see `runs.settings.TrainSettings`.

    Raises:
        UserError: input that does not fit, in one line; nothing is written then.
    """
    asked = TrainSettings.of(settings)
    asked.check(seed, steps=steps, seeds=seeds)
    log = data if isinstance(data, Dataset) else catalogue.load(data, strict=asked.strict)
    lanes = lanes_of(agent, seeds)
    path = Path(out) if out is not None else Path("runs") / file_part(f"{short_name(lanes[0])}-{log.name}")
    with Folder(path).alone():
        train_lanes({path: (log, lanes)}, path, steps, seed, task, asked)
    return load(path)


def train_together(
    agents: Mapping[str, Agent],
    data: Dataset | str | Path | Mapping[str, Dataset],
    *,
    out: Path | str,
    steps: int = 100_000,
    seeds: int = 1,
    seed: int = 0,
    task: Task | str | Literal[False] | None = None,
    **settings: Unpack[TrainOptions],
) -> dict[str, Run]:
    """Trains agents that differ in float fields only, each with several seeds, all as lanes of one compiled program.

    Every agent has a run of its own, as `train` would make it, in a folder of its name; checkpoints are common to all.

    Args:
        agents: name -> agent.
        data: a log, the name of a known one, or a file; or for each agent's name its log, where these are of one shape.
        out: folder of the run folders.
        steps: number of updates of each run.
        seeds: number of runs of each agent, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        task: see `train`.
        **settings: see `train`; the same for all. With `resume` the runs in `out` must be of the same agents.

    Raises:
        UserError: input that does not fit, such as other fields that differ, in one line; nothing is written then.
    """
    asked = TrainSettings.of(settings)
    asked.check(seed, steps=steps, seeds=seeds)
    out = Path(out)
    for name in agents:
        safe_name(name, "agents are named as folders are, and")
        if name == Folder(out).checkpoints.name:
            raise UserError(f"agents are named as folders are, and {name!r} is that of the checkpoints; rename it")
    if not agents:
        raise UserError("no agent to train")
    if not isinstance(data, Mapping):
        data = dict.fromkeys(agents, data if isinstance(data, Dataset) else catalogue.load(data, strict=asked.strict))
    elif set(data) != set(agents):
        raise UserError(f"data must name the log of each of {', '.join(agents)}, got {', '.join(data)}")
    lanes = {out / name: (data[name], [agent] * seeds) for name, agent in agents.items()}
    with contextlib.ExitStack() as locks:
        for path in (out, *lanes):
            locks.enter_context(Folder(path).alone())
        train_lanes(lanes, out, steps, seed, task, asked)
        return {name: load(out / name) for name in agents}


def load(path: Path | str) -> Run:
    """A run from its folder.

    Raises:
        UserError: the folder holds no run, or one that is not finished.
    """
    folder = Folder(Path(path))
    if not folder.config.exists():
        raise UserError(f"{path} holds no run (no run.json)")
    config = folder.read_config()
    if not isinstance(config, dict) or not {"agent", "data", "task", "seeds", "steps"} <= config.keys():
        raise UserError(f"{folder.config} is not a run's: it misses agent, data, task, seeds or steps")
    missing = [seed for seed in config["seeds"] if not folder.policy(seed).exists()]
    if missing:
        again = "train_together" if "together" in config else f"deadreckon train ... --out {path} --resume"
        raise UserError(f"{path} is not finished; `{again}` goes on with it")
    status = read_json(folder.path / "status.json")
    if not isinstance(status, dict) or "failures" not in status:
        raise UserError(f"{folder.path / 'status.json'} is not a run's: it misses failures")
    policies = [store.load(folder.policy(seed)) for seed in config["seeds"]]
    failures = [None if f is None else Failure(*f) for f in status["failures"]]
    return Run(folder.path, config, config["seeds"], policies, failures)
