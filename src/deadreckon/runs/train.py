"""Training on a log: from a log to policies in a run folder, with evaluations in a simulator."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from deadreckon.agents import short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.names import file_part, safe_name
from deadreckon.runs.folder import Folder
from deadreckon.runs.lanes import lanes_of
from deadreckon.runs.run import Run, load
from deadreckon.runs.settings import TrainOptions, TrainSettings
from deadreckon.runs.together import train_lanes


def train(
    agent: Agent | str | Sequence[Agent],
    data: Dataset | str | Path,
    *,
    steps: int = 100_000,
    seeds: int = 1,
    seed: int = 0,
    task: Any = None,
    out: Path | str | None = None,
    **settings: Unpack[TrainOptions],
) -> Run:
    """Trains an agent on a log, several seeds as one compiled program, and evaluates it during training.

    Args:
        agent: an agent, its name, or one agent per seed that differ only in float fields.
        data: a log, the name of a known one, or a file.
        steps: number of updates.
        seeds: number of independent runs, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        task: the simulator to evaluate in, a task, its name, or a Gymnasium environment (see `tasks.registry.task`); None: that
            of a known log, or none for other logs; False: none.
        out: run folder; None is `runs/AGENT-LOG`, with dashes for characters that a folder's name cannot have.
        **settings: `evaluate_every`, `episodes`, `chunk`, `resume`, `stream`, `strict`, `holdout`, `history`, `encoder`,
            `shift`, `callback`, `track` and `watch`; see `runs.settings.TrainSettings`.

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
    task: Any = None,
    **settings: Unpack[TrainOptions],
) -> dict[str, Run]:
    """Trains agents that differ only in float fields, each with several seeds, all as lanes of one compiled program.

    Every agent has its own run, as from `train`, in a folder of its name; all share the checkpoints.

    Args:
        agents: name -> agent.
        data: a log, the name of a known one, or a file; or a dictionary with one log per agent's name, all of the same shape.
        out: folder of the run folders.
        steps: number of updates of each run.
        seeds: number of runs of each agent, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        task: see `train`.
        **settings: see `train`; the same for all. With `resume` the runs in `out` must be of the same agents.

    Raises:
        UserError: invalid input, such as agents that differ in other fields, in one line; nothing is written then.
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
