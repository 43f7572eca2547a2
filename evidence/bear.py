"""BEAR's constraint at the end of runs: tables of its suites, and one picture of them all."""

import json
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deadreckon.agents.bear import BEAR
from deadreckon.bench.methods import Method
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.report import charts
from deadreckon.report.picture import sheet

SUITES = [f"bear-{kind}" for kind in ("defaults", "choice", "threshold", "forms", "relative", "again-halfcheetah")]
THRESHOLD = 0.05  # of the MMD, where a method does not say another
FLOOR = 0.157  # where the biased MMD of four draws ends in all runs of the thesis's form, whose multiplier is at its cap
PICTURE = "bear-constraint.svg"
KINDS = "the thesis's form", "biased MMD, a threshold near or above its floor", "unbiased MMD", "a VAE as the model", "relative"


def constraint(suite: Suite, store: Store) -> str:
    """Score, MMD and multiplier in the last chunk of updates, by method: mean, lowest and highest of the seeds."""
    results = {row["cell"]: row for row in store.results().to_pylist()}
    rows = [f"| variant on {', '.join(suite.on)} | seeds | score | MMD | multiplier |", "|---|---:|---:|---:|---:|"]
    cells: dict[str, list[str]] = {method.name: [] for method in suite.methods}
    for job in plan(suite):
        cells[job.method] += job.cells
    for method, own in cells.items():
        found = [(results[cell]["score"], json.loads(results[cell]["more"])) for cell in own if cell in results]
        if not found:
            continue
        columns = [score for score, _ in found], *([more[key] for _, more in found] for key in ("mmd", "multiplier"))
        shown = (
            f"{np.mean(x):,.{digits}f} ({min(x):,.{digits}f} to {max(x):,.{digits}f})" for x, digits in zip(columns, (1, 3, 0))
        )
        rows.append(f"| {method} | {len(found)} | {' | '.join(shown)} |")
    text = ["Mean (lowest to highest) over seeds, MMD over the last chunk."] if len(rows) > 2 else ["No result yet."]
    declared = [cell for own in cells.values() for cell in own]
    if missing := sum(cell not in results for cell in declared):
        without = [method for method, own in cells.items() if not any(cell in results for cell in own)]
        named = f", among them all of {'; '.join(without)}" if without else ""
        text.append(f"Without a result yet: {missing} of {len(declared)} cells{named}.")
    return "\n".join([*(rows if len(rows) > 2 else []), "", *text, ""])


def story(suites: Sequence[Suite], store: Store, files: dict[str, bytes]) -> str:
    """A picture of floor, threshold, multiplier and score: a point for every run of the suites."""
    results = {row["cell"]: row for row in store.results().to_pylist()}
    by_mmd, by_multiplier, seen = [], [], set()
    for suite in suites:
        methods = {method.name: method for method in suite.methods}
        for job in plan(suite):
            kind, threshold = _kind(methods[job.method])
            for cell in job.cells:
                if cell not in results or cell in seen:  # two suites may have the same cell
                    continue
                seen.add(cell)
                more, rest = json.loads(results[cell]["more"]), (0.0, results[cell]["score"], math.nan, math.nan)
                if threshold is not None:
                    by_mmd.append((KINDS[kind], kind, more["mmd"] / threshold, *rest))
                by_multiplier.append((KINDS[kind], kind, math.log10(max(more["multiplier"], 1e-30)), *rest))
    if not by_multiplier:
        return "No result yet.\n"
    lines = [("threshold", 1.0), ("floor of the thesis's form", FLOOR / THRESHOLD)]
    cap = [("cap", BEAR().multiplier_max / math.log(10.0))]
    panels = {
        "Score against the MMD at the end": charts.scatter(
            by_mmd, "MMD, in multiples of the threshold", "normalised score", diagonal=False, references=lines
        ),
        "Score against the multiplier at the end": charts.scatter(
            by_multiplier, "logarithm to base 10 of the multiplier", "normalised score", diagonal=False, references=cap
        ),
    }
    with tempfile.TemporaryDirectory() as folder:
        files[PICTURE] = sheet(Path(folder) / PICTURE, panels, KINDS).read_bytes()
    return (
        "A point is a run. On the threshold or left of it the constraint is met; a relative MMD, whose threshold is 0, is not "
        "on the left. A multiplier at its cap was held back.\n\n"
        f"![Score of each run against its MMD, with threshold and floor, and against its multiplier]({PICTURE})\n"
    )


def _kind(method: Method) -> tuple[int, float | None]:
    """Which of `KINDS` a method is of, and its threshold; None of a relative MMD, which is no multiple of one."""
    fields = method.fields
    threshold = float(fields.get("threshold", THRESHOLD))
    if fields.get("mmd_estimate") == "relative":
        return 4, None
    if fields.get("behavior") == "vae":
        return 3, threshold
    if fields.get("mmd_estimate", "biased") == "unbiased":
        return 2, threshold
    return int(threshold != THRESHOLD), threshold
