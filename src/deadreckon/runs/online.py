"""From nothing but a simulator to policies in a run folder: an agent that learns from what it does."""

import dataclasses
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from deadreckon.agents import agent_name, short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.files import file_part
from deadreckon.online import Online
from deadreckon.online.experience import experience_of
from deadreckon.runs.folder import Folder
from deadreckon.runs.lanes import agents_of, fields_of, lanes_of
from deadreckon.runs.recorder import Recorder
from deadreckon.runs.settings import OnlineOptions, OnlineSettings
from deadreckon.runs.trackers.feed import tracked
from deadreckon.runs.trackers.tracker import trackers_of
from deadreckon.runs.train import Run, load
from deadreckon.tasks.registry import of_run
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit
from deadreckon.training.revisions import of_learning, revisions
from deadreckon.versions import versions


def train_online(
    agent: Agent | str | Sequence[Agent],
    task: Any,
    *,
    steps: int = 1_000_000,
    seeds: int = 1,
    seed: int = 0,
    out: Path | str | None = None,
    **settings: Unpack[OnlineOptions],
) -> Run:
    """Trains an agent in a simulator, several seeds as one compiled program, and judges it as it goes.

    Args:
        agent: an agent that explores by itself, its name, or one agent a seed that differ in float fields only.
        task: the simulator to learn and to be judged in, its name, or a Gymnasium environment, its id, or what makes one
            (see `tasks.registry.task`).
        steps: environment steps per seed, the random ones at the beginning included. A run may be resumed with more of them.
        seeds: number of independent runs, with the random seeds `seed` .. `seed + seeds - 1`.
        seed: the first random seed.
        out: run folder; None is `runs/AGENT-TASK-online`.
        **settings: `settings` (an `Online`), `evaluate_every`, `episodes`, `chunk`, `resume`, `threads`, `demonstrations`,
            `callback`, `track` and `watch`; see `runs.settings.OnlineSettings`.

    Raises:
        UserError: input that does not fit, in one line; nothing is written then.
    """
    asked = OnlineSettings.of(settings)
    asked.check(seed, seeds=seeds)
    task = find_task(task)
    lanes = lanes_of(agent, seeds)
    folder = Folder(Path(out) if out is not None else Path("runs") / file_part(f"{short_name(lanes[0])}-{task.name}-online"))
    with folder.alone():
        return _train_online(lanes, task, steps, seeds, seed, folder, asked)


def _train_online(
    lanes: Sequence[Agent], task: Task, steps: int, seeds: int, seed: int, folder: Folder, asked: OnlineSettings
) -> Run:
    """The run in `folder`, of one agent a seed."""
    turns = asked.settings or Online(**type(lanes[0]).acting(task.name))
    trackers = trackers_of(asked.track, 1)
    updates = turns.updates(steps)
    numbers = list(range(seed, seed + seeds))
    name = agent_name(lanes[0])
    every = max(1, round((asked.evaluate_every or max(steps // 50, 1)) * turns.updates_per_step))
    if asked.evaluate_every is None:
        every = folder.period(asked.resume) or every
    shown = None if asked.demonstrations is None else _demonstrated(asked.demonstrations, task)
    job = _job(lanes, task, numbers, updates, folder, dataclasses.replace(asked, settings=turns), every, shown)
    lanes = job.learners
    config = {
        "agent": {"name": name, "fields": fields_of(lanes)},
        "online": dataclasses.asdict(turns),
        "data": {"name": f"{task.name}, online", "fingerprint": f"online:{task.name}"},
        "task": task.name,
        "seeds": numbers,
        "steps": updates,
        "evaluation": {"every": job.stops, "episodes": asked.episodes},
        "versions": versions() | {"lanes": seeds, **task.versions},
        "revisions": of_learning() | {"method": revisions(lanes[0])},
    }
    if shown is not None:
        known = {"fingerprint": shown.fingerprint, "rows": len(shown), "episodes": shown.episodes}
        config["demonstrations"] = {"name": shown.name, **known, "return": float(shown.returns().mean())}
    config = json.loads(json.dumps(config, default=str))
    for text in folder.check(config, resume=asked.resume):
        warnings.warn(text, stacklevel=3)
    folder.begin(config)
    # What a simulator shows is in no log: demonstrations alone have been seen.
    taught = np.zeros(0, np.uint64) if shown is None else shown.episode_ids
    folder.note_episodes(taught, np.zeros(0, np.uint64))
    job.resume()
    folder.lengthen(config)
    folder.drop_after(job.step)

    recorder = Recorder([folder], job, task, None, job.stops, asked.episodes, taught)
    try:
        with tracked([folder], trackers) as tracking:
            if job.step == 0:
                recorder.judge_now(0)  # the randomly initialised policy, which some logs are made with
            else:
                recorder.catch_up()
            recorder.follow(asked, tracking)
    finally:
        recorder.close()
    return load(folder.path)


def _demonstrated(given: Dataset | str | Path, task: Task) -> Dataset:
    """A log of demonstrations, within the bounds of the task that they are of.

    Raises:
        UserError: no log, or one of another task's sizes.
    """
    log = given if isinstance(given, Dataset) else catalogue.load(given)
    asked = task.observation_shape, task.action_space.size
    found = log.spec.observation_shape, log.spec.action_size
    if log.spec.discrete or asked != found:
        sizes = f"{found[0]} and {found[1]} actions, {task.name} has {asked[0]} and {asked[1]}"
        raise UserError(f"{log.name} has observations {sizes}")
    return log.with_action_space(task.action_space)


def reopened(path: Path | str) -> Fit:
    """An online run as it is at its newest checkpoint, to look into: its `learners`, their whole `states`, a learned model
    among them, its real steps in `experience`, and its task there.

    Raises:
        UserError: `path` is no online run, or its checkpoint cannot be read.
    """
    folder = Folder(Path(path))
    config = folder.read_config() if folder.config.exists() else {}
    if "online" not in config:
        raise UserError(f"{path} is not the folder of an online run")
    lanes = agents_of(config)
    every = config["evaluation"]["every"]
    settings = OnlineSettings(settings=Online(**config["online"]), chunk=every)
    job = _job(lanes, of_run(config["task"]), config["seeds"], config["steps"], folder, settings, every, None)
    job.resume()
    if job.step == 0:
        raise UserError(f"{path} has no checkpoint yet in which something was learned")
    return job


def _job(
    lanes: Sequence[Agent],
    task: Task,
    seeds: list[int],
    updates: int,
    folder: Folder,
    settings: OnlineSettings,
    stops: int,
    shown: Dataset | None,
) -> Fit:
    """The fit of agents that are resolved for the task here."""
    spec = Spec.empty(task.observation_shape, task.action_space, task.name)
    lanes = [lane.resolve(spec, updates) for lane in lanes]
    replays = [folder.replay(s) for s in seeds]
    turns = settings.settings
    assert turns is not None  # whoever makes a job has settled them
    experience = experience_of(lanes[0])(task, lanes[0], seeds, updates, turns, replays, settings.threads)
    if shown is not None:
        experience.show(shown)
    return Fit(lanes, experience, seeds, updates, settings.chunk, folder.checkpoints, stops=stops)
