"""What tells a cell from others beside its settings and its seed: revisions of the code that decides its numbers, and its data.

Whoever changes the numbers of a method or of the protocol raises the revision that stands in that file. Source is not looked
at, so a docstring, a faster loop or a renamed variable changes no cell; that no number changes under the same revision is what
the golden tests are for (`tests/golden.py`). Versions of packages are not told here either: they stand beside each result.
"""

import hashlib
from functools import cache
from typing import Any

from deadreckon.bench.jobs import Job, agent_of, designer_of, estimator_of, study_of
from deadreckon.data.formats.flat_pictures import SHAPES
from deadreckon.errors import UserError
from deadreckon.files import home
from deadreckon.training import pictures
from deadreckon.training.revisions import of_learning, revisions


def of_evaluation(task: Any) -> dict[str, Any]:
    """Of what runs a policy in a task, and of the task."""
    from deadreckon.runs import evaluate

    return {"evaluation": evaluate.REVISION, "task": revisions(task)}


def revisions_of(job: Job) -> dict[str, Any]:
    """All that a job's numbers depend on, by what they are of."""
    return of_learning() | {"learn": _learn, "online": _online, "design": _design, "ope": _ope, "study": _study}[job.kind](job)


def _learn(job: Job) -> dict[str, Any]:
    from deadreckon.agents import agent_class
    from deadreckon.tasks.registry import of_log

    # A file is judged in the task of the log that it holds, by whose name its data are known (`log_identity`).
    name = job.on if of_log(job.on) is not None else job.data.rpartition(" ")[0]
    task = of_log(name)
    found = {"method": revisions(agent_class(job.agent))} | ({} if task is None else of_evaluation(task))
    if (task is not None and task.observation_dtype == "uint8") or any(n.partition("@")[0] in SHAPES for n in (job.on, name)):
        found["pictures"] = pictures.REVISION
    return found


def _online(job: Job) -> dict[str, Any]:
    from deadreckon.online.experience import experience_of
    from deadreckon.tasks.registry import task

    agent = agent_of(job)
    acting = revisions(experience_of(agent, "log" in job.options))
    return {"method": revisions(type(agent)), "acting": acting} | of_evaluation(task(job.on))


def _design(job: Job) -> dict[str, Any]:
    from deadreckon.mbo import PROBLEMS, protocol

    return {"method": revisions(designer_of(job)), "problem": PROBLEMS[job.on].revision, "protocol": protocol.REVISION}


def _ope(job: Job) -> dict[str, Any]:
    from deadreckon.ope import dope

    return dope.estimator_revisions(estimator_of(job))


def _study(job: Job) -> dict[str, Any]:
    return {"study": getattr(study_of(job), "revision", 1)}


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


@cache
def problem_identity(name: str, file: str | None) -> str:
    """A problem's name, and what tells its file from others, where it has one."""
    path = None if file is None else home() / "designs" / file
    if path is None or not path.is_file():
        return name
    return f"{name} {hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()}"
