"""The DOPE protocol's page: metrics of each estimator (thesis Figures 8.4-8.6), estimates against truth (Figures E.8-E.13)."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deadreckon.ope.dope import TRIED, Cell, Result, Shown, cells, shown_metrics
from deadreckon.report import charts, forest
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number, words
from deadreckon.stats.interval import NORMAL, Interval

Tables = dict[Shown, dict[str, dict[str, Cell]]]  # metric -> log -> method
REDRAWN = (
    "Each number is of the policies as they are, ± its standard deviation over redrawn ones (a bootstrap). The thesis (E.2) "
    "prints means over redrawn policies: ours (redrawn) stand above them."
)


def write_bench(results: Sequence[Result], out: Path | str, *, clip: float | None = None) -> Path:
    """Writes one self-contained HTML page about results of `ope.dope.evaluate_log`.

    Args:
        results: of one or several logs.
        out: the page; an old one is replaced.
        clip: what normalised estimates are cut at for the metrics; None: nothing.

    Raises:
        UserError: a method with two settings, or an output that cannot be written.
    """
    logs = list(dict.fromkeys(r.log for r in results))
    methods = list(dict.fromkeys(r.method for r in results))
    slots = {method: i % forest.SLOTS for i, method in enumerate(methods)}
    tables = {each: cells(results, each.metric, clip=clip, k=each.k) for each in shown_metrics(results)}
    sections: list[tuple[str, str, Markup | None]] = [
        ("metrics", "Quality of the estimates", _metrics(tables, slots)),
        ("tables", "Log by log", join(*(_table(each.title, found, methods) for each, found in tables.items()), note(REDRAWN))),
        *((f"log-{i}", log, _scatters([r for r in results if r.log == log], slots)) for i, log in enumerate(logs)),
        ("risks", "Risk of selecting by the estimates", _risks(results)),
        ("settings", "Settings", _settings(results)),
    ]
    counts = sorted({len(r.names) for r in results})
    many = " to ".join(str(n) for n in dict.fromkeys((counts[0], counts[-1])))
    facts = [("logs", str(len(logs))), ("policies per task", many), ("estimators", ", ".join(methods))]
    facts += [] if clip is None else [("normalised estimates", f"cut at {clip:g}")]
    text = document("Off-policy evaluation, the DOPE protocol", _lead(tables), facts, sections)
    return save_page(text, out)


def _means(found: dict[str, dict[str, Cell]], method: str) -> Interval:
    """Mean over logs, with the least and the greatest; nothing where a log is missing, for a mean of the easy ones misleads."""
    values = [row[method].value if method in row else math.nan for row in found.values()]
    if not np.isfinite(values).all():
        return Interval(math.nan, math.nan, math.nan)
    return Interval(float(np.mean(values)), min(values), max(values))


def _lead(tables: Tables) -> str:
    parts = []
    for each, found in tables.items():
        methods = list(dict.fromkeys(method for row in found.values() for method in row))
        known = {method: _means(found, method).value for method in methods}
        known = {method: value for method, value in known.items() if math.isfinite(value)}
        if known:
            best = (max if each.metric == "rank_correlation" else min)(known, key=lambda method: known[method])
            name = each.title.split(",")[0]
            parts.append(f"{name[0].lower()}{name[1:]}: {best} ({number(known[best])})")
    return f"Best on average, by {words(parts)}." if parts else "Nothing finite was estimated."


def _metrics(tables: Tables, slots: dict[str, int]) -> Markup:
    drawn, ticks = [], False
    for each, found in tables.items():
        rows = []
        for method, slot in slots.items():
            # The thesis's mean stands beside ours only where it prints every log that ours is a mean of.
            own = [row[method] for row in found.values() if method in row]
            printed = [cell.printed[0] for cell in own if cell.printed]
            other = float(np.mean(printed)) if own and len(printed) == len(own) else None
            ticks = ticks or other is not None
            rows.append((method, slot, _means(found, method), other))
        drawn.append(figure(forest.bars(rows, each.title), each.title))
    text = "Means over logs; whiskers reach from the least to the greatest. No bar: no finite estimates on some log."
    if ticks:
        text += " Upright ticks: the thesis's mean (E.2) of the original logs and policies of the same names, "
        text += "which is one over redrawn policies; the bars are of the policies as they are."
    return join(tag("div", drawn, class_="charts two"), note(text))


def _table(heading: str, found: dict[str, dict[str, Cell]], methods: list[str]) -> Markup:
    rows = []
    for log, row in found.items():
        tds = [tag("th", log, scope="row")]
        for method in methods:
            cell = row.get(method)
            printed = cell.printed if cell else None
            small = [f"±{number(cell.spread)}"] if cell and math.isfinite(cell.spread) else []
            if cell and printed:  # which is over redrawn policies, so ours over redrawn ones stands above it
                small += [f"redrawn {number(cell.mean)}"] if math.isfinite(cell.mean) else []
                small += [f"thesis {number(printed[0])} ±{number(printed[1])}"]
            tds.append(tag("td", tag("b", number(cell.value if cell else None)), [tag("small", line) for line in small]))
        rows.append(tag("tr", tds))
    head = heads_of(("log", *methods))
    return join(tag("h3", heading), scroll(tag("table", head, tag("tbody", rows))))


def _scatters(results: Sequence[Result], slots: dict[str, int]) -> Markup:
    drawn = []
    for r in results:
        columns = r.names, [slots[r.method]] * len(r.names), r.truth, NORMAL * r.errors, r.estimates, r.low, r.high
        points = list(zip(*columns))
        drawn.append(figure(charts.scatter(points, "true value", "estimate"), r.method))
    return tag("div", drawn, class_="charts two")


def _risks(results: Sequence[Result]) -> Markup:
    heads = f"SharpeRatio@{TRIED}", "type I error", "type II error"
    rows = []
    for r in results:
        if np.isfinite(r.estimates).all():
            found = [tag("td", number(x)) for x in r.risks()]
            rows.append(tag("tr", tag("th", r.log, scope="row"), tag("td", r.method), found))
    head = heads_of(("log", "estimator", *heads))
    text = note(
        f"SharpeRatio@{TRIED}: what the best of the {TRIED} policies with the highest estimates gains over the behaviour "
        f"policy, for the deviation among the {TRIED} (Kiyohara et al. 2024). Type I: of the policies truly worse than the "
        "behaviour policy, the share that is estimated to be as good or better; type II: of the others, the share that is not."
    )
    return join(scroll(tag("table", head, tag("tbody", rows))), text)


def _settings(results: Sequence[Result]) -> Markup:
    rows = []
    for r in results:
        said = [tag("small", line) for line in r.warnings]
        rows.append(tag("tr", tag("th", r.log, scope="row"), tag("td", r.method), tag("td", number(r.seconds)),
                        tag("td", tag("code", r.settings), said, class_="text")))  # fmt: skip
    names = "log", "estimator", "seconds", "settings, warnings"
    head = heads_of(names)
    return scroll(tag("table", head, tag("tbody", rows)))
