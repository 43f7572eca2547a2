"""How long programs will take, by those that are done."""

import json
import statistics
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from deadreckon.agents import known_agent
from deadreckon.bench.jobs import Job, Program, curve_end, job_of, updates
from deadreckon.bench.rates import has_work, work
from deadreckon.bench.store import Store


class Forecast(NamedTuple):
    """What a program is expected to take.

    Attributes:
        seconds: of the processor, or of an accelerator.
        close: whether programs of the same sizes on the same data are done; else it is rough.
        whole: whether it is of all that the program does; else of its updates alone, without models, rollouts and simulation.
    """

    seconds: float
    close: bool = True
    whole: bool = True


def forecast(waiting: Sequence[Program], store: Store, accelerated: bool = False) -> dict[str, Forecast | None]:
    """What each program takes by its name, or None where nothing is known.

    By the median seconds a step of programs of the same agent, the same sizes and as many lanes: of those on the same data
    where there are some, else of those on other data. Where no sizes are the same, of all of the agent in proportion to the
    work of an update (`rates.work`), if the options that are no settings, such as the budget, are the same. Where there are
    none, the updates alone are counted, by programs of the agent, or of the one that it is derived from, that learn from logs.

    Args:
        waiting: the programs.
        store: where those lie that are done.
        accelerated: whether an accelerator does them, so that times on such count, and not those of a core.
    """
    if not waiting:
        return {}
    done: dict[str, list[dict[str, Any]]] = {}
    for row in store.results().to_pylist():
        if json.loads(row["versions"]).get("device", "").startswith("cpu") == accelerated:
            continue
        done.setdefault(row["job"].partition("/")[0], []).append(row)
    like: dict[tuple[Any, ...], list[float]] = {}  # seconds a step, divided by the work of one
    for first, *others in done.values():
        settings, options = json.loads(first["settings"]), json.loads(first["asked"])
        each = first["seconds"] / _length(job_of(first, settings, options), max(row["steps"] for row in (first, *others)))
        each /= _work(first["kind"], first["agent"], settings)
        keys = _keys(first["kind"], first["agent"], 1 + len(others), first["on"], settings, options)
        for key in (*keys, (first["kind"], first["agent"], 1 + len(others))):
            like.setdefault(key, []).append(each)
    times = {key: statistics.median(found) for key, found in like.items()}
    return {program.name: _expected(program, times) for program in waiting}


def _expected(program: Program, times: Mapping[tuple[Any, ...], float]) -> Forecast | None:
    job = program.jobs[0]
    keys = _keys(job.kind, job.agent, program.lanes, job.on, job.settings, job.options)
    own = _work(job.kind, job.agent, job.settings)
    if found := next((key for key in keys if key in times), None):
        return Forecast(times[found] * own * _length(job, job.options.get("steps", 1)), close=found == keys[0])
    for name in _lineage(job):
        if (key := ("learn", name, program.lanes)) in times:
            each = own if has_work(job.agent) else work(name, job.settings)
            return Forecast(times[key] * each * updates(job), close=False, whole=False)
    return None


def _keys(
    kind: str, agent: str, lanes: int, on: str, settings: Mapping[str, Any], options: Mapping[str, Any]
) -> list[tuple[Any, ...]]:  # fmt: skip
    """What programs may have in common that take as long a step, the most telling first: sizes and data, sizes, data, neither.

    Sizes are settings that are sizes or choices, and all options but the length of the run and how often it is judged; without
    them remain the options that are no settings. Data are also of a kind: pictures take longer than numbers.
    """
    shape = {name: value for name, value in settings.items() if not isinstance(value, float)}
    rest = {name: value for name, value in options.items() if name not in ("steps", "episodes", "every")}
    other = {name: value for name, value in rest.items() if name != "fields"}  # settings of designers and estimators
    sizes = [json.dumps(each, sort_keys=True) for each in ([shape, rest], other)]
    return [(kind, agent, lanes, size, where) for size in sizes for where in (on, _has_pictures(kind, on))]


def _length(job: Job, steps: int) -> float:
    """Steps of a job, and as many more as its updates on a log before it acts take."""
    offline = job.options.get("log", {}).get("offline", 0)
    return max(steps, 1) * (updates(job) / max(curve_end(job), 1) if offline and known_agent(job.agent) else 1.0)


def _has_pictures(kind: str, on: str) -> bool:
    """Whether it is a log of pictures."""
    from deadreckon.tasks.registry import of_log

    task = of_log(on) if kind == "learn" else None
    return task is not None and len(task.observation_shape) > 1


def _work(kind: str, agent: str, settings: Mapping[str, Any]) -> float:
    """Of a step, in proportion to others of the same agent."""
    return work(agent, settings) if kind in ("learn", "online") else 1.0


def _lineage(job: Job) -> list[str]:
    """The agent of a job that learns and those that it is derived from, the nearest first."""
    from deadreckon.agents import AGENTS, agent_class

    if job.kind not in ("learn", "online"):
        return []
    names = {kind: name for name, (_, kind, _) in AGENTS.items()}
    return [names[kind.__name__] for kind in agent_class(job.agent).__mro__ if kind.__name__ in names]
