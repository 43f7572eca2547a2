"""Results of suites that no run made, for tests of what is read off them."""

import json
from collections.abc import Sequence

from deadreckon.bench.jobs import Job
from deadreckon.bench.store import JobResult, Store


def keep(
    store: Store, job: Job, scores: Sequence[float], curves: Sequence[dict] = (), log: str = "", failure: str = "",
    **more: Sequence[float],
) -> None:  # fmt: skip
    """Keeps a job's scores: if there are fewer than seeds, those of the first seeds.

    Args:
        store: that is to have them.
        job: whose they are.
        scores: one a seed.
        curves: points of learning curves, of all seeds.
        log: fingerprint of the log.
        failure: of all seeds; "": none.
        **more: further numbers, one a seed.
    """
    told = {"raw": 0.0, "steps": 100, "seconds": 1.0, "failure": failure, "versions": "{}", "log": log}
    rows = [
        {"seed": seed, "score": score, "more": json.dumps({name: values[i] for name, values in more.items()}), **told}
        for i, (seed, score) in enumerate(zip(job.seeds, scores))
    ]
    store.keep(job, JobResult(rows, list(curves)))
