"""Runs on logs as lanes of one compiled program, each with its own folder."""

import dataclasses
import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deadreckon.agents import agent_name
from deadreckon.agents.agent import Agent
from deadreckon.data.batch import TransitionSource
from deadreckon.data.catalogue import is_elsewhere
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.flat_pictures import SHAPES
from deadreckon.data.history import stacked
from deadreckon.errors import UserError
from deadreckon.foreign.door import refuse_link, refuse_links
from deadreckon.runs.diagnostics import logged_value
from deadreckon.runs.folder import Folder
from deadreckon.runs.holdout import Divided, divided
from deadreckon.runs.lanes import fields_of
from deadreckon.runs.recorder import Recorder, follow, opened
from deadreckon.runs.settings import TrainSettings
from deadreckon.runs.sizes import about_sizes
from deadreckon.runs.trackers.feed import tracked
from deadreckon.runs.trackers.tracker import trackers_of
from deadreckon.tasks.registry import of_log
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit
from deadreckon.training.part import Part
from deadreckon.training.pictures import Sight, of_pictures, usual_shift
from deadreckon.training.revisions import of_learning, revisions
from deadreckon.versions import versions


class _Learned(NamedTuple):
    """A log, and the runs on it."""

    log: Dataset
    judge: Task | None
    part: Divided
    rows: TransitionSource
    folders: list[Folder]
    lanes: list[Agent]


