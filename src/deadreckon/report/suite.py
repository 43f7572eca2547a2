"""A suite's page: bars of each method per domain (thesis Figure 7.4), and its tables with published numbers beside."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deadreckon.bench.tables import Cell, Table
from deadreckon.report import forest
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import words
from deadreckon.stats.comparison import over_tasks
from deadreckon.stats.interval import PERCENT, Interval
from deadreckon.tasks.registry import names as tasks
from deadreckon.tasks.registry import of_log, task


def write_suite(tables: Sequence[Table], out: Path | str, pages: Sequence[Path] = ()) -> Path:
    """Writes one self-contained HTML page about a suite's results.

    Args:
        tables: of all its metrics, from `bench.tables.tables`.
        out: the page; an old one is replaced.
        pages: of single logs or tasks, which it links to; beside it.

    Raises:
        UserError: an output that cannot be written.
    """
    suite = tables[0].suite
    sections: list[tuple[str, str, Markup | None]] = [
        *((f"bars-{i}", _title(table), _bars(table)) for i, table in enumerate(tables)),
        *((f"table-{i}", f"{_title(table)}, one by one", _table(table)) for i, table in enumerate(tables)),
        ("pages", "Log by log", _list([tag("a", page.stem, href=page.name) for page in pages]) if pages else None),
        ("notes", "What to know", _list(list(dict.fromkeys(line for table in tables for line in table.notes)))),
    ]
    facts = [("methods", str(len(suite.methods))), (f"{suite.kind} on", str(len(suite.on))), ("seeds", str(suite.seeds))]
    text = document(f"Suite {suite.name}", _lead(tables[0]), facts, sections)
    return save_page(text, out)


def _list(lines: Sequence[str]) -> Markup:
    return tag("ul", [tag("li", line) for line in lines])


def _title(table: Table) -> str:
    return f"{table.metric.words[0].upper()}{table.metric.words[1:]}"


def _lead(table: Table) -> str:
    found = {method: row for method, row in table.cells.items() if all(cell.sound for cell in row.values())}
    if not found:
        return "Not all runs are done yet."
    best = [method for method, row in found.items() if all(cell.bold for cell in row.values())]
    if len(table.suite.on) == 1:
        return f"Best{table.best_of}, or not significantly different from the best: {words(best)}."
    counts = {method: sum(cell.bold for cell in row.values()) for method, row in found.items()}
    most = max(counts.values())
    names = words([method for method, count in counts.items() if count == most])
    return f"Best{table.best_of}, or not significantly different from the best, on {most} of {len(table.suite.on)}: {names}."


def groups(table: Table) -> dict[str, list[str]]:
    """What the suite runs on, by domain; design problems, and numbers on scales of their own, each by itself."""
    found: dict[str, list[str]] = {}
    for on in table.suite.on:
        known = of_log(on) if table.suite.kind in ("learn", "ope") else task(on) if on in tasks() else None
        found.setdefault(known.domain if known and table.metric.joint else on, []).append(on)
    return found


def _bars(table: Table) -> Markup | None:
    drawn, ticks = [], False
    for name, members in groups(table).items():
        rows = []
        for i, (method, row) in enumerate(table.cells.items()):
            cells = {on: row[on] for on in members}
            thesis = [table.printed[on].get("thesis", {}) for on in members]
            printed = [scores[method] for scores in thesis if method in scores]
            # The thesis's mean stands beside ours only where it prints all that ours is a mean of.
            other = float(np.mean(printed)) if len(printed) == len(members) else None
            ticks = ticks or other is not None
            spread = _spread(cells)
            rows.append((method, i % forest.SLOTS, spread, other))
        if any(np.isfinite(spread.value) for _, _, spread, _ in rows):
            heading = members[0] if len(members) == 1 else f"{name}: mean of {len(members)}"
            drawn.append(figure(forest.bars(rows, table.metric.words), heading))
    if not drawn:
        return None
    text = (
        f"Means over logs of means over seeds, with Student's {PERCENT} intervals over seeds. No bar: runs are missing or "
        "failed."
    )
    if ticks:
        text += " Upright ticks: the thesis's numbers."
    return join(tag("div", drawn, class_="charts two"), note(text))


def _spread(cells: dict[str, Cell]) -> Interval:
    """Mean over logs with its interval; nothing where one is missing, for a mean of the easy ones misleads."""
    if not all(cell.sound for cell in cells.values()):
        return Interval(np.nan, np.nan, np.nan)
    found = over_tasks({on: cell.scores for on, cell in cells.items()})
    ends = (found.value if np.isnan(end) else end for end in (found.low, found.high))  # one seed has no spread
    return Interval(found.value, *ends)


def _table(table: Table) -> Markup:
    shown = lambda value: f"{value:.{table.metric.digits}f}"  # noqa: E731
    rows = []
    for on in table.suite.on:
        tds = [tag("th", on, scope="row")]
        for method, row in table.cells.items():
            cell = row[on]
            known = len(cell.scores) > 0 and bool(np.isfinite(cell.scores).all())
            value = shown(cell.estimate.value) if known else "-"
            spread = known and np.isfinite(cell.estimate.low)
            small = [f"{shown(cell.estimate.low)} to {shown(cell.estimate.high)}"] if spread else []
            small += [f"{count} {what}" for count, what in ((cell.missing, "missing"), (cell.failed, "failed")) if count]
            small += [f"{source} {shown(own[method])}" for source, own in table.printed[on].items() if method in own]
            tds.append(tag("td", tag("b", value) if cell.bold else value, [tag("small", line) for line in small]))
        rows.append(tag("tr", tds))
    text = (
        f"Means over seeds with Student's {PERCENT} intervals. Bold: the best, and all that Welch's t-test does not "
        "distinguish from it (p > 0.05, of each pair alone: of many equal methods some are not bold by chance)."
    )
    return join(scroll(tag("table", heads_of(("", *table.cells)), tag("tbody", rows))), note(text))
