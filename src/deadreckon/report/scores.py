"""The score table, and the published numbers beside it."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from deadreckon.bench.published import load, plain
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import note, scroll
from deadreckon.report.rows import Row
from deadreckon.report.text import brackets, count, number, percent, score
from deadreckon.stats.interval import Interval

Cell = Callable[[Row], tuple[Any, float | None]]  # what is shown, and what it is sorted by


def _two(value: Interval | None) -> tuple[Any, float | None]:
    if value is None:
        return number(None), None
    return join(tag("b", score(value)), tag("small", brackets(value))), value.value


def _failures(r: Row) -> tuple[Any, float | None]:
    if r.entry is None:
        return number(None), None
    failed = r.entry.failed
    lines = [tag("small", f"seed {seed}: {metric} at {step:,}", class_="wrap") for seed, metric, step in failed]
    return (join(tag("b", f"{len(failed)} of {len(r.entry.seeds)}", class_="bad"), lines) if failed else "none"), len(failed)


def _seeds(r: Row) -> tuple[Any, float | None]:
    seeds = len(r.entry.seeds) if r.entry else None
    return count(seeds), seeds


def _each(r: Row) -> tuple[Any, float | None]:
    shown = " \N{MIDDLE DOT} ".join(score(each, beside=r.per_seed) for each in r.per_seed) or number(None)
    return tag("small", shown), max(r.per_seed) - min(r.per_seed) if r.per_seed else None


COLUMNS: tuple[tuple[str, str, Cell], ...] = (
    ("seeds", "independent runs", _seeds),
    ("score", "0 random, 100 expert", lambda r: _two(r.score)),
    ("return", "undiscounted", lambda r: _two(r.returns)),
    ("by seed", "mean of each", _each),
    ("estimated", "Q at the start", lambda r: (number(r.value), r.value)),
    ("realised", "discounted return", lambda r: (number(r.truth), r.truth)),
    ("over\N{SOFT HYPHEN}estimate", "estimated \N{MINUS SIGN} realised", lambda r: (number(r.over, signed=True), r.over)),
    ("MMD", "to the log", lambda r: (number(r.mmd), r.mmd)),
    ("outside", "the log's range", lambda r: (percent(r.outside), r.outside)),
    ("steps", "in the environment", lambda r: (count(r.acted), r.acted)),
    ("updates", "of the networks", lambda r: (count(r.updates), r.updates)),
    ("failed", "seeds", _failures),
)


def scores(page: Page, rows: Sequence[Row]) -> Markup:
    """Sortable rows, and below, apart, what was published."""
    columns = [column for column in COLUMNS if any(column[2](r)[1] is not None for r in rows)]
    head = [tag("th", tag("button", "agent", type="button"), scope="col")]
    head += [tag("th", tag("button", name, type="button"), tag("small", sub), scope="col") for name, sub, _ in columns]
    lines = []
    for r in rows:
        badge = "baseline" if r.baseline else None if r.entry else "behaviour policy"
        badge = "trained in the simulator" if r.online and not page.online else badge
        swatch = tag("i", class_=f"dot s{page.slot(r.entry)}" if r.entry else "dot log")
        cells = [tag("th", swatch, r.label, tag("small", badge) if badge else None, scope="row", data_value=r.label)]
        for _, _, cell in columns:
            shown, key = cell(r)
            finite = key is not None and math.isfinite(key)
            cells.append(tag("td", shown, data_value=f"{key:.9g}" if finite and key is not None else ""))
        lines.append(tag("tr", cells, class_=None if r.entry else "log"))
    table = tag("table", tag("thead", tag("tr", head)), tag("tbody", lines), class_="sortable", id="score-table")
    text = "Click a heading to sort."
    if any(r.value is not None for r in rows):
        text += (
            " Estimated: the critic's value of the policy's own actions at the starts of the evaluated episodes; realised: the "
            "discounted return that followed."
        )
    if any(r.mmd is not None for r in rows):
        text += (
            " MMD: Gaussian-kernel two-sample distance between (state, logged action) and (state, policy's action) on up to "
            "1,024 logged rows; a perfect copy has about 0."
        )
    return join(scroll(table), note(text), _published(page))


def _published(page: Page) -> Markup | None:
    """The published suite that has the page's task or logs in it, those rows marked."""
    known = load("table_7_1")
    logs = {plain(entry.config["data"]["name"]) for entry in page.entries}
    here = {page.task_name, *logs} & known["scores"].keys()
    if not here:
        return None
    domains = {_domain(name) for name in here}
    head = tag("tr", tag("th", "task", scope="col"), [tag("th", m, scope="col") for m in known["algorithms"]])
    lines = []
    for name, values in known["scores"].items():
        if _domain(name) in domains:
            cells = [tag("td", score(values[m], beside=[*values.values()])) for m in known["algorithms"]]
            lines.append(tag("tr", tag("th", name, scope="row"), cells, class_="here" if name in here else None))
    title = "published (thesis Table 7.1, original D4RL data, MuJoCo 1.5/2.0): not the same data or simulator"
    table = tag("table", tag("caption", title), tag("thead", head), tag("tbody", lines), class_="published")
    return tag("aside", scroll(table), note(f"{known['source']}. SAC trains online; scores are normalised, means of 3 seeds."))


def _domain(name: str) -> str:
    """What stands together in a table: the three bodies, or the tasks of one simulator."""
    first = name.partition("-")[0]
    return "gym" if first in ("halfcheetah", "hopper", "walker2d") else first
