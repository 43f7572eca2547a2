"""What a program does: runs that go on where they were stopped, and their numbers as rows."""

import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from deadreckon.bench.identity import problem_identity, revisions_of
from deadreckon.bench.jobs import Job, Program, agent_of, designer_of, estimator_of, log_name, study_of, turns
from deadreckon.bench.store import JobResult
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.progress import Progress, unwatched
from deadreckon.runs.holdout import trial_parts
from deadreckon.versions import cpu_model, versions


def perform(
    program: Program, folder: Path, watch: Progress = unwatched, track: Sequence[str] = ()
) -> list[JobResult]:  # fmt: skip
    """Does a program, or the rest of it.

    Args:
        program: the program.
        folder: where its run lies, or its runs.
        watch: called as it goes.
        track: names of the trackers that show its runs, of the kinds in `TRACKED`.

    Returns:
        What was found of each of its jobs.

    Raises:
        UserError: it was planned with other revisions of the code than there are here.
    """
    job, *others = program.jobs
    for each in program.jobs:
        if (here := revisions_of(each)) != each.revisions:
            planned = f"{each.method} on {each.on} was planned at revisions {each.revisions}, where it would run are {here}"
            raise UserError(f"{planned}; install the same package there, or run the command again")
    spent = _Spent(folder.with_name(f"{folder.name}.seconds"))

    def noted(done: int, total: int | None) -> None:
        spent.keep()
        watch(done, total)

    if others:
        results = _learn_together(program, folder, noted, track)
    elif job.kind in TRACKED:
        results = [TRACKED[job.kind](job, folder, noted, track)]
    else:
        results = [_PERFORM[job.kind](job, folder, noted)]
    spent.keep()
    for row in (row for found in results for row in found.rows):
        row["seconds"] = spent.seconds
        row["versions"] = json.dumps(row.get("versions", versions()) | {"cpu": cpu_model()})
    return results


class _Kept(TypedDict):
    """What is kept of it in a file."""

    seconds: float


class _Spent:
    """Seconds that a program has taken so far, kept in a file beside its folder, so that those before a kill count.

    The file stays: results may be lost with the process that has to write them, when the runs behind them are done.
    """

    def __init__(self, path: Path):
        import jax

        # Of the processor, which does not count what others take or a pause; one that waits for a GPU is not at work.
        self.clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter
        self.path, self.began = path, self.clock()
        self.before = read_json(path, _Kept)["seconds"] if path.exists() else 0.0

    @property
    def seconds(self) -> float:
        return self.before + self.clock() - self.began

    def keep(self) -> None:
        write_json(self.path, {"seconds": self.seconds})


def source(job: Job) -> Path | str:
    """Where the job's log is read from; one with a recipe is collected first, by one process while the others wait."""
    from deadreckon.collect.recipes import collect, recipe_names

    name = log_name(job)
    return collect(name, steps=job.rows, wait=True) if name in recipe_names() else name


def _log(job: Job) -> Any:
    from deadreckon.collect.recipes import recipe_names
    from deadreckon.data.catalogue import load

    log, name = load(source(job)), log_name(job)
    # The plan may be from another machine.
    if name not in recipe_names() and not job.data.endswith(f"{log.name} {log.fingerprint}"):
        raise UserError(f"{name} is not the log that was planned with: {job.data} there, {log.fingerprint} here")
    return trial_parts(log)[0] if job.options.get("divided") else log


def _learn(job: Job, folder: Path, watch: Progress, track: Sequence[str]) -> JobResult:
    from deadreckon.runs.train import train

    return _result(job, train(agent_of(job), _log(job), out=folder, **_options(job, watch, track)))


def _learn_together(program: Program, folder: Path, watch: Progress, track: Sequence[str]) -> list[JobResult]:
    from deadreckon.runs.train import train_together

    first = program.jobs[0]
    agents = {job.name: agent_of(job) for job in program.jobs}
    logs = {data: _log(job) for data, job in {job.data: job for job in program.jobs}.items()}
    options = _options(first, watch, track)
    runs = train_together(agents, {job.name: logs[job.data] for job in program.jobs}, out=folder, **options)
    return [_result(job, runs[job.name]) for job in program.jobs]


