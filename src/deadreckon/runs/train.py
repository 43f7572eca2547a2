"""From a log to policies in a run folder: the one place where an agent meets its judge."""

import dataclasses
import json
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from deadreckon.agents import agent_class, agent_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.batch import Rows
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.files import read_json, replacing, write_json
from deadreckon.policies import store
from deadreckon.policies.policy import Deployed
from deadreckon.runs.diagnostics import LogProbe, estimated_values, log_segments, logged_value
from deadreckon.runs.evaluate import episode_seeds, evaluate
from deadreckon.runs.folder import Folder, versions
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Failure, Fit, Progress

RECORDED = 8  # episodes a policy whose observations are kept for pictures
PICTURED = 32  # most observation dimensions of a log whose stretches are kept for pictures
Watcher = Callable[[Progress, int], None]  # gets each chunk's progress and the number of updates in all


@dataclasses.dataclass
class Run:
    """A finished (or failed) run: its folder, and what it learned.

    Attributes:
        path: the run folder.
        config: what was asked for.
        seeds: one a lane.
        policies: one a seed; of a failed lane, the last good one.
        failures: per seed None, or the metric and step at which its numbers went bad.
    """

    path: Path
    config: dict[str, Any]
    seeds: list[int]
    policies: list[Deployed]
    failures: list[Failure | None]

    @property
    def policy(self) -> Deployed:
        """The first seed's policy."""
        return self.policies[0]

    @property
    def metrics(self) -> pa.Table:
        """step, seed and one column a metric, a row a chunk and seed."""
        return Folder(self.path).table("metrics")

    @property
    def evaluations(self) -> pa.Table:
        """One row an episode of every periodic evaluation."""
        return Folder(self.path).table("evaluations")

    def __repr__(self) -> str:
        return f"Run({self.path}, {self.config['agent']['name']}, seeds {self.seeds})"


