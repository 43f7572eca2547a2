"""Tables of suites as text, Markdown, CSV or LaTeX."""

import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from deadreckon import text_table
from deadreckon.bench.published import TABLES
from deadreckon.bench.tables import Table
from deadreckon.data.formats.csv_out import write_rows
from deadreckon.errors import unknown
from deadreckon.stats.interval import ALPHA

FEWEST = 4  # scores of which an interquartile mean leaves some out; of fewer it is their mean
_BOLD = re.compile("\0(.*?)\0")
_LATEX = {sign: f"\\{sign}" for sign in "&%_#${}"} | {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}
FORMATS = ("text", "markdown", "csv", "latex")


def rendered(tables: Sequence[Table], form: str = "text") -> str:
    """The tables as text, Markdown, CSV or LaTeX, with the notes that they have in common.

    Raises:
        UserError: an unknown form.
    """
    if form not in FORMATS:
        raise unknown("format", form, FORMATS)
    if form == "csv":
        return _csv(tables)
    grid, note = {"text": (_text, "{}"), "markdown": (_markdown, "- {}"), "latex": (_latex, "% {}")}[form]
    parts = [grid(table) for table in tables]
    if len(tables) > 1 or tables[0].suite.kind == "study":
        title = {"text": "{}", "markdown": "**{}**", "latex": "% {}"}[form]
        heads = [f"{t.metric.words}, {'more' if t.metric.higher else 'less'} is better" for t in tables]
        parts = [f"{title.format(head)}\n\n{part}" for head, part in zip(heads, parts)]
    notes = dict.fromkeys(line for table in tables for line in table.notes)
    return "\n".join(["\n\n".join(parts), "", *(note.format(line) for line in notes)])


def _grid(table: Table, mark: str) -> list[list[str]]:
    """Heads, a row a log, task or problem with published scores below, and the interquartile means."""
    methods, digits = list(table.cells), table.metric.digits
    rows = [["", *methods]]
    for on in table.suite.on:
        row = [on]
        for method in methods:
            cell = table.cells[method][on]
            text = f"{cell.estimate:.{digits}f}" if len(cell.scores) and np.isfinite(cell.scores).all() else "-"
            text = mark.format(text) if cell.bold else text
            counts = [f"{n} {what}" for n, what in ((cell.missing, "missing"), (cell.failed, "failed")) if n]
            row.append(text + (f" ({', '.join(counts)})" if counts and len(cell.scores) else ""))
        rows.append(row)
        for source, theirs in table.printed[on].items():
            rows.append([f"  {source}", *(f"{theirs[m]:.{digits}f}" if m in theirs else "" for m in methods)])
    if len(table.suite.on) > 1 and table.metric.joint:
        trimmed = table.suite.seeds * len(table.suite.on) >= FEWEST
        head = "IQM of all" if trimmed else "mean of all"
        rows.append([head, *(f"{table.whole[m]:.{digits}f}" if m in table.whole else "-" for m in methods)])
    return rows


def _text(table: Table) -> str:
    rows = _grid(table, "*{}")
    starred = any("*" in cell for row in rows for cell in row)
    told = f", or not significantly different from it by Welch's t-test (p > {ALPHA:g})" if table.suite.seeds > 1 else ""
    text = text_table.table(rows, right=range(1, len(rows[0])))
    return f"{text}\n\n* best{table.best_of}{told}" if starred else text


def _markdown(table: Table) -> str:
    head, *rows = ([cell.replace("|", r"\|") for cell in row] for row in _grid(table, "**{}**"))
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    lines += ["| " + " | ".join(cell.strip() for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def _latex(table: Table) -> str:
    def safe(text: str) -> str:
        return re.sub(r"[\\&%_#${}^~]", lambda found: _LATEX[found[0]], text)

    head, *rows = ([_BOLD.sub(r"\\textbf{\1}", safe(cell.strip())) for cell in row] for row in _grid(table, "\0{}\0"))
    lines = [r"\begin{tabular}{l" + "r" * (len(head) - 1) + "}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _csv(tables: Sequence[Table]) -> str:
    out = io.StringIO()
    several = len({table.suite.name for table in tables}) > 1  # of a queue
    heads = ["metric", "on", "method", "seeds", "mean", "low", "high", "bold", "missing", "failed"]
    heads += [source.lower() for source in TABLES]
    rows: list[list[Any]] = [["suite", *heads] if several else heads]
    for table, on in ((each, on) for each in tables for on in each.suite.on):
        for method, row in table.cells.items():
            cell = row[on]
            sound = len(cell.scores) and np.isfinite(cell.scores).all()
            numbers = [cell.estimate.value, cell.estimate.low, cell.estimate.high] if sound else [""] * 3
            told = [len(cell.scores), *numbers, int(cell.bold), cell.missing, cell.failed]
            theirs = [table.printed[on].get(source, {}).get(method, "") for source in TABLES]
            found = [table.metric.column, on, method, *told, *theirs]
            rows.append([table.suite.name, *found] if several else found)
    write_rows(out, rows, "\n")
    return out.getvalue().rstrip("\n")
