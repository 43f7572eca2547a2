"""The page: sections in the order in which a reader needs them."""

import datetime
import math
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from deadreckon.files import replacing
from deadreckon.report import charts, maze, provenance
from deadreckon.report.entries import Entry, Page, read
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.rows import Difference, Row, behavior, published, rows, to_score
from deadreckon.report.text import brackets, count, number, percent, score
from deadreckon.report.verdict import Verdict, verdict
from deadreckon.runs.evaluate import Interval
from deadreckon.runs.train import Run
from deadreckon.tasks.maze2d import Maze2D

EXPLODED = 20.0  # estimates this many times beyond every return are shown on a logarithmic axis
SHOWN = 8  # episodes in a maze picture
METRICS = {
    "actor_loss": "what the actor minimises",
    "critic_loss": "squared Bellman error on batches of the log",
    "q": "mean estimated value on batches of the log",
    "mmd": "the agent's own constraint, sampled MMD to its model of the log",
    "behavior_nll": "negative log-likelihood of logged actions",
}


def write(runs: Sequence[Path | str | Run], out: Path | str, *, title: str | None = None) -> Path:
    """Writes one self-contained HTML page about run folders of one task.

    Args:
        runs: run folders, finished or not.
        out: the page; an old one is replaced.
        title: heading; None makes one from the task or log.

    Raises:
        UserError: nothing to show, a path that is no run, runs of different tasks, or an output that cannot be written.
    """
    text = render(read(runs), title)
    with replacing(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(out)


def render(page: Page, title: str | None = None) -> str:
    """The page as text."""
    found = verdict(page)
    logs = list(dict.fromkeys(e.config["data"]["name"] for e in page.entries))
    title = title or f"Offline policies for {page.task_name or ', '.join(logs)}"
    sections = [
        ("decision", "Decision", _decision(page, found)),
        ("scores", "Scores", _scores(page)),
        ("learning", "Learning curves", _learning(page)),
        ("values", "Promised and delivered", _values(page)),
        ("distance", "Distance to the log", _distance(page)),
        ("training", "Training", _training(page)),
        ("mazes", "Trajectories", _mazes(page)),
        ("provenance", "Provenance", _provenance(page)),
    ]
    sections = [(name, heading, body) for name, heading, body in sections if body]
    links = tag("nav", [tag("a", heading, href=f"#{name}") for name, heading, _ in sections], aria_label="sections")
    body = join(
        _header(page, found, title, logs, links),
        tag("main", [tag("section", tag("h2", heading), body, id=name) for name, heading, body in sections]),
        tag("footer", "Made by deadreckon from run folders; the file holds everything it shows and loads nothing."),
    )
    parts = {"title": tag("title", title), "body": body, "css": _asset("page.css"), "js": _asset("page.js")}
    return Template(_asset("page.html")).substitute(parts)


def _asset(name: str) -> str:
    return resources.files("deadreckon.report").joinpath("assets", name).read_text(encoding="utf-8")


def _note(*text: Any) -> Markup:
    return tag("p", *text, class_="note")


def _figure(chart: Markup, caption: str | None = None, **attributes: Any) -> Markup:
    return tag("figure", tag("figcaption", caption) if caption else None, chart, **attributes)


def _legend(page: Page) -> Markup:
    return charts.legend([(e.label, page.slot(e)) for e in page.entries])


def _unit(page: Page) -> str:
    return "score" if any("score" in e.evaluations for e in page.entries) else "return"


# ---- header and decision ----------------------------------------------------------------------------------------------


def _header(page: Page, found: Verdict, title: str, logs: list[str], links: Markup) -> Markup:
    facts: list[tuple[str, Any]] = [("task", page.task_name or "none: not simulated"), ("log", ", ".join(logs))]
    facts.append(("rows", ", ".join(dict.fromkeys(f"{e.config['data'].get('rows', 0):,}" for e in page.entries))))
    facts.append(("date", datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M")))
    again = any("@dr" in name for name in logs)
    return tag(
        "header",
        tag("div", tag("h1", title), tag("button", "theme", type="button", id="theme", title="light or dark"), class_="top"),
        tag("p", found.headline, class_="lead"),
        tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in facts], class_="facts"),
        _note(tag("code", "@dr1"), " means: collected again by this package, after the original's recipe, on today's simulator; ",
              "not the original file.") if again else None,
        links,
    )  # fmt: skip


def _decision(page: Page, found: Verdict) -> Markup:
    best = found.best
    unit = _unit(page)
    words = {None: "No decision", True: "Deploy", False: "Do not deploy"}[found.deploy]
    kind = {None: "unknown", True: "yes", False: "no"}[found.deploy]
    if best is None:
        body = [tag("p", tag("strong", words, class_=f"stamp {kind}")), tag("p", found.reason)]
        return tag("div", body, _caveats(found), class_=f"card {kind}")
    stamp = tag("p", tag("strong", words, class_=f"stamp {kind}"), tag("span", best.label, class_="which"))
    tiles = [_tile(f"{unit}, {best.label}", best.worth, False)]
    if found.versus_log:
        tiles.append(_tile("beyond the logged behaviour", found.versus_log.worth, True, found.versus_log))
    if found.versus_cloning and found.cloning:
        tiles.append(_tile(f"beyond {found.cloning.label}, paired", found.versus_cloning.worth, True, found.versus_cloning))
    text = [stamp, tag("p", f"{words}, because {found.reason}.", class_="because"), tag("div", tiles, class_="tiles")]
    why = tag("div", tag("h3", "What beats imitation, and why"), [tag("p", line) for line in found.beaten], class_="why")
    how = _note(
        "Numbers are means over seeds and episodes of the last evaluation; brackets are 95 % bootstrap intervals that redraw "
        "seeds and episodes. Differences between agents are paired: episode i starts alike for all. "
        + (f"The logged behaviour's worth is the {_how(page)}; its own uncertainty is in the difference." if found.log else "")
    )
    limits = tag("div", tag("h3", "What this does not show"), _caveats(found))
    return tag(
        "div", tag("div", tag("div", text), _forest(page), class_="split"), tag("div", why, limits, class_="split lower"), how,
        class_=f"card {kind}",
    )  # fmt: skip


def _how(page: Page) -> str:
    return next((str(e.behavior["how"]) for e in page.entries if e.behavior and e.behavior.get("how")), "return found in the log")


def _tile(name: str, value: Interval | None, signed: bool, gap: Difference | None = None) -> Markup:
    extra = None
    if gap and gap.score:
        r = gap.returns
        extra = tag("small", f"return {score(r.mean, signed=True)} {brackets(r, signed=True)}")
    shown = tag("b", score(value.mean if value else None, signed=signed)), tag("span", brackets(value, signed=signed))
    return tag("div", tag("small", name), shown, extra, class_="tile")


def _caveats(found: Verdict) -> Markup:
    return tag("ul", [tag("li", line) for line in found.caveats], class_="caveats")


def _forest(page: Page) -> Markup | None:
    unit = _unit(page)
    bars = []
    for r in rows(page):
        spread = r.score if unit == "score" else r.returns
        if spread and math.isfinite(spread.mean):
            bars.append((r.label, page.slot(r.entry) if r.entry else None, spread))
    if not bars:
        return None
    return _figure(charts.forest(bars, unit, [("expert", 100.0)] if unit == "score" else []))


# ---- tables -----------------------------------------------------------------------------------------------------------

Cell = Callable[[Row], tuple[Any, float | None]]  # what is shown, and what it is sorted by


def _two(value: Interval | None) -> tuple[Any, float | None]:
    if value is None:
        return number(None), None
    return join(tag("b", score(value.mean)), tag("small", brackets(value))), value.mean


def _failures(r: Row) -> tuple[Any, float | None]:
    if r.entry is None:
        return number(None), None
    failed = r.entry.failed
    lines = [tag("small", f"seed {seed}: {metric} at {step:,}") for seed, metric, step in failed]
    return (join(tag("b", f"{len(failed)} of {len(r.entry.seeds)}", class_="bad"), lines) if failed else "none"), len(failed)


COLUMNS: tuple[tuple[str, str, Cell], ...] = (
    ("seeds", "trained apart", lambda r: (count(len(r.entry.seeds) if r.entry else None), len(r.entry.seeds) if r.entry else None)),
    ("score", "0 random, 100 expert", lambda r: _two(r.score)),
    ("return", "undiscounted", lambda r: _two(r.returns)),
    ("by seed", "mean of each", lambda r: (tag("small", " \N{MIDDLE DOT} ".join(map(score, r.per_seed)) or number(None)),
                                            max(r.per_seed) - min(r.per_seed) if r.per_seed else None)),
    ("promised", "Q at the start", lambda r: (number(r.value), r.value)),
    ("delivered", "discounted return", lambda r: (number(r.truth), r.truth)),
    ("over\N{SOFT HYPHEN}estimate", "promised - delivered", lambda r: (number(r.over, signed=True), r.over)),
    ("MMD", "to the log", lambda r: (number(r.mmd), r.mmd)),
    ("outside", "the log's range", lambda r: (percent(r.outside), r.outside)),
    ("updates", "of the networks", lambda r: (count(r.updates), r.updates)),
    ("failed", "lanes", _failures),
)  # fmt: skip


def _scores(page: Page) -> Markup:
    head = [tag("th", tag("button", "agent", type="button"), scope="col")]
    head += [tag("th", tag("button", name, type="button"), tag("small", sub), scope="col") for name, sub, _ in COLUMNS]
    lines = []
    for r in rows(page):
        badge = "baseline" if r.baseline else None if r.entry else "what the log did"
        swatch = tag("i", class_=f"dot s{page.slot(r.entry)}" if r.entry else "dot log")
        cells = [tag("th", swatch, r.label, tag("small", badge) if badge else None, scope="row", data_value=r.label)]
        for _, _, cell in COLUMNS:
            shown, key = cell(r)
            finite = key is not None and math.isfinite(key)
            cells.append(tag("td", shown, data_value=f"{key:.9g}" if finite and key is not None else ""))
        lines.append(tag("tr", cells, class_=None if r.entry else "log"))
    table = tag("table", tag("thead", tag("tr", head)), tag("tbody", lines), class_="sortable", id="score-table")
    text = (
        "Click a heading to sort. Promised: the critic's value of the policy's own actions at the starts of the judged episodes; "
        "delivered: the discounted return that followed. MMD: Gaussian-kernel two-sample distance between (state, logged "
        "action) and (state, policy's action) on 1,024 logged rows; a perfect copy has about 0."
    )
    return join(_scroll(table), _note(text), _published(page))


def _scroll(table: Markup) -> Markup:
    return tag("div", table, class_="scroll", tabindex="0", role="region", aria_label="table, scrolls sideways")


def _published(page: Page) -> Markup | None:
    known = published()
    if page.task_name not in known["tasks"]:
        return None
    head = tag("tr", tag("th", "task", scope="col"), [tag("th", m, scope="col") for m in known["methods"]])
    lines = [
        tag("tr", tag("th", name, scope="row"), [tag("td", score(v)) for v in values], class_="here" if name == page.task_name else None)
        for name, values in known["tasks"].items()
    ]
    table = tag("table", tag("caption", known["title"]), tag("thead", head), tag("tbody", lines), class_="published")
    return tag("aside", _scroll(table), _note(known["source"] + "."))


# ---- charts -----------------------------------------------------------------------------------------------------------


def _learning(page: Page) -> Markup | None:
    unit = _unit(page)
    series = [charts.Series.over_seeds(e.label, page.slot(e), *e.curve(unit)) for e in page.entries if unit in e.evaluations]
    if not series:
        return None
    logs = {e.config["data"]["fingerprint"]: e for e in page.entries}.values()
    worths = [worth for e in logs if (returns := behavior(e)) and (worth := _worth(page, returns))]
    references = [("logged behaviour", worth.mean) for worth in worths]
    references += [("expert", 100.0)] if unit == "score" else []
    both = [
        charts.lines(series, title=f"{unit} against updates", unit=unit, size=size, references=references, labels=wide)
        for wide, size in ((True, (1040, 400)), (False, (480, 360)))
    ]
    return join(
        _legend(page),
        _figure(both[0], class_="wide"),
        _figure(both[1], class_="narrow"),
        _note(f"Mean {unit} over the episodes of each evaluation; line: mean over seeds, band: lowest to highest seed. "
              "All evaluations use the same starts. Click a name to hide an agent in every chart."),
    )  # fmt: skip


def _worth(page: Page, returns: Interval) -> Interval | None:
    return to_score(page.task, returns) if _unit(page) == "score" else returns


def _values(page: Page) -> Markup | None:
    shown = [e for e in page.entries if "estimated_value" in e.evaluations and "discounted_return" in e.evaluations]
    if not shown:
        return None
    figures = []
    for e in shown:
        promised, delivered = e.curve("estimated_value"), e.curve("discounted_return")
        known = np.abs(promised[1][np.isfinite(promised[1])])
        true = np.abs(delivered[1][np.isfinite(delivered[1])])
        far = bool(len(known)) and known.max() > EXPLODED * max(1.0, true.max() if len(true) else 1.0)
        series = [
            charts.Series.over_seeds("promised", page.slot(e), *promised),
            charts.Series.over_seeds("delivered", page.slot(e), *delivered, dashed=True),
        ]
        chart = charts.lines(series, title=f"{e.label}: estimated value and return", unit="discounted return", symlog=far, size=(320, 240))
        figures.append(_figure(chart, e.label, data_agent=page.slot(e)))
    without = [e.label for e in page.entries if e not in shown]
    return join(
        tag("p", "A critic trained on a log never sees what the actions it prefers would bring. Where the solid line (", tag("b", "promised"),
            ": estimated value at the start) runs away from the dashed one (", tag("b", "delivered"), ": Monte-Carlo discounted "
            "return of the same starts), it believes its own guesses; this is Figure 4.1 and A.2 of the thesis."),
        tag("div", figures, class_="charts"),
        _note("Bands: lowest to highest seed. An episode stops at the horizon, the critic's value does not: a policy that stays at the "
              "goal is promised a little more than an episode can deliver. Axes differ between panels."
              + (f" No critic: {', '.join(without)}." if without else "")),
    )  # fmt: skip


def _distance(page: Page) -> Markup | None:
    figures, inside = [], ""
    for name, unit, factor in (("mmd_to_data", "MMD to the log", 1.0), ("outside_range", "% of actions outside the log's range", 100.0)):
        series = []
        for e in page.entries:
            if name in e.evaluations:
                x, y = e.curve(name)
                series.append(charts.Series.over_seeds(e.label, page.slot(e), x, y * factor))
        if name == "outside_range" and series and not any(np.nanmax(s.y, initial=0.0) for s in series):
            inside = "No agent took an action outside the log's range at any evaluation. "
        elif series:
            figures.append(_figure(charts.lines(series, title=f"{unit} against updates", unit=unit)))
    if not figures:
        return None
    return join(
        _legend(page),
        tag("div", figures, class_="charts two"),
        _note(inside + "How far each policy's actions moved from the logged ones at the same states. Imitation stays near zero; an agent that "
              "improves on the log has to leave it somewhat; one that leaves it far has nothing to hold its values to."),
    )  # fmt: skip


def _training(page: Page) -> Markup | None:
    names = list(dict.fromkeys(n for e in page.entries for n in e.metrics if n not in ("step", "seed")))
    figures = []
    for name in names:
        with_it = [e for e in page.entries if name in e.metrics]
        series = [charts.Series.over_seeds(e.label, page.slot(e), *e.curve(name)) for e in with_it]
        values = np.concatenate([np.abs(s.y[np.isfinite(s.y)]) for s in series])
        far = len(values) > 0 and values.max() > EXPLODED and values.max() > 50 * max(float(np.median(values)), 1e-9)
        chart = charts.lines(series, title=f"{name} against updates", unit=METRICS.get(name, ""), symlog=bool(far), size=(320, 220))
        figures.append(_figure(chart, name))
    if not figures:
        return None
    open_ = "open" if page.task_name is None else None
    return tag(
        "details", tag("summary", f"Losses and other metrics ({len(figures)} charts)"), _legend(page),
        tag("div", figures, class_="charts"), _note("Means over the updates of a chunk; bands: lowest to highest seed."), open=open_,
    )  # fmt: skip


def _mazes(page: Page) -> Markup | None:
    task = page.task
    if not isinstance(task, Maze2D):
        return None
    figures = []
    stretches = next((e.segments for e in page.entries if e.segments is not None), None)
    if stretches is not None:
        slots = [i % 8 for i in range(len(stretches))]
        drawn = maze.picture(task, list(stretches), slots, "stretches of the log", False)
        figures.append(_figure(drawn, "the log"))
    for e in page.entries:
        ways = e.trajectories
        if ways is None or not len(ways):
            continue
        ways = list(ways[0][:SHOWN])
        drawn = maze.picture(task, ways, [page.slot(e)] * len(ways), f"{e.label}: {len(ways)} episodes", True)
        figures.append(_figure(drawn, e.label, data_agent=page.slot(e)))
    if not figures:
        return None
    return join(
        tag("div", figures, class_="mazes"),
        _note("From above; x runs down, y to the right. Star: goal, with the circle inside which a step is rewarded. An agent's panel has "
              "the first episodes of the last evaluation (first seed), ring: start, dot: end. The log's has stretches of consecutive "
              "rows, spread evenly over it; there colours tell stretches apart and mean nothing else."),
    )  # fmt: skip


# ---- provenance -------------------------------------------------------------------------------------------------------


def _provenance(page: Page) -> Markup:
    cards = [_run(e) for e in page.entries]
    pairs = provenance.versions(page.entries)
    table = tag("table", [tag("tr", tag("th", name, scope="row"), tag("td", value)) for name, value in pairs], class_="versions")
    return join(
        _note("The numbers on this page come from the run folders below and nowhere else; only the table of published numbers is quoted."),
        tag("div", cards, class_="runs"),
        tag("details", tag("summary", "Versions"), _scroll(table)),
    )


def _run(entry: Entry) -> Markup:
    data, config = entry.config["data"], entry.config
    changed = provenance.settings(entry)
    state = "finished" if entry.status.get("finished") else f"not finished: {entry.status.get('step', 0):,} of {config['steps']:,} updates"
    facts: list[tuple[str, Any]] = [
        ("state", state),
        ("updates", f"{config['steps']:,}, seeds {', '.join(map(str, entry.seeds))}"),
        ("settings", ", ".join(f"{name} = {value}" for name, value in changed.items()) or "all as by default"),
        ("log", f"{data['name']}, {data.get('rows', 0):,} rows, {data.get('episodes', 0):,} episodes"),
        ("fingerprint", tag("code", data["fingerprint"])),
        ("collected with", _made(data.get("provenance") or {})),
        ("warnings", join(*(tag("div", w) for w in data.get("warnings", []))) or "none"),
        ("folder", tag("code", entry.folder.path)),
    ]
    again = provenance.command(entry)
    return tag(
        "article",
        tag("h3", entry.label),
        tag("dl", [join(tag("dt", name), tag("dd", value)) for name, value in facts if value]),
        tag("pre", tag("code", again), tabindex="0", aria_label="command to reproduce"),
    )


def _made(known: dict[str, Any]) -> str:
    parts = [known.get("source"), f"recipe {known['recipe']}" if known.get("recipe") else None]
    parts.append(f"seed {known['seed']}" if known.get("seed") is not None else None)
    parts += [f"{name} {version}" for name, version in (known.get("versions") or {}).items()]
    return ", ".join(str(part) for part in parts if part)
