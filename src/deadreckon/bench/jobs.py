"""Jobs, which are cells of one run, programs of such jobs, and the methods that jobs name."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, cast

from deadreckon.errors import UserError
from deadreckon.files import digest
from deadreckon.imports import imported
from deadreckon.names import file_part


@dataclass(frozen=True)
class Job:
    """Cells that differ in their seed alone: one run.

    Attributes:
        kind: of the suite.
        method: its name in tables.
        agent: name of the agent or designer.
        settings: all its fields.
        preset: name of the published settings that it began from, or "".
        on: name of the log, task or problem.
        data: what tells the data from other data: a log's own name, or the fingerprint of a file.
        options: what else decides the numbers: steps, episodes, ...
        seeds: one cell each.
        rows: of a log that is collected; None: all. `data` tells it too.
        revisions: of all code that decides the numbers; see `identity.revisions_of`.
        program: number of the program in its plan that it is a part of; None: of its own.
        suite: name of the suite that asks for it, which is no part of a cell's name.
    """

    kind: str
    method: str
    agent: str
    settings: dict[str, Any]
    preset: str
    on: str
    data: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    rows: int | None = None
    revisions: dict[str, Any] = field(default_factory=dict)
    program: int | None = None
    suite: str = ""

    def cell(self, seed: int) -> str:
        """The name of the cell with that seed, at the revisions of the present code."""
        return digest([*self._content(seed), self.revisions], 10)

    def content(self, seed: int) -> str:
        """The same whatever the revisions, and in whatever order settings and options are written."""
        return digest(self._content(seed), 10, sort_keys=True)

    def _content(self, seed: int) -> list[Any]:
        return [self.kind, self.agent, self.settings, self.data, self.options, seed]

    @cached_property
    def cells(self) -> list[str]:
        """Of all seeds."""
        return [self.cell(seed) for seed in self.seeds]

    @cached_property
    def name(self) -> str:
        """Of the job's files: the method, where, and what tells its cells from others."""
        return f"{file_name(f'{self.method}-{self.on}')}-{digest(self.cells, 10)}"


def job_of(row: Mapping[str, Any], settings: dict[str, Any], options: dict[str, Any]) -> Job:
    """The job of a row of results, of its one seed, with these settings and options; without revisions."""
    names = ("kind", "method", "agent", "preset", "on", "data")
    return Job(**{name: row[name] for name in names}, settings=settings, options=options, seeds=(row["seed"],))


@dataclass(frozen=True)
class Program:
    """Jobs of the same seeds that share a compiled program, as they differ in float settings, or in logs of one shape, alone;
    often it is one job."""

    jobs: tuple[Job, ...]

    @property
    def name(self) -> str:
        """Of its folder; of a single job its own."""
        first, *others = self.jobs
        if not others:
            return first.name
        return f"{file_name(f'{first.agent}-{self._where}')}-{digest([job.name for job in self.jobs], 10)}"

    @property
    def _where(self) -> str:
        logs = len({job.data for job in self.jobs})
        return self.jobs[0].on if logs == 1 else f"{logs} logs"

    @property
    def parts(self) -> "list[Program]":
        """What is tried alone where the program fails: its jobs; of a single one its seeds, if one that diverges is an error of
        all, as in designs and in what goes on from runs on logs."""
        if len(self.jobs) > 1:
            return [Program((job,)) for job in self.jobs]
        alone = [job for job in self.jobs if job.kind == "design" or "log" in job.options]
        return [Program((dataclasses.replace(job, seeds=(seed,)),)) for job in alone for seed in job.seeds]

    @property
    def lanes(self) -> int:
        """Cells."""
        return sum(len(job.seeds) for job in self.jobs)

    def run(self, job: Job) -> str:
        """Where in the folder of all runs that of a job lies."""
        return job.name if job.name == self.name else f"{self.name}/{job.name}"

    def __str__(self) -> str:
        job, settings = self.jobs[0], {(job.method, json.dumps(job.settings)) for job in self.jobs}
        others = len(settings) - 1
        first, last = job.seeds[0], job.seeds[-1]
        more = f" and {others} other setting{'s' * (others > 1)} of {job.agent}" if others else ""
        return f"{job.method}{more} on {self._where}, seed{f's {first} to {last}' if last > first else f' {first}'}"


def programs(jobs: Sequence[Job]) -> list[Program]:
    """The programs of jobs of one plan; those of which some seeds are done already are programs of their own."""
    found: dict[Any, list[Job]] = {}
    for job in jobs:
        found.setdefault(job.name if job.program is None else (job.program, job.seeds), []).append(job)
    return [Program(tuple(members)) for members in found.values()]


def file_name(text: str) -> str:
    """A name as a part of a file's: letters, digits and a few signs, 80 bytes at most, none of which hides the file."""
    return file_part("".join(c if c.isalnum() or c in "-+." else "_" for c in text).lstrip("."), 80)


# ---- methods of jobs -----------------------------------------------------------------------------------------------


def agent_of(job: Job) -> Any:
    """The agent of a job, as its settings say."""
    from deadreckon.agents import agent_class

    return agent_class(job.agent)(**{name: tuples(value) for name, value in job.settings.items()})


def tuples(value: Any) -> Any:
    """JSON knows lists alone; fields hold tuples."""
    return tuple(map(tuples, value)) if isinstance(value, list) else value


def turns(job: Job) -> Any:
    """How acting and learning take turns in an online job."""
    from deadreckon.agents import agent_class
    from deadreckon.runs.online import turns_of

    started = job.options.get("log", {}).get("use") == "first"
    return turns_of(agent_class(job.agent), job.on, started, **job.options.get("acting", {}))


def curve_end(job: Job) -> int:
    """The update at which the learning curve of a job ends; online it counts those of acting alone."""
    return job.options["steps"] if job.kind == "learn" else turns(job).updates(job.options["steps"])


def updates(job: Job) -> int:
    """In the whole of a job that learns, those on a log before it acts included."""
    return curve_end(job) + job.options.get("log", {}).get("offline", 0)


def log_name(job: Job) -> str:
    """The log of a job: what it is run on, or that of its task."""
    return job.options["log"]["name"] if "log" in job.options else job.on


def designer_of(job: Job) -> Any:
    """The designer of a job, as its suite says."""
    from deadreckon.mbo.registry import sized

    changes = {name: tuples(value) for name, value in job.options["fields"].items()}
    return sized(job.agent, job.on, job.options["budget"], **changes)


def study_of(job: Job) -> Callable[..., dict[str, float]]:
    """The function of a job of kind `study`.

    Raises:
        UserError: there is none.
    """
    study = imported(job.agent, "study", "function")
    if not callable(study):
        raise UserError(f"study {job.agent} is no function; a study of your own is named module:function")
    return cast(Callable[..., dict[str, float]], study)


@cache
def estimator_class(name: str) -> type:
    """That of an estimator of the package by its name.

    Raises:
        UserError: there is none of that name.
    """
    from deadreckon.ope.registry import estimator

    return type(estimator(name))


def estimator_of(job: Job) -> Any:
    """The estimator of a job, as its suite says."""
    from deadreckon.ope.registry import CPU_BUDGET, estimator

    changes = {name: tuples(value) for name, value in job.options["fields"].items()}
    return estimator(job.agent, **(CPU_BUDGET.get(job.agent, {}) if job.options["budget"] == "cpu" else {}) | changes)
