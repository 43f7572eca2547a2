"""How long jobs will take, by those that are done."""

import statistics
from collections.abc import Sequence
from typing import Any

from deadreckon.bench.plan import Job
from deadreckon.bench.store import Store


def forecast(jobs: Sequence[Job], store: Store) -> dict[str, float | None]:
    """Seconds of each job, or None where no job of the same method is done.

    By the median seconds a step of the method's jobs of as many seeds: of those on the same data where there are some.
    """
    if not jobs:
        return {}
    done: dict[str, list[dict[str, Any]]] = {}
    for row in store.results().to_pylist():
        done.setdefault(row["job"], []).append(row)
    same: dict[tuple[str, str, int, str], list[float]] = {}
    for rows in done.values():
        each = rows[0]["seconds"] / max(max(row["steps"] for row in rows), 1)
        for on in (rows[0]["on"], ""):
            same.setdefault((rows[0]["kind"], rows[0]["agent"], len(rows), on), []).append(each)
    out: dict[str, float | None] = {}
    for job in jobs:
        like = job.kind, job.agent, len(job.seeds)
        known = same.get((*like, job.on)) or same.get((*like, ""))
        out[job.name] = None if not known else statistics.median(known) * max(job.asked.get("steps", 1), 1)
    return out

