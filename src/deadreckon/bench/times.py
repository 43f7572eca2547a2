"""How long programs will take, by those that are done."""

import statistics
from collections.abc import Sequence
from typing import Any

from deadreckon.bench.jobs import Program
from deadreckon.bench.store import Store


def forecast(waiting: Sequence[Program], store: Store) -> dict[str, float | None]:
    """Seconds of each program by its name, or None where none of the same agent is done.

    By the median seconds a step of the agent's programs of as many lanes: of those on the same data where there are some.
    """
    if not waiting:
        return {}
    done: dict[str, list[dict[str, Any]]] = {}
    for row in store.results().to_pylist():
        done.setdefault(row["job"].partition("/")[0], []).append(row)
    same: dict[tuple[str, str, int, str], list[float]] = {}
    for rows in done.values():
        each = rows[0]["seconds"] / max(max(row["steps"] for row in rows), 1)
        for on in (rows[0]["on"], ""):
            same.setdefault((rows[0]["kind"], rows[0]["agent"], len(rows), on), []).append(each)
    out: dict[str, float | None] = {}
    for program in waiting:
        job = program.jobs[0]
        like = job.kind, job.agent, program.lanes
        known = same.get((*like, job.on)) or same.get((*like, ""))
        out[program.name] = None if not known else statistics.median(known) * max(job.options.get("steps", 1), 1)
    return out

