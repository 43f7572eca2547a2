"""From a log to policies in a run folder: the one place where an agent meets its judge."""

import contextlib
import dataclasses
import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from deadreckon.agents import agent_name, short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.errors import UserError
from deadreckon.files import file_part, safe_name
from deadreckon.runs.diagnostics import logged_value
from deadreckon.runs.folder import Folder
from deadreckon.runs.holdout import divided
from deadreckon.runs.lanes import fields_of, lanes_of
from deadreckon.runs.recorder import Recorder
from deadreckon.runs.run import Run, load
from deadreckon.runs.settings import TrainOptions, TrainSettings
from deadreckon.runs.trackers.feed import tracked
from deadreckon.runs.trackers.tracker import trackers_of
from deadreckon.tasks.registry import of_log
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit
from deadreckon.training.revisions import of_learning, revisions
from deadreckon.versions import versions


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
    """Trains an agent on a log, several seeds as one compiled program, and judges it as it goes.

    Args:
        agent: an agent, its name, or one agent a seed that differ in float fields only.
        data: a log, the name of a known one, or a file.
        steps: number of updates.
        seeds: number of independent runs, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        task: the simulator to evaluate in, a task, its name, or a Gymnasium environment (see `tasks.registry.task`); None takes
            that of a known log, and none for others; False: none.
        out: run folder; None is `runs/AGENT-LOG`, with dashes for what cannot be in a folder's name.
        **settings: `evaluate_every`, `episodes`, `chunk`, `resume`, `stream`, `strict`, `holdout`, `history`, `callback`,
            `track` and `watch`; see `runs.settings.TrainSettings`.

    Raises:
        UserError: input that does not fit, in one line; nothing is written then.
    """
    asked = TrainSettings.of(settings)
    asked.check(seed, steps=steps, seeds=seeds)
    log = data if isinstance(data, Dataset) else catalogue.load(data, strict=asked.strict)
    lanes = lanes_of(agent, seeds)
    path = Path(out) if out is not None else Path("runs") / file_part(f"{short_name(lanes[0])}-{log.name}")
    with Folder(path).alone():
        [run] = _train({path: lanes}, path, log, steps, seed, task, asked)
    return run


def train_together(
    agents: Mapping[str, Agent],
    data: Dataset | str | Path,
    *,
    out: Path | str,
    steps: int = 100_000,
    seeds: int = 1,
    seed: int = 0,
    task: Any = None,
    **settings: Unpack[TrainOptions],
) -> dict[str, Run]:
    """Trains agents that differ in float fields only, each with several seeds, all as lanes of one compiled program.

    Every agent has a run of its own, as `train` would make it, in a folder of its name; checkpoints are common to all.

    Args:
        agents: name -> agent.
        data: a log, the name of a known one, or a file.
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
    log = data if isinstance(data, Dataset) else catalogue.load(data, strict=asked.strict)
    lanes = {out / name: [agent] * seeds for name, agent in agents.items()}
    with contextlib.ExitStack() as locks:
        for path in (out, *lanes):
            locks.enter_context(Folder(path).alone())
        return dict(zip(agents, _train(lanes, out, log, steps, seed, task, asked)))


def _train(
    asked: Mapping[Path, Sequence[Agent]],
    out: Path,
    log: Dataset,
    steps: int,
    seed: int,
    task: Any,
    settings: TrainSettings,
) -> list[Run]:
    """One run a path, of the agents there, which have a seed each; checkpoints lie in `out`."""
    judge = judge_of(log, task)
    log = log.with_action_space(log.action_space if judge is None else judge.action_space, settings.strict)
    folders, resume = [Folder(path) for path in asked], settings.resume
    trackers = trackers_of(settings.track, len(folders))
    before = folders[0].read_config() if resume and folders[0].config.exists() else None
    part = divided(log, settings.holdout, judge, before)
    seen = stacked(part.learning, settings.history)
    for each in asked.values():
        if settings.history > 1 and not each[0].supports_history:
            raise UserError(f"{type(each[0]).__name__} takes no histories: {each[0].own_history}; leave history at 1")
    lanes = [lane.resolve(seen.spec, steps) for each in asked.values() for lane in each]
    seeds = len(lanes) // len(folders)
    numbers = list(range(seed, seed + seeds))
    every = min(settings.evaluate_every or folders[0].period(resume) or max(steps // 10, 1), steps)
    rows = TransitionSource(seen, lanes[0].needs(seen.spec))

    common = {
        "data": {"name": log.name, "fingerprint": log.fingerprint, "rows": len(log), "episodes": log.episodes,
                 "holdout": part.told, "usable": rows.count, "warnings": log.warnings,
                 "behavior": None if judge is None else logged_value(log, judge),
                 "provenance": dataclasses.asdict(log.provenance)},
        "task": None if judge is None else judge.name,
        "seeds": numbers,
        "steps": steps,
        "evaluation": {"every": every, "episodes": settings.episodes},
        "versions": versions() | {"lanes": len(lanes), **({} if judge is None else judge.versions)},
        "revisions": of_learning() | {"method": revisions(lanes[0])},
    }  # fmt: skip
    if settings.history > 1:
        common["history"] = settings.history
    if out != folders[0].path:
        common["together"] = [folder.path.name for folder in folders]
    configs = []
    for run in range(len(folders)):
        own = lanes[run * seeds : (run + 1) * seeds]
        config = {"agent": {"name": agent_name(own[0]), "fields": fields_of(own)}, **common}
        configs.append(json.loads(json.dumps(config, default=str)))
    kept = Folder(out).checkpoints
    if out != folders[0].path and kept.exists() and not all(folder.config.exists() for folder in folders):
        raise UserError(f"{kept} is of other runs; give {', '.join(folder.path.name for folder in folders)} another folder")
    # Built before anything is written: whatever does not fit is told while the disk is untouched.
    job = Fit(
        lanes, rows, numbers * len(folders), steps, settings.chunk, Folder(out).checkpoints, stream=settings.stream, stops=every
    )
    told = [text for folder, config in zip(folders, configs) for text in folder.check(config, resume=resume)]
    for text in dict.fromkeys(told):
        warnings.warn(text, stacklevel=3)
    for folder, config in zip(folders, configs):
        folder.begin(config)
        folder.note_episodes(part.taught, part.held)
    job.resume()
    for folder, config in zip(folders, configs):
        folder.lengthen(config)
        folder.drop_after(job.step)

    recorder = Recorder(
        folders, job, judge, part.learning, every, settings.episodes, part.taught, part.held, settings.history
    )
    try:
        with tracked(folders, trackers) as tracking:
            recorder.picture(part.learning)
            recorder.catch_up()
            recorder.follow(settings, tracking)
    finally:
        recorder.close()
    return [load(folder.path) for folder in folders]


def judge_of(log: Dataset, task: Any) -> Task | None:
    """The simulator that policies of a log are judged in: the one that is named, or a known log's, or none.

    Raises:
        UserError: it shows other observations than the log has.
    """
    if task is False:
        return None
    judge = of_log(log.name) if task is None else find_task(task)
    if judge is not None and judge.observation_shape != log.spec.observation_shape:
        raise UserError(
            f"{judge.name} shows observations of shape {judge.observation_shape}, "
            f"{log.name} has {log.spec.observation_shape}"
        )
    return judge