def _options(job: Job, watch: Progress, track: Sequence[str]) -> dict[str, Any]:
    """Options of a run on a log."""
    every = job.options["every"]
    return {
        "steps": job.options["steps"], "seeds": len(job.seeds), "seed": job.seeds[0], "evaluate_every": every,
        "episodes": job.options["episodes"], "chunk": min(1000, every), "resume": True,
        "holdout": 0, "history": job.options.get("history", 1), "encoder": job.options.get("encoder", "patches"),
        "shift": job.options.get("shift"), "track": track,
        "watch": lambda progress, steps: watch(progress.step, steps),
    }  # fmt: skip


def _online(job: Job, folder: Path, watch: Progress, track: Sequence[str]) -> JobResult:
    from deadreckon.runs.online import train_online
    from deadreckon.runs.train import train

    options, told = job.options, lambda progress, steps: watch(progress.step, steps)
    agent, data, start = agent_of(job), None, None
    seeds: dict[str, Any] = {"seeds": len(job.seeds), "seed": job.seeds[0]}
    if log := options.get("log"):
        data = _log(job)
        if log["use"] == "first":
            before = folder.with_name(f"{folder.name}-offline")
            often = {"evaluate_every": log["offline"], "episodes": options["episodes"], "resume": True, "holdout": 0}
            start = train(agent, data, steps=log["offline"], task=job.on, out=before, watch=told, track=track, **seeds, **often)
            agent = None
    run = train_online(
        agent, job.on, steps=options["steps"], out=folder, settings=turns(job), evaluate_every=options["every"],
        episodes=options["episodes"], resume=True, start=start, data=data, watch=told,
        track=track, **seeds,
    )  # fmt: skip
    return _result(job, run)


def _result(job: Job, run: Any) -> JobResult:
    """Rows and curves of a run: means over the episodes of its evaluations, and what else its last one and last chunk say."""
    table = {name: np.asarray(column) for name, column in run.evaluations.to_pydict().items()}
    metrics = {name: np.asarray(column) for name, column in run.metrics.to_pydict().items()}
    scored = "score" in table  # where no reference is known there are returns alone
    step, seed = table["step"], table["seed"]
    rows, curves = [], []
    for number, failure in zip(run.seeds, run.failures):
        own = seed == number
        for at in np.unique(step[own]):
            here = own & (step == at)
            score, raw = (table[name][here] if name in table else np.array([np.nan]) for name in ("score", "return"))
            spread = float(score.std(ddof=1)) if len(score) > 1 else None
            point = {"step": int(at), "score": float(score.mean()), "raw": float(raw.mean())}
            curves.append({"cell": job.cell(number), "spread": spread} | point)
        first, last = curves[-len(np.unique(step[own]))], curves[-1]
        final = own & (step == last["step"])
        more = _last(metrics, metrics["seed"] == number) | {
            name: float(column[final].mean()) for name, column in table.items() if name not in ("step", "seed", "episode")
        }
        if job.kind == "online":  # of the policy that it began with, and the lowest since; returns where there are no scores
            told = "score" if scored else "raw"
            more["start"], more["gain"] = first[told], last[told] - first[told]
            more["lowest"] = min(point[told] for point in curves if point["cell"] == last["cell"])
        if {"estimated_value", "discounted_return"} <= set(more):
            more["overestimate"] = more["estimated_value"] - more["discounted_return"]
        steps = last["step"] if failure and job.kind == "learn" else job.options["steps"]
        rows.append(
            {
                "seed": number, "score": last["score"], "raw": last["raw"], "steps": steps,
                "more": json.dumps({name: value for name, value in more.items() if math.isfinite(value)}),
                "episodes": [float(score) for score in table["score"][final]] if scored else [],
                "log": run.config["data"]["fingerprint"],
                "failure": "" if failure is None else f"{failure.metric} was not finite at update {failure.step}",
                "versions": run.config["versions"],
            }
        )  # fmt: skip
    return JobResult(rows, curves)


def _last(metrics: dict[str, np.ndarray], own: np.ndarray) -> dict[str, float]:
    """Of the last chunk of a seed whose metrics were sound, its metrics by name."""
    names = [name for name in metrics if name not in ("step", "seed")]
    sound = own & np.all([np.isfinite(metrics[name].astype(float)) for name in names], axis=0) if names else own
    return {name: float(metrics[name][sound][-1]) for name in names} if sound.any() else {}


