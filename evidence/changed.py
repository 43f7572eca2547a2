"""What changes of agents' defaults cost or gain on each log, and in the mean over logs."""

from collections.abc import Sequence

import numpy as np

from deadreckon.bench.jobs import Job
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.stats.comparison import paired

BEFORE = ", before"  # how methods are named that are an agent as it was
# Suites that pair agents with what they were, and those that run the same settings with further seeds.
PAIRS = [
    "defaults-gym", "defaults-mazes", "defaults-antmaze", "defaults-flow", "defaults-cql", "defaults-models", "brac-defaults",
]  # fmt: skip
MORE = ["defaults-decide", "defaults-hopper", "defaults-awac", "defaults-awac-antmaze", "defaults-iql"]


def changed(suites: Sequence[Suite], store: Store) -> str:
    """A table of all agents that are paired with what they were, in Markdown: score now less score before, in points.

    A difference is between runs of the same seed on the same collection of a log, over all seeds that both have in any of the
    suites, with Student's 95 % interval; the last column is the mean over the logs that have one, each counted alike
    (`stats.comparison.paired`). A log on which a run has no finite score has no difference.

    Args:
        suites: of which those of `PAIRS` and `MORE` count, at their own size.
        store: the results.
    """
    rows = {row["cell"]: (row["score"], row["log"]) for row in store.results().to_pylist()}
    scores: dict[str, dict[int, tuple[float, str]]] = {}  # by what a job is, whatever its seeds, with the log's fingerprint
    jobs: list[Job] = []
    for suite in suites:
        if suite.name not in PAIRS + MORE:
            continue
        for job in plan(suite):
            there = {seed: rows[cell] for seed, cell in zip(job.seeds, job.cells, strict=True) if cell in rows}
            scores.setdefault(job.content(0), {}).update(there)
            if suite.name in PAIRS:
                jobs.append(job)
    found = {(job.method, job.on): scores[job.content(0)] for job in jobs}
    logs, methods = [*dict.fromkeys(job.on for job in jobs)], [*dict.fromkeys(job.method for job in jobs)]
    lines = [f"| agent | {' | '.join(logs)} | mean over the logs beside it |", "|---|" + "---:|" * (len(logs) + 1)]
    for method in methods:
        if f"{method}{BEFORE}" in methods:
            lines.append(_line(method, logs, found))
    return "\n".join([*lines, ""])


def _line(method: str, logs: Sequence[str], found: dict[tuple[str, str], dict[int, tuple[float, str]]]) -> str:
    sides: tuple[dict[str, np.ndarray], dict[str, np.ndarray]] = {}, {}
    cells = []
    for log in logs:
        both = [found.get((name, log), {}) for name in (method, f"{method}{BEFORE}")]
        seeds = sorted(seed for seed in both[0].keys() & both[1].keys() if both[0][seed][1] == both[1][seed][1])
        pair = np.array([[each[seed][0] for seed in seeds] for each in both])
        if len(seeds) < 2:
            cells.append("-")
        elif not np.isfinite(pair).all():
            cells.append("not finite")
        else:
            sides[0][log], sides[1][log] = pair
            cells.append(f"{paired({log: pair[0]}, {log: pair[1]}):.1f} ({len(seeds)})")
    return f"| {method} | {' | '.join(cells)} | {f'{paired(*sides):.1f}' if sides[0] else '-'} |"
