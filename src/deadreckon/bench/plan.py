"""A suite as jobs, each with the number of the program that it shares with others.

A cell is one method on one log, task or problem with one seed; a job is cells of one run (`jobs.py`). What tells a cell from
others is in `identity.py`. Which cells share a job or a program depends on where they run.
"""

import dataclasses
import inspect
import json
from collections.abc import Sequence
from typing import Any

from deadreckon.bench.identity import log_identity, problem_identity, revisions_of
from deadreckon.bench.jobs import Job, agent_of, designer_of, estimator_class, estimator_of, study_of, tuples, turns
from deadreckon.bench.suite import Method, Suite
from deadreckon.errors import UserError, unknown
from deadreckon.imports import trusted
from deadreckon.training.field_names import with_field_names
from deadreckon.training.later_fields import told

MOST = 64  # lanes of a program where nobody says how many: no more were measured (benchmarks/lanes.py)


def plan(suite: Suite, lanes: int | None = None) -> list[Job]:
    """All jobs of a suite, in the order of its methods on each of what it is run on.

    Args:
        suite: the suite.
        lanes: cells of one program at most, where the suite does not say; None: as many as there are, up to `MOST`.

    Raises:
        UserError: an unknown method, log, task or problem, a setting that a method does not have, or a value that it does not
            take.
    """
    return _packed(_jobs(suite, lanes), _together(suite, lanes))


def _together(suite: Suite, lanes: int | None) -> int:
    """Cells of one program at most. Seeds of a study are called one after the other: a job of several would only lose them
    together."""
    return 1 if suite.kind == "study" else suite.lanes or lanes or MOST


def _jobs(suite: Suite, lanes: int | None) -> list[Job]:
    """All jobs of a suite, each a program of its own."""
    describe = {"learn": _learn, "online": _online, "design": _design, "ope": _ope, "study": _study}[suite.kind]
    together, jobs = _together(suite, lanes), []
    for on in suite.on:
        for method in suite.methods:
            try:
                one = describe(suite, method, on)
            except UserError as error:
                if str(error).startswith(f"{suite.name}, "):
                    raise
                raise UserError(f"{suite.name}, method {method.name!r} on {on}: {error}") from error
            one = dataclasses.replace(one, revisions=revisions_of(one), suite=suite.name)
            seeds = range(suite.first_seed, suite.first_seed + suite.seeds)
            for first in range(0, suite.seeds, together):
                jobs.append(dataclasses.replace(one, seeds=tuple(seeds[first : first + together])))
    return jobs


def plan_all(suites: Sequence[Suite], lanes: int | None = None) -> list[Job]:
    """All jobs of suites that are run together, one suite after the other; see `plan`."""
    jobs: list[Job] = []
    for suite in suites:
        first = len(jobs)  # numbers of programs are those of one plan
        jobs += [dataclasses.replace(job, program=first + (job.program or 0)) for job in plan(suite, lanes)]
    return jobs


def plan_across(suites: Sequence[Suite], lanes: int = MOST) -> list[Job]:
    """All jobs of suites of kind `learn`, of which those on logs of one shape share programs, whatever their suite.

    A job that several suites have, with the same seeds, is one of the first: it would be left out of programs in which it had
    taken lanes from others.

    Args:
        suites: that are run together; what they say of lanes does not count.
        lanes: cells of one program at most.
    """
    first: dict[tuple[str, ...], Job] = {}
    for suite in suites:
        for job in _jobs(dataclasses.replace(suite, lanes=lanes), lanes):
            first.setdefault(tuple(job.cells), job)
    return _packed(list(first.values()), lanes, True)


def _packed(jobs: Sequence[Job], lanes: int, across: bool = False) -> list[Job]:
    """The jobs, each with the number of the program that it shares with those before it, as long as there is room.

    Args:
        jobs: of one plan.
        lanes: cells of one program at most.
        across: whether jobs on different logs may share one.
    """
    out, room = [], {}
    for i, job in enumerate(jobs):
        key = _shape(job, across) if len(job.seeds) < lanes else None
        program, left = room.get(key, (i, 0))
        if left < len(job.seeds):
            program, left = i, lanes
        if key is not None:
            room[key] = program, left - len(job.seeds)
        out.append(dataclasses.replace(job, program=program))
    return out