def _design(job: Job, folder: Path, watch: Progress) -> JobResult:
    from deadreckon.mbo import PROBLEMS, problem
    from deadreckon.mbo.protocol import evaluate_designers

    told = lambda what, step, steps: watch(step, steps)  # noqa: E731
    posed, file = problem(job.on), PROBLEMS[job.on].file
    here = problem_identity(job.on, file)
    if job.data not in (job.on, here):  # a plan that was made without the file takes any
        raise UserError(f"{file} is not the file that was planned with: {job.data} there, {here} here")
    [result] = evaluate_designers(
        posed, [(job.method, designer_of(job))], job.options["designs"], seeds=list(job.seeds), out=folder, watch=told
    )
    rows = []
    for i, seed in enumerate(job.seeds):
        scores = result.scores(i)
        median, raw = (float(scores.percentile(50, scaled)) for scaled in (True, False))
        more = {"median": 100.0 * median, "median_raw": raw, "oracle": result.about}
        rows.append(
            {
                "seed": seed, "score": 100.0 * float(scores.percentile(100, True)), "raw": float(scores.percentile(100, False)),
                "more": json.dumps(more), "steps": 0, "failure": "",
            }
        )  # fmt: skip
    return JobResult(rows, [])


def _ope(job: Job, folder: Path, watch: Progress) -> JobResult:
    from deadreckon.ope.dope import METRICS, evaluate_log, to_json
    from deadreckon.tasks.registry import of_log

    log, task = _log(job), of_log(job.on)
    assert task is not None  # the plan has refused it
    # Estimators of one log share fits, such as the behaviour model: whoever comes first makes them.
    shared, rows = folder.parent / "ope", []
    told = lambda what, step, steps: watch(step, steps)  # noqa: E731
    for seed in job.seeds:
        [result] = evaluate_log(log, task.name, [estimator_of(job)], seed=seed, out=shared, watch=told)
        sound = bool(np.isfinite(result.estimates).all())
        found = {name: getattr(result.metrics(), name).value if sound else None for name in METRICS}
        rows.append(
            {
                "seed": seed, "score": found["rank_correlation"] if sound else math.nan, "raw": None, "steps": 0,
                "log": log.fingerprint,
                "more": json.dumps(found | {"result": to_json(result)}),
                "failure": "" if sound else _told(result.warnings),
            }
        )  # fmt: skip
    return JobResult(rows, [])


def _told(warnings: Sequence[str]) -> str:
    """Why estimates failed: first which are not finite, then what else was noticed."""
    return "; ".join(sorted(warnings, key=lambda line: not line.startswith("no finite"))) or "its estimates are not finite"


def _study(job: Job, folder: Path, watch: Progress) -> JobResult:
    rows = []
    for done, seed in enumerate(job.seeds):
        watch(done, len(job.seeds))
        numbers = _numbers(job, study_of(job)(job.on, seed=seed, **job.settings))
        bad = [name for name, value in numbers.items() if not math.isfinite(value)]
        rows.append(
            {
                "seed": seed, "score": numbers.get("score", math.nan), "raw": None, "steps": 0, "more": json.dumps(numbers),
                "failure": f"{bad[0]} is not finite" if bad else "",
            }
        )  # fmt: skip
    return JobResult(rows, [])


def _numbers(job: Job, returned: Any) -> dict[str, float]:
    """What a study returned.

    Raises:
        UserError: it is no dictionary of numbers.
    """
    if not isinstance(returned, Mapping):
        raise UserError(f"{job.agent} must return numbers by name, such as {{'error': 0.5}}, got {returned!r:.80}")
    for name, value in returned.items():
        number = np.asarray(value)
        if not isinstance(name, str) or number.ndim or number.dtype.kind not in "biuf":
            raise UserError(f"{job.agent} must return numbers by name; {name!r} is {value!r:.80}")
    return {name: float(value) for name, value in returned.items()}


_PERFORM = {"design": _design, "ope": _ope, "study": _study}
TRACKED = {"learn": _learn, "online": _online}  # kinds of jobs that have runs, which trackers can show