def train_lanes(
    asked: Mapping[Path, tuple[Dataset, Sequence[Agent]]],
    out: Path,
    steps: int,
    seed: int,
    task: Any,
    settings: TrainSettings,
) -> None:
    """Trains runs to their end, all lanes as one program.

    Args:
        asked: run folder -> its log and its agents, one per seed, the same number in every run.
        out: folder of the checkpoints: the run's folder, or the parent of those of several runs.
        steps: updates of each run.
        seed: the first random seed of each run.
        task: the simulator to evaluate in, see `train`; None takes that of a known log; False: none.
        settings: for evaluation and storage of runs.

    Raises:
        UserError: invalid input, in one line; nothing is written then.
    """
    logs, grouped = {}, {}
    trackers = trackers_of(settings.track, len(asked))
    for path, (log, own) in asked.items():
        key = log.name, log.fingerprint
        logs[key] = log
        grouped.setdefault(key, {})[path] = own
    first = Folder(next(iter(asked)))
    learned: list[_Learned] = []
    for key, runs in grouped.items():
        begun = Folder(next(iter(runs)))  # runs on one log hold out the same
        before = begun.read_config() if settings.resume and begun.config.exists() else None
        one = _learned_of(logs[key], runs, before, steps, task, settings)
        learned.append(one)
        for text in about_sizes(one.log, one.lanes[0]):
            warnings.warn(text, stacklevel=3)

    lanes = [lane for one in learned for lane in one.lanes]
    folders = [folder for one in learned for folder in one.folders]
    seeds = len(lanes) // len(folders)
    numbers = list(range(seed, seed + seeds))
    every = min(settings.evaluate_every or first.period(settings.resume) or max(steps // 10, 1), steps)
    sight = _sight(learned, settings)
    common: dict[str, Any] = {
        "seeds": numbers,
        "steps": steps,
        "evaluation": {"every": every, "episodes": settings.episodes},
        "revisions": of_learning() | {"method": revisions(lanes[0])},
    }
    if settings.history > 1:
        common["history"] = settings.history
    if sight is not None:
        common["encoder"], common["shift"] = sight
    if out != folders[0].path:
        common["together"] = [folder.path.name for folder in folders]
    configs = [config | common for one in learned for config in _configs(one, seeds, len(lanes))]
    configs = [json.loads(json.dumps(config, default=str)) for config in configs]
    kept = Folder(out).checkpoints
    refuse_links(kept, "a run's folder")
    refuse_link(kept, "a run's folder")
    if out != folders[0].path and kept.exists() and not all(folder.config.exists() for folder in folders):
        raise UserError(f"{kept} is of other runs; give {', '.join(folder.path.name for folder in folders)} another folder")
    # Built before anything is written, so that invalid input is refused while the disk is unchanged.
    own = learned[0].rows if len(learned) == 1 else [one.rows for one in learned for _ in one.lanes]
    how: dict[str, Any] = {"stream": settings.stream, "stops": every, "sight": sight or Sight()}
    job = Fit(lanes, own, numbers * len(folders), steps, settings.chunk, kept, **how)
    opened(job, folders, configs, settings.resume)
    for one in learned:
        for folder in one.folders:
            folder.note_episodes(one.part.taught, one.part.held)

    recorders, start = [], 0
    try:
        for one in learned:
            lanes_of_log = slice(start, start := start + len(one.lanes))
            recorders.append(
                Recorder(
                    one.folders, job if len(learned) == 1 else Part(job, lanes_of_log), one.judge, one.part.learning, every,
                    settings.episodes, one.part.taught, one.part.held, settings.history,
                    None if one.part.told is None else one.part.told["by"],
                )
            )  # fmt: skip
        with tracked(folders, trackers) as tracking:
            for one, recorder in zip(learned, recorders):
                recorder.picture(one.part.learning)
                recorder.catch_up()
            follow(job, recorders, settings, tracking)
    finally:
        for recorder in recorders:
            recorder.close()


def _learned_of(
    log: Dataset,
    runs: Mapping[Path, Sequence[Agent]],
    before: dict[str, Any] | None,
    steps: int,
    task: Any,
    settings: TrainSettings,
) -> _Learned:
    """A log, divided for the runs on it, with their agents resolved for it.

    Args:
        log: the log.
        runs: run folder -> its agents, one per seed.
        before: `run.json` of one of these runs, if they are resumed.
        steps, task, settings: as for `train_lanes`.

    Raises:
        UserError: the log, its simulator, an agent or a setting does not fit the others.
    """
    levels = log.provenance.extra.get("action_levels") or ([0, 1] if not log.spec.discrete or log.actions.any() else [0])
    if len(levels) < 2 and "schema" in log.provenance.extra:  # of a table, whose action space has at least two actions
        raise UserError(f"{log.name}: its only action is {levels[0]}, so there is nothing to choose between")
    judge = judge_of(log, task)
    log = log.with_action_space(log.action_space if judge is None else judge.action_space, settings.strict)
    part = divided(log, settings.holdout, judge, before)
    seen = stacked(part.learning, settings.history)
    for each in runs.values():
        if settings.history > 1 and not each[0].supports_history:
            raise UserError(f"{type(each[0]).__name__} takes no histories: {each[0].own_history}; leave history at 1")
    lanes = [lane.resolve(seen.spec, steps) for each in runs.values() for lane in each]
    rows = TransitionSource(seen, lanes[0].needs(seen.spec))
    return _Learned(log, judge, part, rows, [Folder(path) for path in runs], lanes)


def _sight(learned: Sequence[_Learned], settings: TrainSettings) -> Sight | None:
    """How images are seen; None for logs without images.

    Raises:
        UserError: settings for images, and there are none, or they are too small for them.
    """
    if any(of_pictures(one.log.spec) for one in learned):
        return Sight(settings.encoder, _shift(learned[0], settings.shift))
    if seeing := [name for name in ("encoder", "shift") if getattr(settings, name) != getattr(TrainSettings, name)]:
        raise UserError(f"{learned[0].log.name} has no images: leave {' and '.join(seeing)} out")
    return None


def _configs(one: _Learned, seeds: int, lanes: int) -> list[dict[str, Any]]:
    """The parts of `run.json` that depend on the log, for each run on it; a run has `seeds` of the program's `lanes`."""
    log, judge, part = one.log, one.judge, one.part
    own = {
        "data": {"name": log.name, "fingerprint": log.fingerprint, "rows": len(log), "episodes": log.episodes,
                 "holdout": part.told, "usable": one.rows.count, "warnings": log.warnings,
                 "behavior": None if judge is None else logged_value(log, judge),
                 "provenance": dataclasses.asdict(log.provenance)},
        "task": None if judge is None else judge.name,
        "versions": versions() | {"lanes": lanes, **({} if judge is None else judge.versions)},
    }  # fmt: skip
    runs = [one.lanes[start : start + seeds] for start in range(0, len(one.lanes), seeds)]
    return [{"agent": {"name": agent_name(agents[0]), "fields": fields_of(agents)}, **own} for agents in runs]


def _shift(one: _Learned, asked: int | None) -> int:
    """Pixels, the largest random shift of a log's images.

    Raises:
        UserError: more than half of an image.
    """
    height = min(one.log.spec.observation_shape[:2])
    if asked is not None:
        if asked > height // 2:
            raise UserError(f"shift must be at most half of an image, {height // 2} of {height} pixels, got {asked}")
        return asked
    stem = one.log.name.partition("@")[0]
    task = one.judge or of_log(stem)
    still = stem in SHAPES or (task is not None and task.places_matter)  # D4RL's images of roads, by any of their names
    return 0 if still else usual_shift(one.log.spec.observation_shape[0])


def judge_of(log: Dataset, task: Any) -> Task | None:
    """The simulator in which policies of a log are evaluated: the named one, or that of a known log, or none.

    Raises:
        UserError: its observations differ from those of the log.
    """
    if task is False:
        return None
    judge = of_log(log.name) if task is None else find_task(task)
    if task is None and log.provenance.source != "collected" and is_elsewhere(log.name):
        return None
    if judge is not None and judge.observation_shape != log.spec.observation_shape:
        raise UserError(
            f"{judge.name} shows observations of shape {judge.observation_shape}, "
            f"{log.name} has {log.spec.observation_shape}"
        )
    return judge
