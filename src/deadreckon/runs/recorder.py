"""What a run writes while it goes: metrics, policies, evaluations and how far it has come."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from deadreckon.agents import agent_name
from deadreckon.data.dataset import Dataset
from deadreckon.files import replacing, write_json
from deadreckon.policies import store
from deadreckon.policies.policy import Deployed
from deadreckon.runs.diagnostics import LogProbe, estimated_values, log_segments
from deadreckon.runs.evaluate import episode_seeds, evaluate
from deadreckon.runs.folder import Folder
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit, Progress

RECORDED = 8  # episodes a policy whose observations are kept for pictures
Watcher = Callable[[Progress, int], None]  # gets each chunk's progress and the number of updates in all
PICTURED = 32  # most observation dimensions of a log whose stretches are kept for pictures


class Enough(Exception):
    """Raised by a watcher: the run ends with this chunk, as if no more had been asked for. It may be resumed with more."""


def _nothing(policy: Deployed) -> dict[str, float]:
    return {}


class Recorder:
    """Writes what a run shows for itself: metrics a chunk, policies and evaluations at their times.

    Simulation runs in a thread of its own, so that it does not hold up training where a core is free. The policies it
    judges are on disk first: an evaluation that a kill interrupts is done again from them.
    """

    def __init__(self, folder: Folder, job: Fit, judge: Task | None, log: Dataset | None, every: int, episodes: int):
        self.folder, self.job, self.judge = folder, job, judge
        self.every, self.episodes = every, episodes
        self.discounts = [float(getattr(lane, "discount", 0.99)) for lane in job.learners]
        self.probe = LogProbe(log) if log is not None else _nothing  # an online run has no log to stay near to
        self.pool = ThreadPoolExecutor(1)
        self.pending: list[Future] = []
        # Evaluations start where no training ever looks; the same starts every time, so that curves are paired.
        self.starts = None if judge is None else judge.simulate(episode_seeds(0, episodes)).reset()

    def policies(self) -> list[Deployed]:
        """The lanes' present policies."""
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

    def follow(self, watch: Watcher) -> None:
        """Walks the fit to its end: every chunk is recorded, then told. A watcher may have it end before; see `Enough`."""
        for progress in self.job.chunks():
            self.record(progress)
            try:
                watch(progress, self.job.steps)
            except Enough:
                self.job.steps = progress.step
                self.folder.shorten(progress.step)
                if progress.step not in self.folder.policy_steps():
                    self.judge_now(progress.step)
                self.job.save()
                break
        self.finish()

    def record(self, progress: Progress) -> None:
        """Called after every chunk, before its checkpoint is written."""
        seeds = self.job.seeds
        done = [future for future in self.pending if future.done()]
        self.pending = [future for future in self.pending if not future.done()]
        for future in done:
            future.result()  # what went wrong in the background is told at the next chunk, not hours later
        columns: dict[str, Any] = {"step": np.full(len(seeds), progress.step), "seed": np.asarray(seeds)}
        if self.job.experience is not None:
            columns["environment_steps"] = np.full(len(seeds), self.job.experience.environment_steps)
        self.folder.write_part("metrics", progress.step, columns | progress.metrics)
        if progress.step % self.every == 0 or progress.step == self.job.steps or all(progress.failures):
            self.judge_now(progress.step)
        self._status(progress.step, finished=False)

    def judge_now(self, step: int) -> None:
        """Keeps the present policies and sets their evaluation going."""
        self._keep(step)
        self._submit(step)

    def _keep(self, step: int) -> None:
        policies = self.policies()
        values = None
        if self.starts is not None:
            values = estimated_values(self.job.learner, self.job.states, self.job.rows.view, policies, self.starts)
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
        """Lets evaluations that have begun end, and forgets the others: `catch_up` does them."""
        self.pool.shutdown(wait=True, cancel_futures=True)
