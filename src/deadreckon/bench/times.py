"""How long programs will take, by those that are done."""

import json
import statistics
from collections.abc import Sequence
from typing import Any

from deadreckon.bench.jobs import Program
from deadreckon.bench.store import Store


def forecast(waiting: Sequence[Program], store: Store, accelerated: bool = False) -> dict[str, float | None]:
    """Seconds of each program by its name, or None where none like it is done.

    By the median seconds a step of programs of the same agent, the same sizes and as many lanes: of those on the same data
    where there are some.

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
    same: dict[tuple[str, str, str, int, str], list[float]] = {}
    for first, *others in done.values():
        each = first["seconds"] / max(max(row["steps"] for row in (first, *others)), 1)
        sizes = _sizes(json.loads(first["settings"]), json.loads(first["asked"]))
        for on in (first["on"], ""):
            same.setdefault((first["kind"], first["agent"], sizes, 1 + len(others), on), []).append(each)
    out: dict[str, float | None] = {}
    for program in waiting:
        job = program.jobs[0]
        like = job.kind, job.agent, _sizes(job.settings, job.options), program.lanes
        known = same.get((*like, job.on)) or same.get((*like, ""))
        out[program.name] = None if not known else statistics.median(known) * max(job.options.get("steps", 1), 1)
    return out


def _sizes(settings: dict[str, Any], options: dict[str, Any]) -> str:
    """What the time of a step depends on: settings that are sizes or choices, and all options but the length of the run and how
    often it is judged."""
    shape = {name: value for name, value in settings.items() if not isinstance(value, float)}
    rest = {name: value for name, value in options.items() if name not in ("steps", "episodes", "every")}
    return json.dumps([shape, rest], sort_keys=True)