def train(
    agent: Agent | str | Sequence[Agent],
    data: Dataset | str | Path,
    *,
    steps: int = 100_000,
    seeds: int = 1,
    seed: int = 0,
    task: Task | str | None = None,
    out: Path | str | None = None,
    evaluate_every: int | None = None,
    episodes: int = 20,
    chunk: int = 1000,
    resume: bool = False,
    stream: bool | None = None,
    strict: bool = False,
    watch: Watcher = lambda progress, steps: None,
) -> Run:
    """Trains an agent on a log, several seeds as one compiled program, and judges it as it goes.

    Args:
        agent: an agent, its name, or one agent a seed that differ in float fields only.
        data: a log, the name of a known one, or a file.
        steps: updates.
        seeds: how many: `seed` .. `seed + seeds - 1`.
        seed: the first.
        task: the simulator to evaluate in; None takes that of a known log, and none for others.
        out: run folder; None is `runs/AGENT-LOG`.
        evaluate_every: updates between evaluations; None is a tenth of the run. The last update is always evaluated.
        episodes: an evaluation.
        chunk: updates between checkpoints, which is also what a kill can lose.
        resume: go on with the run in `out`; a finished one is given back as it is.
        stream: fetch batches from the host instead of keeping the log on the device; None decides by memory.
        strict: refuse logs with actions out of bounds.
        watch: called after every chunk.

    Raises:
        UserError: input that does not fit, in one line; nothing is written then.
    """
    if steps < 1 or seeds < 1 or chunk < 1 or episodes < 1:
        raise UserError(f"steps, seeds, chunk and episodes must be >= 1, got {steps}, {seeds}, {chunk}, {episodes}")
    if not 0 <= seed <= 2**32 - seeds:
        raise UserError(f"seed must be 0 .. 2^32 - seeds, got {seed}")
    if evaluate_every is not None and evaluate_every < 1:
        raise UserError(f"evaluate_every must be >= 1, got {evaluate_every}")
    log = data if isinstance(data, Dataset) else catalogue.load(data, strict=strict)
    judge = _judge(task, log)
    if judge is not None and judge.observation_shape != log.spec.observation_shape:
        raise UserError(
            f"{judge.name} shows observations of shape {judge.observation_shape}, "
            f"{log.name} has {log.spec.observation_shape}"
        )
    log = log.with_action_space(log.action_space if judge is None else judge.action_space, strict)
    lanes = [agent_class(agent)()] * seeds if isinstance(agent, str) else agent
    lanes = [lanes] * seeds if isinstance(lanes, Agent) else list(lanes)
    if len(lanes) != seeds:
        raise UserError(f"one agent a seed is needed, got {len(lanes)} agents and {seeds} seeds")
    lanes = [lane.resolve(log.spec, steps) for lane in lanes]
    every = min(evaluate_every or max(steps // 10, 1), steps)
    rows = Rows(log, lanes[0].needs(log.spec))

    config = {
        "agent": {"name": agent_name(lanes[0]), "fields": _fields(lanes)},
        "data": {"name": log.name, "fingerprint": log.fingerprint, "rows": len(log), "episodes": log.episodes,
                 "usable": rows.count, "warnings": log.warnings,
                 "behavior": None if judge is None else logged_value(log, judge),
                 "provenance": dataclasses.asdict(log.provenance)},
        "task": None if judge is None else judge.name,
        "seeds": list(range(seed, seed + seeds)),
        "steps": steps,
        "evaluation": {"every": every, "episodes": episodes},
        "versions": versions() | {"lanes": seeds},
    }  # fmt: skip
    config = json.loads(json.dumps(config, default=str))
    folder = Folder(Path(out) if out is not None else Path("runs") / f"{config['agent']['name']}-{log.name}")
    # Built before anything is written: whatever does not fit is told while the disk is untouched.
    job = Fit(lanes, rows, config["seeds"], steps, chunk, folder.checkpoints, stream=stream, stops=every)
    for text in folder.begin(config, resume=resume):
        warnings.warn(text, stacklevel=2)
    job.resume()
    folder.drop_after(job.step)

    recorder = _Recorder(folder, job, judge, log, every, episodes)
    try:
        recorder.picture(log)
        recorder.catch_up()
        for progress in job.chunks():
            recorder.record(progress)
            watch(progress, steps)
        recorder.finish()
    finally:
        recorder.close()
    return load(folder.path)


def load(path: Path | str) -> Run:
    """A run from its folder.

    Raises:
        UserError: the folder holds no run, or one that is not finished.
    """
    folder = Folder(Path(path))
    if not folder.config.exists():
        raise UserError(f"{path} holds no run (no run.json)")
    config = read_json(folder.config)
    if not isinstance(config, dict) or not {"agent", "data", "task", "seeds", "steps"} <= config.keys():
        raise UserError(f"{folder.config} is not a run's: it misses agent, data, task, seeds or steps")
    missing = [seed for seed in config["seeds"] if not folder.policy(seed).exists()]
    if missing:
        raise UserError(f"{path} is not finished; `deadreckon train ... --out {path} --resume` goes on with it")
    status = read_json(folder.path / "status.json")
    if not isinstance(status, dict) or "failures" not in status:
        raise UserError(f"{folder.path / 'status.json'} is not a run's: it misses failures")
    policies = [store.load(folder.policy(seed)) for seed in config["seeds"]]
    failures = [None if f is None else Failure(*f) for f in status["failures"]]
    return Run(folder.path, config, config["seeds"], policies, failures)


class _Recorder:
    """Writes what a run shows for itself: metrics a chunk, policies and evaluations at their times.

    Simulation runs in a thread of its own, so that it does not hold up training where a core is free. The policies it
    judges are on disk first: an evaluation that a kill interrupts is done again from them.
    """

    def __init__(self, folder: Folder, job: Fit, judge: Task | None, log: Dataset, every: int, episodes: int):
        self.folder, self.job, self.judge = folder, job, judge
        self.every, self.episodes = every, episodes
        self.discounts = [float(getattr(lane, "discount", 0.99)) for lane in job.learners]
        self.probe = LogProbe(log)
        self.pool = ThreadPoolExecutor(1)
        self.pending: list[Future] = []
        # Evaluations start where no training ever looks; the same starts every time, so that curves are paired.
        self.starts = None if judge is None else judge.simulate(episode_seeds(0, episodes)).reset()

    def policies(self) -> list[Deployed]:
        view = self.job.rows.view
        lanes = range(len(self.job.seeds))
        states = [jax.tree.map(lambda leaf, i=i: leaf[i], self.job.states) for i in lanes]
        return [Deployed.of(agent.policy(state), view) for agent, state in zip(self.job.learners, states)]

    def picture(self, log: Dataset) -> None:
        """Keeps stretches of a log of few dimensions, so that a report can draw it without the log."""
        if self.judge is not None and log.spec.observation_size <= PICTURED and not self.folder.log.exists():
            with replacing(self.folder.log) as temporary, open(temporary, "wb") as file:
                np.savez_compressed(file, segments=log_segments(log))

    def catch_up(self) -> None:
        """Judges kept policies whose evaluation was interrupted."""
        for step in self.folder.policy_steps():
            if step > self.job.step:
                for seed in self.job.seeds:
                    self.folder.policy(seed, step).unlink(missing_ok=True)
            elif not self.folder.part("evaluations", step).exists():
                self._submit(step)

    def record(self, progress: Progress) -> None:
        """Called after every chunk, before its checkpoint is written."""
        seeds = self.job.seeds
        done = [future for future in self.pending if future.done()]
        self.pending = [future for future in self.pending if not future.done()]
        for future in done:
            future.result()  # what went wrong in the background is told at the next chunk, not hours later
        columns: dict[str, Any] = {"step": np.full(len(seeds), progress.step), "seed": np.asarray(seeds)}
        self.folder.write_part("metrics", progress.step, columns | progress.metrics)
        if progress.step % self.every == 0 or progress.step == self.job.steps or all(progress.failures):
            self._keep(progress.step)
            self._submit(progress.step)
        self._status(progress.step, finished=False)

    def _keep(self, step: int) -> None:
        policies = self.policies()
        values = None
        if self.starts is not None:
            values = estimated_values(self.job.learner, self.job.states, self.job.rows, policies, self.starts)
        for i, (seed, policy) in enumerate(zip(self.job.seeds, policies)):
            meta = {"agent": agent_name(self.job.learners[0]), "seed": seed, "step": step}
            if values is not None:
                meta["estimated_values"] = [float(v) for v in values[i]]
            store.save(self.folder.policy(seed, step), policy, meta)

    def _submit(self, step: int) -> None:
        self.pending.append(self.pool.submit(self._judge, step))

    def _judge(self, step: int) -> None:
        paths = [self.folder.policy(seed, step) for seed in self.job.seeds]
        policies = [store.load(path) for path in paths]
        metas = [store.meta(path) for path in paths]
        probes = [self.probe(policy) for policy in policies]
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
            result = evaluate(
                policies, self.judge, episodes=count, discount=self.discounts, record=min(RECORDED, count) if last else 0
            )
            columns |= {
                "return": result.returns.ravel(), "score": result.scores.ravel(), "length": result.lengths.ravel(),
                "discounted_return": result.discounted.ravel(),
            }  # fmt: skip
            if all("estimated_values" in meta for meta in metas):
                columns["estimated_value"] = np.concatenate([meta["estimated_values"] for meta in metas])
            if result.trajectories is not None:
                with replacing(self.folder.trajectories) as temporary, open(temporary, "wb") as file:
                    np.savez_compressed(file, trajectories=result.trajectories)
        self.folder.write_part("evaluations", step, columns)

    def _status(self, step: int, *, finished: bool) -> None:
        failures = [None if f is None else list(f) for f in self.job.failures]
        status = {"step": step, "steps": self.job.steps, "finished": finished, "failures": failures}
        write_json(self.folder.path / "status.json", status)

    def finish(self) -> None:
        """Waits for the evaluations, then publishes the last policies; with them the run is finished."""
        for future in self.pending:
            future.result()
        for seed, policy in zip(self.job.seeds, self.policies()):
            if not self.folder.policy(seed).exists():
                store.save(self.folder.policy(seed), policy, {"agent": agent_name(self.job.learners[0]), "seed": seed})
        self._status(self.job.step, finished=True)

    def close(self) -> None:
        self.pool.shutdown(wait=True, cancel_futures=True)


def _judge(task: Task | str | None, log: Dataset) -> Task | None:
    if isinstance(task, Task):
        return task
    if task is not None:
        return find_task(task)
    known = catalogue.ENTRIES.get(log.name.split("@")[0])
    return None if known is None else find_task(known.task)


def _fields(lanes: Sequence[Agent]) -> dict[str, Any]:
    """Hyperparameters by name; those that differ between lanes as a list."""
    out = {}
    for f in dataclasses.fields(lanes[0]):
        values = [getattr(lane, f.name) for lane in lanes]
        out[f.name] = values[0] if all(v == values[0] for v in values) else values
    return out

