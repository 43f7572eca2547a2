"""The files that a run writes during training: metrics, policies, evaluations and progress."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from deadreckon.agents import agent_name
from deadreckon.data.dataset import Dataset
from deadreckon.data.history import beginning, stacked
from deadreckon.devices import on_processor
from deadreckon.files import replacing, write_json
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy, History, deployed, memoryless
from deadreckon.runs.callback import StopTraining, TrainingProgress, ends
from deadreckon.runs.diagnostics import LogProbe, estimated_values, log_segments
from deadreckon.runs.evaluate import episode_seeds, evaluate
from deadreckon.runs.folder import Folder
from deadreckon.runs.reading import noted
from deadreckon.runs.settings import RunSettings
from deadreckon.runs.trackers.feed import Tracking
from deadreckon.tasks.task import Task
from deadreckon.tasks.turns import first_observations
from deadreckon.training.fit import Chunk, Fit
from deadreckon.training.learner import unstack
from deadreckon.training.part import Part

RECORDED = 8  # episodes per policy whose observations are stored for figures
PICTURED = 32  # most observation dimensions of a log whose segments are stored for figures


def _nothing(policy: EnvPolicy) -> dict[str, float]:
    return {}


class Recorder:
    """Writes the files of a run: metrics of every chunk, and policies and evaluations periodically.

    Policies are evaluated in a separate thread, so that training is not delayed if a core is free. They are written to disk
    first: an evaluation that was interrupted is done again from them.

    Args:
        folders: of the runs that share the fit, in the order of its lanes, which are as many for each.
        job: the fit, or its lanes that are trained on one log.
        judge: the task in which policies are evaluated, if any.
        log: the training log; None online.
        every: updates between evaluations.
        episodes: per evaluation and lane.
        taught: (episodes,) uint64 `episode_ids` of the training episodes. Online, a function that returns them when the run has
            finished, because the episodes of its own steps are among them; files of earlier policies do not record any.
        held: (episodes,) uint64 `episode_ids` of the held-out episodes of the log.
        history: number of last observations that policies act on.
        by: column whose values were kept together when episodes were held out; None: none.
    """

    def __init__(
        self, folders: Sequence[Folder], job: Fit | Part, judge: Task | None, log: Dataset | None, every: int, episodes: int,
        taught: np.ndarray | Callable[[], np.ndarray | None], held: np.ndarray, history: int = 1,
        by: str | None = None,
    ):  # fmt: skip
        self.folders, self.job, self.judge = list(folders), job, judge
        self.seeds = len(job.seeds) // len(folders)  # of a run
        self.every, self.episodes, self.taught, self.held = every, episodes, taught, held
        self.read = {} if log is None else {"log": noted(log)} | ({} if by is None else {"by": by})
        self.discounts = [float(getattr(lane, "discount", 0.99)) for lane in job.learners]
        self.history, self.spec = history, job.each[0].spec if log is None else log.spec
        self.probe = _nothing if log is None else LogProbe(stacked(log, history))  # an online run has no log to compare with
        self.pool = ThreadPoolExecutor(1)
        self.pending: list[Future] = []
        # Starts that training never uses, and the same ones every time, so that learning curves are paired.
        self.starts = None if judge is None else first_observations(judge, episode_seeds(0, episodes))

    def policies(self) -> list[EnvPolicy]:
        """The lanes' current policies."""
        view = self.job.each[0].view
        states = unstack(self.job.states, len(self.job.seeds))
        return [
            History.of(deployed(agent, state, view), self.history, self.spec) for agent, state in zip(self.job.learners, states)
        ]

    def picture(self, log: Dataset) -> None:
        """Stores segments of a log of few dimensions, so that a report can show it without the log."""
        missing = [folder.log for folder in self.folders if not folder.log.exists()]
        if self.judge is None or log.spec.observation_size > PICTURED or not missing:
            return
        segments = log_segments(log)
        for path in missing:
            with replacing(path) as temporary, open(temporary, "wb") as file:
                np.savez_compressed(file, segments=segments)

    def catch_up(self) -> None:
        """Evaluates stored policies whose evaluation was interrupted."""
        for step in self._kept():
            if step > self.job.step:
                for path in self._paths(step):
                    path.unlink(missing_ok=True)
            elif not all(folder.part("evaluations", step).exists() for folder in self.folders):
                self._submit(step)

    def _kept(self) -> list[int]:
        """Updates after which policies were stored, ascending."""
        return sorted({step for folder in self.folders for step in folder.policy_steps()})

    def _paths(self, step: int | None = None) -> list[Path]:
        """Paths of the policies, one per lane."""
        return [self.folders[lane // self.seeds].policy(seed, step) for lane, seed in enumerate(self.job.seeds)]

    def _share(self, run: int, each: int = 1) -> slice:
        """A run's part of columns that have `each` rows per lane."""
        return slice(run * self.seeds * each, (run + 1) * self.seeds * each)

    def seen(self, progress: Chunk) -> list[TrainingProgress]:
        """The progress of each run, for callbacks."""
        every = []
        for run, folder in enumerate(self.folders):
            own, metrics = self._share(run), {name: values[self._share(run)] for name, values in progress.metrics.items()}
            every.append(
                TrainingProgress(
                    folder.path, progress.step, self.job.steps, list(self.job.seeds[own]), metrics, progress.failures[own],
                    lambda folder=folder: self._judged(folder, progress.step), lambda own=own: self.policies()[own],
                )
            )  # fmt: skip
        return every

    def _judged(self, folder: Folder, step: int) -> pa.Table:
        """All evaluations of a run up to a step; waits for those that are not done yet."""
        for future in self.pending:
            future.result()
        table = folder.table("evaluations")
        return table if not table.num_rows else table.filter(pc.field("step") <= step)

    def record(self, progress: Chunk) -> None:
        """Called after every chunk, before its checkpoint is written."""
        seeds = self.job.seeds
        done = [future for future in self.pending if future.done()]
        self.pending = [future for future in self.pending if not future.done()]
        for future in done:
            future.result()  # errors in the background are raised at the next chunk, not hours later
        columns: dict[str, Any] = {"step": np.full(len(seeds), progress.step), "seed": np.asarray(seeds)}
        if (acted := self.job.source.environment_steps) is not None:
            columns["environment_steps"] = np.full(len(seeds), acted)
        self._write("metrics", progress.step, columns | progress.metrics)
        if progress.step % self.every == 0 or progress.step == self.job.steps or self.job.ended:
            self.judge_now(progress.step)
        self._status(progress.step, finished=False)

    def _write(self, kind: str, step: int, columns: dict[str, Any], each: int = 1) -> None:
        """Writes the rows of every run, of which each lane has `each`."""
        for run, folder in enumerate(self.folders):
            own = self._share(run, each)
            folder.write_part(kind, step, {name: values[own] for name, values in columns.items()})

    def judge_now(self, step: int) -> None:
        """Stores the current policies and starts their evaluation."""
        self._keep(step)
        self._submit(step)

    def _keep(self, step: int) -> None:
        policies = self.policies()
        values = None
        # If rewards of the log differ from those of the task, values of critics cannot be compared with returns in the task.
        if self.starts is not None and (self.judge is None or self.judge.logs_pay_alike):
            seen, acting = self.starts, [memoryless(policy) for policy in policies]
            if self.history > 1:
                seen = beginning(np.asarray(seen, np.float32), self.spec.action_size, self.history)
            values = estimated_values(self.job.learner, self.job.states, self.job.each[0].view, acting, seen)
        for i, (path, seed, policy) in enumerate(zip(self._paths(step), self.job.seeds, policies)):
            meta: dict[str, Any] = {"agent": agent_name(self.job.learners[0]), "seed": seed, "step": step, **self.read}
            if values is not None:
                meta["estimated_values"] = [float(v) for v in values[i]]
            store.save(path, policy, meta, taught=None if callable(self.taught) else self.taught, held=self.held)

    def _submit(self, step: int) -> None:
        self.pending.append(self.pool.submit(self._judge, step))

    def _judge(self, step: int) -> None:
        with on_processor():
            self._judge_beside(step)

    def _judge_beside(self, step: int) -> None:
        paths = self._paths(step)
        saved = [store.load_all(path) for path in paths]
        policies, metas = [each.policy for each in saved], [each.meta for each in saved]
        probes = [self.probe(memoryless(policy)) for policy in policies]
        count = self.episodes if self.judge is not None else 1
        columns: dict[str, Any] = {
            "step": np.full(len(policies) * count, step),
            "seed": np.repeat(self.job.seeds, count),
            "episode": np.tile(np.arange(count), len(policies)),
        }
        for name in probes[0]:
            columns[name] = np.repeat([probe[name] for probe in probes], count)
        if self.judge is not None:
            last = step == self.job.steps
            # Image observations are not used in figures; a task with a camera has other values for them.
            drawn = self.judge.observation_dtype != "uint8" or type(self.judge).shown is not Task.shown
            recorded = RECORDED if drawn else 0
            result = evaluate(
                policies, self.judge, episodes=count, discount=self.discounts, record=min(recorded, count) if last else 0
            )
            columns |= {"return": result.returns.ravel(), "length": result.lengths.ravel()}
            columns |= {"discounted_return": result.discounted.ravel()}
            if (scores := result.scores) is not None:
                columns["score"] = scores.ravel()
            if all("estimated_values" in meta for meta in metas):
                columns["estimated_value"] = np.concatenate([meta["estimated_values"] for meta in metas])
            if result.trajectories is not None:
                for run, folder in enumerate(self.folders):
                    with replacing(folder.trajectories) as temporary, open(temporary, "wb") as file:
                        np.savez_compressed(file, trajectories=result.trajectories[self._share(run)])
        self._write("evaluations", step, columns, count)

    def _status(self, step: int, *, finished: bool) -> None:
        failures = [None if f is None else list(f) for f in self.job.failures]
        for run, folder in enumerate(self.folders):
            own = {"step": step, "steps": self.job.steps, "finished": finished, "failures": failures[self._share(run)]}
            write_json(folder.status, own)

    def finish(self) -> None:
        """Waits for the evaluations, then writes the last policies; with them the run is finished."""
        for future in self.pending:
            future.result()
        taught = self.taught() if callable(self.taught) else self.taught
        if callable(self.taught) and taught is not None:
            for folder in self.folders:
                folder.note_episodes(taught, self.held, anew=True)
        for path, seed, policy in zip(self._paths(), self.job.seeds, self.policies()):
            if not path.exists():
                meta = {"agent": agent_name(self.job.learners[0]), "seed": seed, **self.read}
                store.save(path, policy, meta, taught=taught, held=self.held)
        self._status(self.job.step, finished=True)

    def end_at(self, step: int) -> None:
        """Ends the run with the current policies, after fewer updates than were requested."""
        for folder in self.folders:
            folder.shorten(step)
        if step not in self._kept():
            self.judge_now(step)
        elif self.judge is not None:  # once more, now as the last one, whose trajectories are stored
            self._submit(step)

    def close(self) -> None:
        """Waits for evaluations that have begun, and cancels the others, which `catch_up` does later."""
        self.pool.shutdown(wait=True, cancel_futures=True)


def opened(
    job: Fit, folders: Sequence[Folder], configs: Sequence[dict[str, Any]], resume: bool, doubts: Sequence[str] = ()
) -> None:
    """Begins the runs of a fit, or resumes them from its newest checkpoint.

    Nothing is written if `Folder.check` refuses a run. After a crash at any moment, the runs can be resumed. What the
    callers write next, such as the ids of episodes, is written again when a run is resumed.

    Args:
        job: the fit, which is brought to its newest checkpoint.
        folders: of the runs.
        configs: `run.json` of each.
        resume: whether a folder may hold the run already.
        doubts: further warnings, before anything is written.

    Raises:
        UserError: a folder holds another run or something else, or the checkpoints are damaged.
    """
    told = [text for folder, config in zip(folders, configs) for text in folder.check(config, resume=resume)]
    for text in dict.fromkeys([*told, *doubts]):
        warnings.warn(text, stacklevel=4)
    for folder, config in zip(folders, configs):
        folder.begin(config)
    job.resume()
    for folder, config in zip(folders, configs):  # not before it is certain that they can be resumed
        folder.lengthen(config)
        folder.drop_after(job.step)


def follow(job: Fit, recorders: Sequence[Recorder], settings: RunSettings, tracking: Sequence[Tracking] = ()) -> None:
    """Trains a fit to its end: chunks are recorded, then passed to trackers, watcher and callback, which may end all its runs.

    Args:
        job: the fit.
        recorders: of the fit, or of parts of it.
        settings: `watch` is called once a chunk, `callback` for every run.
        tracking: of the runs that have trackers.
    """
    for each in tracking:
        each.start()
    for progress in job.chunks():
        parts = [recorder.job.of(progress) if isinstance(recorder.job, Part) else progress for recorder in recorders]
        for recorder, part in zip(recorders, parts):
            recorder.record(part)
        for each in tracking:
            each.told(progress.step)
        try:
            settings.watch(progress, job.steps)
            if settings.callback is not None:
                seen = [each for recorder, part in zip(recorders, parts) for each in recorder.seen(part)]
                if any([ends(settings.callback, each) for each in seen]):
                    raise StopTraining
        except StopTraining:
            job.steps = progress.step
            for recorder in recorders:
                recorder.end_at(progress.step)
            job.save()
            break
    for recorder in recorders:
        recorder.finish()