def _shape(job: Job, across: bool) -> str | None:
    """What jobs of one program have in common; None of a job that shares none.

    With `across` that is not their log but its shape, which is known of logs of tasks before they are read.

    Online only seeds are lanes: experience is made with the settings of one agent.
    """
    if job.kind != "learn":
        return None
    agent = agent_of(job)
    # A number left to the agent (None) may leave a term out, so it is not the same program as one that is given.
    given = [(f, job.settings[f.name]) for f in told(agent)]
    fixed = {f.name: value for f, value in given if f.metadata.get("static") or value is None}
    log, gamma = _log_shape(agent, job)
    return json.dumps([job.agent, fixed, (across and log) or [job.on, job.data], gamma, job.options, job.seeds])


def _log_shape(agent: Any, job: Job) -> tuple[list[Any] | None, float | None]:
    """Sizes of observations and actions of a job's log, and for agents whose model ends episodes by a rule also which rule;
    None where it shares a program with no other log's. Also the discount of its batches, which all lanes share."""
    from deadreckon.agents import AGENTS
    from deadreckon.data.spec import Box, Spec
    from deadreckon.data.terminations import of_log as rule_of
    from deadreckon.tasks.registry import of_log

    task = of_log(job.on)
    if task is None and job.agent not in AGENTS:  # batches of a user's own agent may depend on the log in any way
        return None, getattr(agent, "discount", None)
    if task is None:
        return None, agent.needs(Spec.empty((1,), Box((-1.0,), (1.0,)), "any")).gamma
    needs = agent.needs(Spec.empty(task.observation_shape, task.action_space, "any"))
    if agent.one_log or needs.initial:
        return None, needs.gamma
    rule = rule_of(job.on) if getattr(agent, "termination", "") is None else None
    return [*task.observation_shape, repr(task.action_space), None if rule is None else rule.name], needs.gamma


def _fields(made: Any) -> dict[str, Any]:
    found = json.loads(json.dumps({f.name: getattr(made, f.name) for f in told(made)}))
    # Fields that are not static are numbers, and 1 is 1.0 there: the same cell.
    numbers = [f.name for f in told(made) if not f.metadata.get("static") and found[f.name] is not None]
    return found | {name: float(found[name]) for name in numbers if isinstance(found[name], int)}


def _stranger(suite: Suite, method: Method) -> UserError:
    module = method.agent.partition(":")[0]
    where = f"{suite.name}, method {method.name!r}"
    python = f"in Python deadreckon.imports.trust({module!r})"
    return UserError(f"{where}: {method.agent} is code that is not part of deadreckon; --trust {module} lets it run, {python}")


_WAYS = {"learn": "on a log", "online": "online"}


def _agent(suite: Suite, method: Method, on: str) -> tuple[dict[str, Any], str]:
    """All settings of a method's agent, and the preset that they began from."""
    from deadreckon.agents import agent_class, known_agent, preset, preset_for
    from deadreckon.training.hyperparameters import check_fields

    if not known_agent(method.agent):
        raise _stranger(suite, method)
    kind = agent_class(method.agent)
    if method.log:
        able = kind.fine_tunes and (kind.offline or method.log == "beside")
    else:
        able = kind.online if suite.kind == "online" else kind.offline
    if not able:
        raise UserError(f"{suite.name}, method {method.name!r}: {method.agent} cannot be trained {_WAYS[suite.kind]}")
    known = {f.name for f in dataclasses.fields(kind)}
    options = with_field_names(kind, method.fields)
    for name in options:
        if name not in known:
            raise UserError(f"{suite.name}, method {method.name!r}: {unknown(f'field of {method.agent}', name, known)}")
    published = preset_for(method.agent, on) if method.preset else None
    given = {name: tuples(value) for name, value in options.items()}
    made = kind(**(preset(method.agent, published) if published else {}) | given)
    check_fields(made)  # before any job is run, of which each would fail
    return _fields(made), published or ""


