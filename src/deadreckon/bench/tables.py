"""A suite's results as a table: means with intervals, the bold rule, published numbers beside them, and what is missing."""

import csv
import dataclasses
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.bench import published
from deadreckon.bench.plan import Job, code
from deadreckon.bench.statistics import Estimate, bold, interval, iqm
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.errors import unknown
from deadreckon.ope.intervals import student

FORMATS = ("text", "markdown", "csv", "latex")
# Agents in the thesis's Table 7.1; BRAC has a name for each form.
THEIRS = {"bc": "BC", "sac": "SAC-off", "bear": "BEAR", "awr": "AWR", "bcq": "BCQ", "algae_dice": "aDICE", "cql": "CQL"}


@dataclass(frozen=True)
class Cell:
    """Scores of one method on one thing, one a seed."""

    scores: np.ndarray
    missing: int
    failed: int
    bold: bool = False

    @property
    def sound(self) -> bool:
        """Whether all seeds are there, have a score, and none went bad."""
        return not (self.missing or self.failed) and len(self.scores) > 0 and bool(np.isfinite(self.scores).all())

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
        cells: method -> what it was run on -> scores, of which there may be none yet.
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
    column = "content" if any_code else "cell"
    by_cell: dict[str, dict[str, Any]] = {}
    for row in store.of(jobs, any_code).to_pylist():  # the newest last; of the present code, where there are any
        known = by_cell.get(row[column])
        if known is None or row["code"] == code() or known["code"] != code():
            by_cell[row[column]] = row
    cells: dict[str, dict[str, Cell]] = {}
    shown: list[dict[str, Any]] = []
    for job in jobs:
        names = [job.cell(seed, with_code=not any_code) for seed in job.seeds]
        own = [by_cell[name] | {"method": job.method, "on": job.on} for name in names if name in by_cell]
        shown += own
        before = cells.setdefault(job.method, {}).get(job.on, Cell(np.zeros(0), 0, 0))
        scores = np.concatenate([before.scores, np.array([row["score"] for row in own], float)])
        failed = before.failed + sum(row["failure"] != "" for row in own)
        cells[job.method][job.on] = Cell(scores, before.missing + len(names) - len(own), failed)
    for on in suite.on:
        whole = {method: row[on].scores for method, row in cells.items() if row[on].sound}
        for method, marks in (bold({method: [scores] for method, scores in whole.items()}) if whole else {}).items():
            cells[method][on] = dataclasses.replace(cells[method][on], bold=bool(marks[0]))
    full = {method: row for method, row in cells.items() if all(cell.sound for cell in row.values())}
    means = {method: interval({on: cell.scores for on, cell in row.items()}, iqm) for method, row in full.items()}
    printed = {on: _printed(suite, on) for on in suite.on} if suite.kind == "learn" else {}
    missing = [(job, s) for job in jobs for s in job.seeds if job.cell(s, with_code=not any_code) not in by_cell]
    notes = [f"{suite.seeds} seeds; means with Student's 95 % intervals over seeds, wide where these are few"]
    if any(printed.values()):
        notes.append("thesis: Table 7.1, after 500,000 updates on D4RL's logs: not the same data, not the same simulator")
    return Table(suite, cells, printed, means, (*notes, *_notes(jobs, missing, store, shown)))


def _printed(suite: Suite, on: str) -> dict[str, float]:
    scores, names = published.scores(on), {}
    for method in suite.methods:
        form = "BRAC-v" if method.fields.get("value_form", True) else "BRAC-p"
        names[method.name] = form if method.agent == "brac" else THEIRS.get(method.agent, "")
    return {ours: scores[theirs] for ours, theirs in names.items() if theirs in scores}


def _notes(jobs: Sequence[Job], missing: Sequence[tuple[Job, int]], store: Store, found: list[dict[str, Any]]) -> list[str]:
    notes = []
    again = sorted({job.on for job in jobs if "@dr" in job.data})
    if again:
        notes.append(f"collected again by this package, not the original files: {', '.join(again)}")
    notes += _tuned(jobs)
    blind = sorted({row["on"] for row in found if np.isnan(row["score"])})
    if blind:
        notes.append(f"no simulator to judge in, so no scores: {', '.join(blind)}")
    codes = {row["code"] for row in found}
    if len(codes) > 1:
        notes.append(f"results of {len(codes)} versions of the methods' code stand side by side")
    named = ("jax", "mujoco", "device", "python")
    versions = {json.dumps({k: v for k, v in json.loads(row["versions"]).items() if k in named}) for row in found}
    notes += [f"made with {', '.join(f'{k} {v}' for k, v in json.loads(text).items())}" for text in sorted(versions)]
    failures = [(job, store.failure(job, seed)) for job, seed in missing]
    notes += dict.fromkeys(f"FAILED: {job.method} on {job.on}: {failure['error']}" for job, failure in failures if failure)
    if waiting := sum(failure is None for _, failure in failures):
        notes.append(f"not run yet: {waiting:,} of {sum(len(job.seeds) for job in jobs):,} cells")
    for row in (row for row in found if row["failure"]):
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
            text = _shown(cell.estimate) if len(cell.scores) and np.isfinite(cell.scores).all() else "-"
            text = mark.format(text) if cell.bold else text
            counts = [f"{n} {what}" for n, what in ((cell.missing, "missing"), (cell.failed, "failed")) if n]
            row.append(text + (f" ({', '.join(counts)})" if counts and len(cell.scores) else ""))
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
    head, *rows = ([cell.replace("|", r"\|") for cell in row] for row in _grid(table, "**{}**"))
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    lines += ["| " + " | ".join(cell.strip() for cell in row) + " |" for row in rows]
    return "\n".join([*lines, "", *(f"- {note}" for note in table.notes)])


def _latex(table: Table) -> str:
    def safe(text: str) -> str:
        for sign in "&%_#$":
            text = text.replace(sign, f"\\{sign}")
        return text.replace("^", r"\^{}").replace("~", r"\~{}")

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
