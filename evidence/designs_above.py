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
METHOD, RIVALS, FLOOR = "NEMO", ("forward", "ensemble"), "best of data"


def above(suites: Sequence[Suite], store: Store) -> str:
    """A table of all problems, in Markdown: how far NEMO is above each rival, 100 being the best of all data.

    Differences are between runs of the same seed, with Student's 95 % intervals, of the best design and of the median one. NEMO
    is above both rivals on a problem where both intervals of one of these lie above 0. A search that stays where it began
    can be that, so it stands beside the best designs of the data, too.

    Args:
        suites: of which those of `SUITES` count, at their own size.
        store: the results.
    """
    rows = {row["cell"]: row for row in store.results().to_pylist()}
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for job in (job for suite in suites if suite.name in SUITES for job in plan(suite)):
        if job.method in (METHOD, *RIVALS, FLOOR):
            there = [rows[cell] for cell in job.cells if cell in rows]
            found.setdefault(job.on, {})[job.method] = there if len(there) == len(job.cells) else []
    others = (*RIVALS, FLOOR)
    titles = [f"{what}: above {other}" for what in ("best", "median") for other in others]
    lines = [
        f"| problem | {' | '.join(titles)} | above both rivals | and the data |",
        "|---|" + "---:|" * len(titles) + "---|---|",
    ]
    whole, both, all_three = 0, 0, 0
    for on, methods in found.items():
        if not all(methods.values()):
            lines.append(f"| {on} |{' |' * len(titles)} not all cells are there | |")
            continue
        scores = {name: [(row["score"], json.loads(row["more"])["median"]) for row in them] for name, them in methods.items()}
        values = {name: np.array(them, float) for name, them in scores.items()}  # (seeds, 2)
        gains = {
            what: [paired({on: values[METHOD][:, i]}, {on: values[other][:, i]}) for other in others]
            for i, what in enumerate(("best", "median"))
        }
        by = [what for what, those in gains.items() if all(gain.low > 0 for gain in those[: len(RIVALS)])]
        beyond = [what for what in by if gains[what][-1].low > 0]
        told = " | ".join(f"{gain:.1f}" for those in gains.values() for gain in those)
        lines.append(f"| {on} | {told} | {' and '.join(by) or 'no'} | {' and '.join(beyond) or 'no'} |")
        whole, both, all_three = whole + 1, both + bool(by), all_three + bool(beyond)
    count = f"NEMO is above both rivals on {both} of {whole} problems, and above the best of the data as well on {all_three}."
    return "\n".join([*lines, "", count, ""])