def _learn(suite: Suite, method: Method, on: str) -> Job:
    settings, published = _agent(suite, method, on)
    data, options = log_identity(on, suite.rows), _run(suite, on)
    if method.history > 1:  # cells without histories keep their names
        options["history"] = method.history
    if method.encoder:
        options["encoder"] = method.encoder
    if method.shift is not None:
        options["shift"] = method.shift
    return Job("learn", method.name, method.agent, settings, published, on, data, options, (0,), suite.rows)


def _run(suite: Suite, on: str) -> dict[str, Any]:
    from deadreckon.tasks.registry import of_log

    steps = suite.steps[on]
    options = {"steps": steps, "episodes": suite.episodes, "every": steps // suite.evaluations}
    # Only where it says something: names of cells depend on it.
    return options | {"divided": True} if suite.divided and of_log(on) is None else options


def _online(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.tasks.registry import check_named, task

    module, colon, _ = on.removeprefix("gymnasium:").partition("?")[0].partition(":")
    check_named(on, f"the task of {suite.name}", f"--trust {module} lets it run" if colon else "leave that out")
    settings, published = _agent(suite, method, on)
    # Only where it says something: names of cells depend on it.
    acting = {key: float(value) if key == "updates_per_step" else value for key, value in method.acting.items()}
    options = _run(suite, on) | ({"acting": acting} if acting else {})
    data, rows = task(on).name, None
    if method.log:
        log, rows = suite.data[on], suite.rows
        options["log"] = {"name": log, "use": method.log} | ({"offline": suite.offline} if method.log == "first" else {})
        data = f"{data}, {log_identity(log, rows)}"
    job = Job("online", method.name, method.agent, settings, published, on, data, options, (0,), rows)
    turns(job).updates(suite.steps[on])  # refuses what is too short
    return job


def _design(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.mbo import PROBLEMS
    from deadreckon.mbo.registry import designer
    from deadreckon.training.hyperparameters import check_fields

    if on not in PROBLEMS:
        raise unknown("problem", on, PROBLEMS)
    fields = dict(sorted(with_field_names(type(designer(method.agent)), method.fields).items()))
    options = {"designs": suite.designs, "budget": suite.budget, "fields": fields}
    data = f"{on} {suite.files[on]}" if on in suite.files else problem_identity(on, PROBLEMS[on].file)
    job = Job("design", method.name, method.agent, {}, "", on, data, options, (0,))
    made = designer_of(job)
    check_fields(made)
    settings = json.loads(json.dumps({f.name: getattr(made, f.name) for f in dataclasses.fields(made)}, default=repr))
    return dataclasses.replace(job, settings=settings)


def _ope(suite: Suite, method: Method, on: str) -> Job:
    from deadreckon.policies.library import library
    from deadreckon.tasks.registry import of_log

    task = of_log(on)
    if task is None:
        raise UserError(f"{on} has no task, so the values of policies on it are not known")
    library(task.name)  # refuses a task without policies of known value
    fields = dict(sorted(with_field_names(estimator_class(method.agent), method.fields).items()))
    options = {"budget": suite.budget, "fields": fields}
    job = Job("ope", method.name, method.agent, {}, "", on, log_identity(on, suite.rows), options, (0,), suite.rows)
    made = estimator_of(job)
    made.check_settings()  # before any job is run, as in `_agent`
    return dataclasses.replace(job, settings={"estimator": str(made)})


def _study(suite: Suite, method: Method, on: str) -> Job:
    if not trusted(method.agent.partition(":")[0]):
        raise _stranger(suite, method)
    job = Job("study", method.name, method.agent, dict(method.fields), "", on, on, {}, (0,))
    try:
        inspect.signature(study_of(job)).bind(on, seed=0, **job.settings)
    except TypeError as error:
        raise UserError(f"{suite.name}, method {method.name!r}: {method.agent} cannot be called so: {error}") from error
    return job
