"""A suite's results as a table: means with intervals, the bold rule, published numbers beside them, and what is missing."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from deadreckon.bench import published
from deadreckon.bench.plan import Job
from deadreckon.bench.statistics import Estimate, bold, interval, iqm
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.errors import unknown
from deadreckon.ope.intervals import student

FORMATS = ("text", "markdown", "csv", "latex")
# Names of methods in the thesis's tables, where they differ from ours.
THEIRS = {"AlgaeDICE": "aDICE"}


@dataclass(frozen=True)
class Cell:
    """Scores of one method on one thing, one a seed."""

    scores: np.ndarray
    missing: int
    failed: int
    bold: bool = False

    @property
    def estimate(self) -> Estimate:
        """Their mean with Student's 95 % interval; a single seed has none."""
        low, high = student(self.scores) if len(self.scores) > 1 else (np.nan, np.nan)
        return Estimate(float(self.scores.mean()), float(low), float(high))


@dataclass(frozen=True)
class Table:
    """A suite's results.

    Attributes:
        suite: what was asked for.
        cells: method -> what it was run on -> scores; cells without any are left out.
        printed: what it was run on -> method -> the thesis's score.
        whole: method -> interquartile mean over all, of methods that have all seeds of all.
        notes: what a reader must know, one line each.
    """

    suite: Suite
    cells: dict[str, dict[str, Cell]]
    printed: dict[str, dict[str, float]]
    whole: dict[str, Estimate]
    notes: tuple[str, ...]


def table(suite: Suite, jobs: Sequence[Job], store: Store, any_code: bool = False) -> Table:
    """What is known of a suite.

    Args:
        suite: the suite.
        jobs: its plan.
        store: where results lie.
        any_code: take results of other versions of the methods' code, too.
    """
    found = store.of(list(jobs), any_code)
    cells: dict[str, dict[str, Cell]] = {}
    for job in jobs:
        own = _rows(found, job, any_code)
        before = cells.setdefault(job.method, {}).get(job.on, Cell(np.zeros(0), 0, 0))
        scores = np.concatenate([before.scores, own["score"].to_numpy(zero_copy_only=False)])
        failed = sum(text != "" for text in own["failure"].to_pylist())
        missing = before.missing + len(job.seeds) - len(own)
        cells[job.method][job.on] = Cell(scores, missing, before.failed + failed)
    full = {m: on for m, on in cells.items() if all(not c.missing and np.isfinite(c.scores).all() for c in on.values())}
    if full:
        marks = bold({method: {on: cell.scores for on, cell in row.items()} for method, row in full.items()})
        for method, row in full.items():
            for (on, cell), mark in zip(list(row.items()), marks[method]):
                cells[method][on] = Cell(cell.scores, 0, cell.failed, bool(mark))
    whole = {method: interval({on: cell.scores for on, cell in row.items()}, iqm) for method, row in full.items()}
    printed = {on: _printed(suite, on) for on in suite.on} if suite.kind == "learn" else {}
    return Table(suite, cells, printed, whole, tuple(_notes(suite, jobs, store, found)))


def _rows(found: pa.Table, job: Job, any_code: bool) -> pa.Table:
    """One row a seed; of several versions of the code the one that was read last."""
    column = "content" if any_code else "cell"
    wanted = {job.cell(seed, with_code=not any_code) for seed in job.seeds}
    last = {name: i for i, name in enumerate(found[column].to_pylist()) if name in wanted}
    return found.take(pa.array(sorted(last.values()), pa.int64()))


def _printed(suite: Suite, on: str) -> dict[str, float]:
    scores = published.scores(on)
    names = {method.name: THEIRS.get(method.name, method.name) for method in suite.methods}
    return {ours: scores[theirs] for ours, theirs in names.items() if theirs in scores}


def _notes(suite: Suite, jobs: Sequence[Job], store: Store, found: pa.Table) -> list[str]:
    notes = [f"{suite.seeds} seeds; means with Student's 95 % intervals over seeds, wide where these are few"]
    again = sorted({job.on for job in jobs if "@dr" in job.data})
    if again:
        notes.append(f"collected again by this package, not the original files: {', '.join(again)}")
    if any(_printed(suite, on) for on in suite.on) and suite.kind == "learn":
        notes.append("thesis: Table 7.1, after 500,000 updates on D4RL's logs: not the same data, not the same simulator")
    notes += _tuned(jobs)
    codes = sorted(set(found["code"].to_pylist()))
    if len(codes) > 1:
        notes.append(f"results of {len(codes)} versions of the methods' code stand side by side")
    versions = {json.dumps({k: v for k, v in json.loads(text).items() if k in ("jax", "mujoco", "device", "python")})
                for text in found["versions"].to_pylist()}  # fmt: skip
    notes += [f"made with {', '.join(f'{k} {v}' for k, v in json.loads(text).items())}" for text in sorted(versions)]
    missing = [job for job in jobs if not store.has(job)]
    for job in missing:
        if failure := store.failure(job):
            notes.append(f"FAILED: {job.method} on {job.on}: {failure['error']}")
    waiting = [job for job in missing if store.failure(job) is None]
    if waiting:
        notes.append(f"not run yet: {len(waiting)} of {len(jobs)} jobs")
    for row in (row for row in found.to_pylist() if row["failure"]):
        told = f"{row['failure']}; its last good policy counts"
        notes.append(f"seed {row['seed']} of {row['method']} on {row['on']} failed: {told}")
    return notes


