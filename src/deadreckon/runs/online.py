"""Online training: from a simulator to policies in a run folder."""

import dataclasses
import functools
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import jax
import numpy as np

from deadreckon.agents import agent_name, short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.data.environments import SPEC
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.names import file_part
from deadreckon.online import Online, replay_log
from deadreckon.online.experience import experience_of
from deadreckon.online.mixed import check_agent, check_sizes
from deadreckon.runs.folder import Folder
from deadreckon.runs.lanes import agents_of, fields_of, lanes_of
from deadreckon.runs.reading import Read
from deadreckon.runs.recorder import Recorder, follow, opened
from deadreckon.runs.run import Run, load
from deadreckon.runs.settings import OnlineOptions, OnlineSettings
from deadreckon.runs.sizes import about_sizes
from deadreckon.runs.started import Beside, Start, beside, start_of
from deadreckon.runs.trackers.feed import tracked
from deadreckon.runs.trackers.tracker import trackers_of
from deadreckon.tasks.registry import of_run, own_fields, registered_fields
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit
from deadreckon.training.revisions import of_learning, revisions
from deadreckon.versions import differences, versions


def train_online(
    agent: Agent | str | Sequence[Agent] | None = None,
    task: Any = None,
    *,
    steps: int = 1_000_000,
    seeds: int | None = None,
    seed: int | None = None,
    out: Path | str | None = None,
    **settings: Unpack[OnlineOptions],
) -> Run:
    """Trains an agent in a simulator, several seeds as one compiled program, and evaluates it during training.

    With `start`, the agent of a run on a log continues: with its networks, targets and optimisers, in its coordinates of
    observations and actions, and with the log in the replay. With `data` alone, a log is in the replay of an untrained agent.

    Args:
        agent: an agent that supports online training, its name, or one agent per seed that differ only in float fields; None:
            that of `start`. With `start` it may have other settings but not other networks.
        task: the simulator for training and evaluation, its name, or a Gymnasium environment, its id, or a function that makes
            one (see `tasks.registry.task`); None: the one in which `start` was evaluated.
        steps: environment steps per seed, including the random ones at the beginning. A run can be resumed with more steps.
        seeds: number of independent runs, with the random seeds `seed` .. `seed + seeds - 1`; None: 1, or those of `start`.
        seed: the first random seed; None: 0, or that of `start`.
        out: run folder; None is `runs/AGENT-TASK-online`, or `runs/AGENT-TASK-fine-tuned` with `start`.
        **settings: `start`, `data`, `log_share`, `settings` (an `Online`), `evaluate_every`, `episodes`, `chunk`, `resume`,
            `threads`, `demonstrations`, `callback`, `track` and `watch`; see `runs.settings.OnlineSettings`.

    Raises:
        UserError: invalid input, in one line; nothing is written then.
    """
    asked = OnlineSettings.of(settings)
    asked.check(seed or 0, seeds=1 if seeds is None else seeds)
    start = None if asked.start is None else start_of(asked.start)
    if start is not None and (seed, seeds) != (None, None):
        wanted = [(start.run.seeds[0] if seed is None else seed) + i for i in range(seeds or len(start.run.seeds))]
        if wanted != start.run.seeds:
            raise UserError(f"the run to continue has the seeds {start.run.seeds}; leave seeds and seed out")
    first = seed or 0
    numbers = start.run.seeds if start is not None else list(range(first, first + (seeds or 1)))
    if agent is None:
        if start is None:
            raise UserError("train_online needs an agent, or an offline run to continue (start)")
        agent = [each.going_on() for each in start.agents]
    lanes = lanes_of(agent, len(numbers))
    if start is not None and agent_name(lanes[0]) != agent_name(start.agents[0]):
        learned, other = agent_name(start.agents[0]), agent_name(lanes[0])
        raise UserError(f"{start.run.path} is a run of {learned}, {other} cannot continue it")
    if task is None and start is not None and start.run.config["task"] is not None:
        task = of_run(start.run.config["task"])
    if task is None:
        raise UserError("train_online needs a task, the simulator to train in")
    task = find_task(task)
    kind = "online" if start is None else "fine-tuned"
    folder = Folder(Path(out) if out is not None else Path("runs") / file_part(f"{short_name(lanes[0])}-{task.name}-{kind}"))
    with folder.alone():
        return _train_online(lanes, task, steps, numbers, folder, asked, start)


