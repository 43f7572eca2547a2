"""On which design problems NEMO is above the forward model and the ensemble (thesis Tables 6.1 and 6.2)."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.stats.comparison import paired

SUITES = ["design", "design-more"]
METHOD, RIVALS = "NEMO", ("forward", "ensemble")


def above(suites: Sequence[Suite], store: Store) -> str:
    """A table of all problems, in Markdown: how far NEMO is above each rival, 100 being the best of all data.

    Differences are between runs of the same seed, with Student's 95 % intervals, of the best design and of the median one. NEMO
    is above both rivals on a problem where both intervals of one of these lie above 0.

    Args:
        suites: of which those of `SUITES` count, at their own size.
        store: the results.
    """
    rows = {row["cell"]: row for row in store.results().to_pylist()}
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for job in (job for suite in suites if suite.name in SUITES for job in plan(suite)):
        if job.method in (METHOD, *RIVALS):
            there = [rows[cell] for cell in job.cells if cell in rows]
            found.setdefault(job.on, {})[job.method] = there if len(there) == len(job.cells) else []
    titles = [f"{what}: above {rival}" for what in ("best", "median") for rival in RIVALS]
    lines = [f"| problem | {' | '.join(titles)} | above both |", "|---|" + "---:|" * len(titles) + "---|"]
    count = whole = 0
    for on, methods in found.items():
        if not all(methods.values()):
            lines.append(f"| {on} |{' |' * len(titles)} not all cells are there |")
            continue
        scores = {name: [(row["score"], json.loads(row["more"])["median"]) for row in them] for name, them in methods.items()}
        values = {name: np.array(them, float) for name, them in scores.items()}  # (seeds, 2)
        gains = [paired({on: values[METHOD][:, i]}, {on: values[rival][:, i]}) for i in (0, 1) for rival in RIVALS]
        by = [what for what, pair in (("best", gains[:2]), ("median", gains[2:])) if all(each.low > 0 for each in pair)]
        lines.append(f"| {on} | {' | '.join(f'{gain:.1f}' for gain in gains)} | {' and '.join(by) or 'no'} |")
        whole, count = whole + 1, count + bool(by)
    return "\n".join([*lines, "", f"NEMO is above both on {count} of {whole} problems.", ""])