def _tuned(jobs: Sequence[Job]) -> list[str]:
    """Presets that were tuned on a task that the thesis keeps for evaluation (Table D.3)."""
    from deadreckon.tasks.registry import of_log

    found = []
    for job in jobs:
        task = of_log(job.on) if job.kind == "learn" else None
        if job.preset and task is not None and task.split == "evaluation":
            found.append(f"{job.method} on {job.on}")
    found = list(dict.fromkeys(found))
    told = "settings published for a task that the thesis keeps for evaluation (Table D.3), tuned on it"
    return [f"{told}: {', '.join(found)}"] if found else []


# ---- forms ------------------------------------------------------------------------------------------------------------


def rendered(table: Table, form: str = "text") -> str:
    """The table as text, Markdown, CSV or LaTeX.

    Raises:
        UserError: an unknown form.
    """
    if form not in FORMATS:
        raise unknown("format", form, FORMATS)
    return {"text": _text, "markdown": _markdown, "csv": _csv, "latex": _latex}[form](table)


def _shown(estimate: Estimate) -> str:
    text = f"{estimate.value:.1f}"
    return text if np.isnan(estimate.low) else f"{text} [{estimate.low:.1f}, {estimate.high:.1f}]"


def _grid(table: Table, mark: str) -> list[list[str]]:
    """Heads, a row a log, task or problem with the thesis's scores below, and the interquartile means."""
    methods = list(table.cells)
    rows = [["", *methods]]
    for on in table.suite.on:
        row = [on]
        for method in methods:
            cell = table.cells[method][on]
            text = _shown(cell.estimate) if len(cell.scores) else "-"
            text = mark.format(text) if cell.bold else text
            row.append(text + (f" ({cell.missing} missing)" if cell.missing and len(cell.scores) else ""))
        rows.append(row)
        if any(table.printed.get(on, {}).values()):
            rows.append(["  thesis", *(f"{table.printed[on][m]:.1f}" if m in table.printed[on] else "" for m in methods)])
    if len(table.suite.on) > 1:
        rows.append(["IQM of all", *(_shown(table.whole[m]) if m in table.whole else "-" for m in methods)])
    return rows


def _text(table: Table) -> str:
    rows = _grid(table, "*{}")
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))]).rstrip() for row in rows]
    rule = "  ".join("-" * w for w in widths)
    legend = ["* best, or not told from it by Welch's t-test (p > 0.05)"] if any("*" in c for row in rows for c in row) else []
    return "\n".join([lines[0], rule, *lines[1:], "", *legend, *table.notes])


def _markdown(table: Table) -> str:
    head, *rows = _grid(table, "**{}**")
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    lines += ["| " + " | ".join(cell.strip() for cell in row) + " |" for row in rows]
    return "\n".join([*lines, "", *(f"- {note}" for note in table.notes)])


def _latex(table: Table) -> str:
    def safe(text: str) -> str:
        for sign in "&%_#":
            text = text.replace(sign, f"\\{sign}")
        return text

    head, *rows = ([safe(cell.strip()) for cell in row] for row in _grid(table, r"\textbf{{{}}}"))
    lines = [r"\begin{tabular}{l" + "r" * (len(head) - 1) + "}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", *(f"% {note}" for note in table.notes)])


def _csv(table: Table) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["on", "method", "seeds", "mean", "low", "high", "bold", "missing", "failed", "thesis"])
    for on in table.suite.on:
        for method, row in table.cells.items():
            cell = row[on]
            numbers = [cell.estimate.value, cell.estimate.low, cell.estimate.high] if len(cell.scores) else [""] * 3
            told = [len(cell.scores), *numbers, int(cell.bold), cell.missing, cell.failed]
            writer.writerow([on, method, *told, table.printed.get(on, {}).get(method, "")])
    return out.getvalue().rstrip("\n")
