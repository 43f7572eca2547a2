"""A suite as cells, each with a name made of its content, as jobs, which are cells of one run, and as programs of such jobs.

A cell is one method on one log, task or problem with one seed. Its name depends on all that its numbers depend on: the code
of the methods, every setting, the data, the seed. Which cells share a job or a program depends on where they run.
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from deadreckon.bench.suite import Method, Suite
from deadreckon.errors import UserError, unknown
from deadreckon.files import digest, home
from deadreckon.training.field_names import with_field_names

# Parts of the package that no number depends on.
UNUSED = (
    "cli", "report", "bench/published", "bench/suites", "bench/tables.py", "bench/times.py",
    "bench/tune.py", "stats/scores.py", "runs/recommend.py", "runs/attempt.py", "runs/durations.py", "agents/spaces.json",
)  # fmt: skip
MOST = 64  # lanes of a program where nobody says how many: no more were measured (benchmarks/lanes.py)
SOURCES = (".py", ".json", ".xml", ".npz", ".csv")  # policies that make logs among them


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
        asked: what else decides the numbers: steps, episodes, ...
        seeds: one cell each.
        rows: of a log that is collected; None: all. `data` tells it too.
        program: number of the program in its plan that it is a part of; None: of its own.
    """

    kind: str
    method: str
    agent: str
    settings: dict[str, Any]
    preset: str
    on: str
    data: str
    asked: dict[str, Any]
    seeds: tuple[int, ...]
    rows: int | None = None
    program: int | None = None

    def cell(self, seed: int, with_code: bool = True) -> str:
        """The name of the cell with that seed; without the code it is the same for all versions of the methods."""
        content = [self.kind, self.agent, self.settings, self.data, self.asked, seed]
        return digest([*content, code()] if with_code else content, 10)

    @property
    def cells(self) -> list[str]:
        """Of all seeds."""
        return [self.cell(seed) for seed in self.seeds]

    @property
    def name(self) -> str:
        """Of the job's files: the method, where, and what tells its cells from others."""
        return f"{file_name(f'{self.method}-{self.on}')}-{digest(self.cells, 10)}"


@dataclass(frozen=True)
class Program:
    """Jobs of the same seeds that differ in float settings alone, which share a compiled program; often it is one job."""

    jobs: tuple[Job, ...]

    @property
    def name(self) -> str:
        """Of its folder; of a single job its own."""
        first, *others = self.jobs
        if not others:
            return first.name
        return f"{file_name(f'{first.agent}-{first.on}')}-{digest([job.name for job in self.jobs], 10)}"

    @property
    def lanes(self) -> int:
        """Cells."""
        return sum(len(job.seeds) for job in self.jobs)

    def run(self, job: Job) -> str:
        """Where in the folder of all runs that of a job lies."""
        return job.name if job.name == self.name else f"{self.name}/{job.name}"

    def __str__(self) -> str:
        job, others = self.jobs[0], len(self.jobs) - 1
        first, last = job.seeds[0], job.seeds[-1]
        more = f" and {others} other setting{'s' * (others > 1)} of {job.agent}" if others else ""
        return f"{job.method}{more} on {job.on}, seed{f's {first} to {last}' if last > first else f' {first}'}"


def programs(jobs: Sequence[Job]) -> list[Program]:
    """The programs of jobs of one plan; those of which some seeds are done already are programs of their own."""
    found: dict[Any, list[Job]] = {}
    for job in jobs:
        found.setdefault(job.name if job.program is None else (job.program, job.seeds), []).append(job)
    return [Program(tuple(members)) for members in found.values()]


def file_name(text: str) -> str:
    """A name as a part of a file's."""
    return "".join(c if c.isalnum() or c in "-+." else "_" for c in text)[:80].lstrip(".")


@cache
def code() -> str:
    """Tells versions of the package's methods apart: a digest of all source files that numbers depend on."""
    found = hashlib.blake2b(digest_size=8)
    root = files("deadreckon")
    for name, content in sorted(_sources(root, "")):
        found.update(name.encode() + b"\0" + content + b"\0")
    return found.hexdigest()