def _train_online(
    lanes: Sequence[Agent], task: Task, steps: int, numbers: list[int], folder: Folder, asked: OnlineSettings,
    start: Start | None,
) -> Run:  # fmt: skip
    """The run in `folder`, with one agent per seed."""
    if len(task.observation_shape) != 1:
        shown = "images" if task.observation_dtype == "uint8" else "observations"
        raise UserError(f"{task.name} has {shown} of shape {task.observation_shape}; online training needs flat observations")
    turns = asked.settings or turns_of(type(lanes[0]), task.name, start is not None)
    trackers = trackers_of(asked.track, 1)
    updates = turns.updates(steps)
    every = max(1, round((asked.evaluate_every or max(steps // 50, 1)) * turns.updates_per_step))
    if asked.evaluate_every is None:
        every = folder.period(asked.resume) or every
    shown = None if asked.demonstrations is None else _demonstrated(asked.demonstrations, task)
    before, read = (None, Read()) if start is None else (start.log, start.read)
    log = beside(asked.data, before, read, task, asked.log_share)
    if log is not None:
        check_agent(lanes[0])
    if shown is not None and log is not None:
        raise UserError("demonstrations are for the imitation phase of DAPG, data is a log in the replay: give one of them")
    job = _job(lanes, task, numbers, updates, folder, dataclasses.replace(asked, settings=turns), every, shown, log)
    lanes = job.learners
    for text in () if log is None else about_sizes(log.log, lanes[0]):
        warnings.warn(text, stacklevel=3)
    config = _config(job, task, turns, updates, asked.episodes, shown, log, start)
    if start is not None:
        job.states = jax.device_put(start.states(job.states))
    unsure = folder.config.exists() and _untold(config)
    doubts = [f"{task.name} has no spec: whether {folder.path} was begun in the same one is not checked"] if unsure else []
    opened(job, [folder], [config], asked.resume, doubts)
    given = log.taught if log is not None else np.zeros(0, np.uint64) if shown is None else shown.episode_ids
    taught = functools.partial(_taught, job, folder, task, turns.copies, given)
    learned = None if log is None else log.log
    held = np.zeros(0, np.uint64) if log is None else log.held
    recorder = Recorder([folder], job, task, learned, job.stops, asked.episodes, taught, held)
    try:
        with tracked([folder], trackers) as tracking:
            if job.step == 0 and not folder.part("evaluations", 0).exists():
                # The policy before training: of random networks, with which some logs are collected, or of `start`.
                recorder.judge_now(0)
            else:
                recorder.catch_up()
            follow(job, [recorder], asked, tracking)
    finally:
        recorder.close()
    return load(folder.path)


def _config(
    job: Fit,
    task: Task,
    turns: Online,
    updates: int,
    episodes: int,
    shown: Dataset | None,
    log: Beside | None,
    start: Start | None,
) -> dict[str, Any]:
    """`run.json` of a run: `updates` were requested, which the fit completes to whole blocks; `episodes` are per evaluation."""
    lanes = job.learners
    config = {
        "agent": {"name": agent_name(lanes[0]), "fields": fields_of(lanes)},
        "online": dataclasses.asdict(turns),
        "data": {"name": f"{task.name}, online", "fingerprint": f"online:{task.name}"},
        **_noted(task),
        "seeds": job.seeds,
        "steps": updates,
        "evaluation": {"every": job.stops, "episodes": episodes},
        "versions": versions() | {"lanes": len(lanes), **task.versions},
        "revisions": of_learning() | {"method": revisions(lanes[0])},
    }
    if shown is not None:
        known = {"fingerprint": shown.fingerprint, "rows": len(shown), "episodes": shown.episodes}
        config["demonstrations"] = {"name": shown.name, **known, "return": float(shown.returns().mean())}
    if log is not None:
        config["log"], config["log_read"] = log.told, log.read
    if start is not None:
        config["start"] = start.told
    return json.loads(json.dumps(config, default=str))


def _taught(job: Fit, folder: Folder, task: Task, copies: int, given: np.ndarray) -> np.ndarray | None:
    """Ids of the given episodes, of the log in the replay or of the demonstrations, and of those of the run's own steps; None
    where these are no log, because a lane that diverged acted with numbers that are not finite."""
    done, provenance = job.source.environment_steps, Provenance("replay")
    assert done is not None
    own = []
    try:
        for seed in job.seeds:
            steps_log = replay_log(folder.replay(seed), task, copies, done, name=task.name, provenance=provenance)
            own.append(steps_log.episode_ids)
    except UserError:
        return None
    return np.unique(np.concatenate([given, *own]))


def turns_of(kind: type[Agent], task: str, started: bool, **given: Any) -> Online:
    """How acting and updates alternate: as given, or else the agent's defaults; a continued agent acts from the first step."""
    return Online(**kind.acting(task) | ({"explore": 0} if started else {}) | given)


def _noted(task: Task) -> dict[str, Any]:
    """What `run.json` says of a task: its name, and what the name does not tell, or may not tell in another process."""
    config: dict[str, Any] = {"task": task.name}
    if registered := registered_fields(task):
        config["task_registered"] = registered
    if own := own_fields(task):  # its name does not tell it from others
        config["task_fields"] = own | task.described
    return config


def _untold(config: dict[str, Any]) -> bool:
    """Whether a run's environment is one of Gymnasium that neither its name nor a spec tells from others."""
    own = config.get("task_fields", {})
    return own.get("domain") == "gymnasium" and SPEC not in own


def _demonstrated(given: Dataset | str | Path, task: Task) -> Dataset:
    """A log of demonstrations, with the bounds of actions of its task.

    Raises:
        UserError: no log, or one whose sizes differ from the task's.
    """
    log = given if isinstance(given, Dataset) else catalogue.load(given)
    check_sizes(log, task)
    return log.with_action_space(task.action_space)


def reopened(path: Path | str, data: Dataset | str | Path | None = None, task: Any = None) -> Fit:
    """An online run at its newest checkpoint, for inspection: its `learners`, their complete `states`, including a learned
    model, its real steps in `experience`, and its task.

    Args:
        path: of the run.
        data: the log in its replay, if it has one that has been moved.
        task: in which it was trained, as `tasks.registry.task` takes it; None: the one that its name finds.

    Raises:
        UserError: `path` is no online run, its checkpoint or log cannot be read, `task` is another one, or there is none
            although the name of the run's task does not find it.
    """
    folder = Folder(Path(path))
    config = folder.read_config() if folder.config.exists() else {}
    if "online" not in config:
        raise UserError(f"{path} is not the folder of an online run")
    lanes = agents_of(config)
    every = config["evaluation"]["every"]
    settings = OnlineSettings(settings=Online(**config["online"]), chunk=every)
    if task is None and "task_fields" in config:
        raise UserError(f"{path} was trained in a task that its name does not find; give it as task")
    task, log = of_run(config["task"]) if task is None else find_task(task), None
    noted = json.loads(json.dumps(_noted(task), default=str))
    if different := differences(config, noted, ("task", "task_fields", "task_registered")):
        raise UserError(f"{path} was trained in another task: {different[0]}; give that one as task")
    if told := config.get("log"):
        log = beside(data, told, Read.of(config.get("log_read"), None, None), task, told["share"])
        settings = dataclasses.replace(settings, log_share=told["share"])
    job = _job(lanes, task, config["seeds"], config["steps"], folder, settings, every, None, log)
    job.resume()
    if job.step == 0:
        raise UserError(f"{path} has no checkpoint with an update yet")
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
    log: Beside | None,
) -> Fit:
    """The fit; agents are resolved for the task, or for the log in the replay."""
    spec = Spec.empty(task.observation_shape, task.action_space, task.name) if log is None else log.log.spec
    lanes = [lane.resolve(spec, updates) for lane in lanes]
    replays = [folder.replay(s) for s in seeds]
    turns = settings.settings
    assert turns is not None  # set by all callers
    options = {} if log is None else {"log": log.log, "share": settings.log_share}
    kind = experience_of(lanes[0], log is not None)
    experience = kind(task, lanes[0], seeds, updates, turns, replays, settings.threads, **options)
    if shown is not None:
        experience.show(shown)
    return Fit(lanes, experience, seeds, updates, settings.chunk, folder.checkpoints, stops=stops)
