"""How long jobs will take, by those that are done."""

import statistics
from collections.abc import Sequence

from deadreckon.bench.plan import Job
from deadreckon.bench.store import Store


def forecast(jobs: Sequence[Job], store: Store) -> dict[str, float | None]:
    """Seconds of each job, or None where no job of the same method is done.

    By the median seconds an update of a seed of the method's jobs: of those on the same data where there are some.
    """
    same: dict[tuple[str, str], list[float]] = {}
    for row in store.results().to_pylist():
        each = row["seconds"] / max(row["steps"], 1)  # of all seeds of its job
        for key in ((row["agent"], row["on"]), (row["agent"], "")):
            same.setdefault(key, []).append(each)
    out: dict[str, float | None] = {}
    for job in jobs:
        known = same.get((job.agent, job.on)) or same.get((job.agent, ""))
        out[job.name] = None if not known else statistics.median(known) * max(job.asked.get("steps", 1), 1)
    return out


def text(seconds: float) -> str:
    """In words: seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:,.0f} s"
    return f"{seconds / 60:,.0f} min" if seconds < 5400 else f"{seconds / 3600:,.1f} h"