def _sources(folder: Any, prefix: str) -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        name = f"{prefix}{entry.name}"
        if entry.is_dir():
            if entry.name != "__pycache__" and name not in UNUSED:
                yield from _sources(entry, f"{name}/")
        elif entry.name.endswith(SOURCES) and name not in UNUSED:
            yield name, entry.read_bytes()


def plan(suite: Suite, lanes: int | None = None) -> list[Job]:
    """All jobs of a suite, in the order of its methods on each of what it is run on.

    Args:
        suite: the suite.
        lanes: cells of one program at most, where the suite does not say; None: as many as there are, up to `MOST`.

    Raises:
        UserError: an unknown method, log, task or problem, or a setting that a method does not have.
    """
    describe = {"learn": _learn, "online": _online, "design": _design, "ope": _ope}[suite.kind]
    together, jobs = suite.lanes or lanes or MOST, []
    for on in suite.on:
        for method in suite.methods:
            one = describe(suite, method, on)
            for first in range(0, suite.seeds, together):
                jobs.append(dataclasses.replace(one, seeds=tuple(range(first, min(first + together, suite.seeds)))))
    return _packed(jobs, together)


def _packed(jobs: Sequence[Job], lanes: int) -> list[Job]:
    """The jobs, each with the number of the program that it shares with those before it, as long as there is room."""
    out, room = [], {}
    for i, job in enumerate(jobs):
        key = _shape(job) if len(job.seeds) < lanes else None
        program, left = room.get(key, (i, 0))
        if left < len(job.seeds):
            program, left = i, lanes
        if key is not None:
            room[key] = program, left - len(job.seeds)
        out.append(dataclasses.replace(job, program=program))
    return out


def _shape(job: Job) -> str | None:
    """What jobs of one program have in common; None of a job that shares none.

    Online only seeds are lanes: experience is made with the settings of one agent.
    """
    if job.kind != "learn":
        return None
    from deadreckon.training.hyperparameters import check_fields

    agent = agent_of(job)
    try:
        check_fields(agent)
    except UserError:
        return None
    # A number left to the agent (None) may leave a term out, so it is not the same program as one that is given.
    given = [(f, job.settings[f.name]) for f in dataclasses.fields(agent)]
    fixed = {f.name: value for f, value in given if f.metadata.get("static") or value is None}
    return json.dumps([job.agent, fixed, job.on, job.data, job.asked, job.seeds])


def agent_of(job: Job) -> Any:
    """The agent of a job, as its settings say."""
    from deadreckon.agents import agent_class

    return agent_class(job.agent)(**{name: _tuples(value) for name, value in job.settings.items()})


def _tuples(value: Any) -> Any:
    """JSON knows lists alone; fields hold tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _fields(made: Any) -> dict[str, Any]:
    found = json.loads(json.dumps({f.name: getattr(made, f.name) for f in dataclasses.fields(made)}))
    # Fields that are not static are numbers, and 1 is 1.0 there: the same cell.
    numbers = [f.name for f in dataclasses.fields(made) if not f.metadata.get("static") and found[f.name] is not None]
    return found | {name: float(found[name]) for name in numbers if isinstance(found[name], int)}


_WAYS = {"learn": "from a log", "online": "online"}


def _agent(suite: Suite, method: Method, on: str) -> tuple[dict[str, Any], str]:
    """All settings of a method's agent, and the preset that they began from."""
    from deadreckon.agents import agent_class, preset, preset_for

    kind = agent_class(method.agent)
    if not (kind.online if suite.kind == "online" else kind.offline):
        raise UserError(f"{suite.name}, method {method.name!r}: {method.agent} does not learn {_WAYS[suite.kind]}")
    known = {f.name for f in dataclasses.fields(kind)}
    asked = with_field_names(kind, method.fields)
    for name in asked:
        if name not in known:
            raise UserError(f"{suite.name}, method {method.name!r}: {unknown(f'field of {method.agent}', name, known)}")
    published = preset_for(method.agent, on) if method.preset else None
    given = {name: _tuples(value) for name, value in asked.items()}
    return _fields(kind(**(preset(method.agent, published) if published else {}) | given)), published or ""


