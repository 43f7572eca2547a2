"""Estimators beside true values: with the policies of D4PG, which leave their logs, and without them, and means over tasks."""

import json
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from deadreckon.bench.claims import task_of
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from deadreckon.ope.dope import Result, from_json
from deadreckon.ope.metrics import Metrics, compare

FOLDER = Path(__file__).resolve().parent
CONTROL = "ope-unplugged"
REDRAWN = 200  # sets of policies, for the spread of a rank correlation
APART = "d4pg"  # in the names of the policies that are left out
HALVES = {
    "D4RL's tasks": ("ope-more", False),
    "dm_control": (CONTROL, False),
    "dm_control without D4PG's policies": (CONTROL, True),
}


@cache
def _results(suite: str) -> dict[str, dict[str, Result | None]]:
    """By log and method, of the suite's only seed; None where the ledger has no cell."""
    asked = read(FOLDER / f"{suite}.toml")
    found: dict[str, dict[str, Result | None]] = {}
    rows = {row["cell"]: row for row in store_of([asked], FOLDER).results().to_pylist()}
    for job in plan(asked):
        [cell] = job.cells
        result = from_json(json.loads(rows[cell]["more"])["result"]) if cell in rows else None
        found.setdefault(job.on, {})[job.method] = result
    return found


def _metrics(result: Result | None, without: bool, resamples: int = 1) -> Metrics | None:
    """Of all policies, or of those that are not left out; None where an estimate is not finite. Spreads need resamples."""
    if result is None:
        return None
    kept = np.array([not without or APART not in name for name in result.names])
    estimates = result.estimates[kept]
    return compare(estimates, result.truth[kept], resamples=resamples) if np.isfinite(estimates).all() else None


def apart(name: str, files: dict[str, bytes]) -> str:
    """A table of rank correlations by estimator and task of dm_control, in Markdown."""
    found = _results(CONTROL)
    tasks = {task_of(log): log for log in found}
    lines = [f"| estimator | {' | '.join(f'`{task}`' for task in tasks)} |", "|---|" + "---:|" * len(tasks)]
    for method in next(iter(found.values())):
        cells = []
        for log in tasks.values():
            every, held = _metrics(found[log][method], False, REDRAWN), _metrics(found[log][method], True)
            all_of_them = "-" if every is None else f"{every.rank_correlation[0]:.2f} ± {every.rank_correlation[2]:.2f}"
            cells.append(f"{all_of_them} / {'-' if held is None else f'{held.rank_correlation[0]:.2f}'}")
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join([*lines, *_lacking([CONTROL]), ""])


def halves(name: str, files: dict[str, bytes]) -> str:
    """A table of means over the tasks of either half, in Markdown: logs of a task averaged first, NaN left out."""
    means = {half: _means(_results(suite), without) for half, (suite, without) in HALVES.items()}
    methods = [*next(iter(means.values()))]
    lines = [f"| mean | {' | '.join(methods)} | all |", "|---|" + "---:|" * (len(methods) + 1)]
    for i, metric in enumerate(("rank correlation", "regret@1")):
        for half, own in means.items():
            values = np.array([own[method][:, i] for method in methods])
            told = [*np.nanmean(values, 1), np.nanmean(values)]
            lines.append(f"| {metric}, {half} | {' | '.join(f'{value:.2f}' for value in told)} |")
    return "\n".join([*lines, *_lacking(dict.fromkeys(suite for suite, _ in HALVES.values())), ""])


def _lacking(suites: Iterable[str]) -> list[str]:
    """What a table must say where cells are missing."""
    cells = [result for suite in suites for log in _results(suite).values() for result in log.values()]
    count = sum(result is None for result in cells)
    return ["", f"- without a result yet: {count:,} of {len(cells):,} cells"] if count else []


def _means(found: dict[str, dict[str, Result | None]], without: bool) -> dict[str, np.ndarray]:
    """(tasks, 2) rank correlation and regret of each method; NaN where there is none."""
    out = {}
    for method in next(iter(found.values())):
        tasks: dict[str, list[Sequence[float]]] = {}
        for log, results in found.items():
            told = _metrics(results[method], without)
            pair = (np.nan, np.nan) if told is None else (told.rank_correlation[0], told.regret[0])
            tasks.setdefault(task_of(log), []).append(pair)
        out[method] = np.array([np.mean(logs, 0) for logs in tasks.values()])
    return out