def _learn(suite: Suite, method: Method, on: str) -> Job:
    settings, published = _agent(suite, method, on)
    data = log_identity(on, suite.rows)
    return Job("learn", method.name, method.agent, settings, published, on, data, _run(suite, on), (0,), suite.rows)


def _run(suite: Suite, on: str) -> dict[str, Any]:
    from deadreckon.tasks.registry import of_log

    steps = suite.steps[on]
    asked = {"steps": steps, "episodes": suite.episodes, "every": steps // suite.evaluations}
    # Only where it says something: names of cells depend on it.
    return asked | {"divided": True} if suite.divided and of_log(on) is None else asked


@cache
def log_identity(name: str, rows: int | None) -> str:
    """What tells a log from others: the name under which it is collected, or the fingerprint of a file."""
    from deadreckon.collect.recipes import collected_name, recipe, recipe_names

    if name in recipe_names():
        return collected_name(recipe(name), rows, 0)
    from deadreckon.data.catalogue import load

    if rows is not None:
        raise UserError(f"rows = {rows}: of {name}, which is no recipe, all rows are taken")
    log = load(name)
    return f"{log.name} {log.fingerprint}"


def _online(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.tasks.registry import task

    settings, published = _agent(suite, method, on)
    job = Job("online", method.name, method.agent, settings, published, on, task(on).name, _run(suite, on), (0,))
    turns(job).updates(suite.steps[on])  # refuses what is too short
    return job


def turns(job: Job) -> Any:
    """How acting and learning take turns in an online job."""
    from deadreckon.online import Online

    return Online(**type(agent_of(job)).acting(job.on))


def _design(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.mbo import PROBLEMS

    if on not in PROBLEMS:
        raise unknown("problem", on, PROBLEMS)
    asked = {"designs": suite.designs, "budget": suite.budget, "fields": method.fields}
    job = Job("design", method.name, method.agent, {}, "", on, _problem_identity(on, PROBLEMS[on].file), asked, (0,))
    made = designer_of(job)
    settings = json.loads(json.dumps({f.name: getattr(made, f.name) for f in dataclasses.fields(made)}, default=repr))
    return dataclasses.replace(job, settings=settings)


def designer_of(job: Job) -> Any:
    """The designer of a job, as its suite says."""
    from deadreckon.mbo.registry import sized

    changes = {name: _tuples(value) for name, value in job.asked["fields"].items()}
    return sized(job.agent, job.on, job.asked["budget"], **changes)


def _ope(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.policies.library import library
    from deadreckon.tasks.registry import of_log

    task = of_log(on)
    if task is None:
        raise UserError(f"{on} is of no task, so nobody knows what policies are worth there")
    library(task.name)  # refuses a task without policies of known value
    asked = {"budget": suite.budget, "fields": method.fields}
    job = Job("ope", method.name, method.agent, {}, "", on, log_identity(on, suite.rows), asked, (0,), suite.rows)
    return dataclasses.replace(job, settings={"estimator": str(estimator_of(job))})


def estimator_of(job: Job) -> Any:
    """The estimator of a job, as its suite says."""
    from deadreckon.ope.registry import CPU_BUDGET, estimator

    changes = {name: _tuples(value) for name, value in job.asked["fields"].items()}
    changes = with_field_names(type(estimator(job.agent)), changes)
    return estimator(job.agent, **(CPU_BUDGET.get(job.agent, {}) if job.asked["budget"] == "cpu" else {}) | changes)


@cache
def _problem_identity(name: str, file: str | None) -> str:
    """A problem's name, and what tells its file from others, where it has one."""
    path = None if file is None else home() / "designs" / file
    if path is None or not path.is_file():
        return name
    return f"{name} {hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()}"
