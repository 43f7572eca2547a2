"""What objects show of themselves in notebooks: the report's own drawings as plain HTML, without scripts."""

import functools
import re
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.told import columns_of
from deadreckon.errors import UserError
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.select import Choice
from deadreckon.report import bars, charts, decision, explained, forest, monitored
from deadreckon.report.entries import Page, read
from deadreckon.report.log import columns_table
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import asset
from deadreckon.report.parts import coded, figure, heads_of, note, scroll, tile
from deadreckon.report.rows import row
from deadreckon.report.text import number
from deadreckon.runs.explain import Explained
from deadreckon.runs.monitor import Monitored
from deadreckon.runs.offline import Judged
from deadreckon.runs.recommend import Recommendation
from deadreckon.runs.run import Run
from deadreckon.stats.interval import PERCENT, Interval, level_in_words

LARGE = 2_000_000  # rows of a log beyond which nothing is counted: a cell should answer at once
_LISTED = 12  # columns of a log, or proposals
_CHARTS = 4  # metrics of a run


def html(thing: Any) -> str | None:
    """One self-contained piece of HTML; None, so that the text is shown, where a run's folder is gone or cannot be read."""
    try:
        return tag("div", tag("style", _style()), _shown(thing), class_="deadreckon")
    except UserError:
        return None


@functools.singledispatch
def _shown(thing: Any) -> Markup:
    raise TypeError(f"nothing is known of {type(thing).__name__}")


@functools.cache
def _style() -> Markup:
    """The page's style for what is inside of a notebook's cell alone."""
    inner = re.sub(r"/\*.*?\*/", "", asset("page.css"), flags=re.S).replace(":root", "&")
    inner = re.sub(r"(?m)^(\s*)body \{", r"\1& {", inner)
    own = "& { margin: 0; padding: 8px 12px; max-width: 980px; border-radius: 8px; font-size: 14px; }"
    return Markup(f".deadreckon {{\n{inner}\n{own} & figure {{ max-width: 480px; }}\n}}")


def _facts(*pairs: tuple[str, Any]) -> Markup:
    return tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in pairs], class_="facts")


def _lines(lines: Any) -> Markup | None:
    return tag("ul", [tag("li", line) for line in lines], class_="caveats") if lines else None


@_shown.register
def _log(log: Dataset) -> Markup:
    facts = [("rows", f"{len(log):,}"), ("episodes", f"{log.episodes:,}"), ("actions", str(log.action_space))]
    facts.append(("observation", "x".join(map(str, log.observations.shape[1:])) + f" {log.observations.dtype}"))
    head = tag("h3", f"Log {log.name}")
    if len(log) > LARGE:
        more = note("Not counted here, since the log is large: ", tag("code", "deadreckon data info"), " does.")
        return join(head, _facts(*facts), _lines(log.warnings), more)
    returns, lengths = log.returns(), log.lengths
    facts += [("mean return", number(float(returns.mean()))), ("steps per episode", f"{lengths.min():,} to {lengths.max():,}")]
    facts.append(("ends", f"{float(np.asarray(log.terminals)[log.ends].mean()):.1%} terminal"))
    drawn = [figure(bars.histogram(returns, "returns of episodes", "episodes"), "Returns (undiscounted sum of rewards)")]
    if lengths.max() > 1:
        drawn.append(figure(bars.histogram(lengths, "lengths of episodes", "episodes"), "Steps per episode"))
    table = columns_table(columns_of(log), _LISTED)
    return join(head, _facts(*facts), _lines(log.warnings), tag("div", drawn, class_="charts"), table)


@_shown.register
def _run(run: Run) -> Markup:
    page = read([run])
    [entry] = page.entries
    facts = [("log", entry.config["data"]["name"]), ("evaluated in", page.task_name or "nothing: no simulator")]
    facts += [("updates", f"{entry.status.get('step', 0):,}"), ("seeds", ", ".join(map(str, entry.seeds)))]
    numbers = row(entry)
    tiles = [
        tile(name, value, False, f"{PERCENT} interval")
        for name, value in (("score", numbers.score), ("return", numbers.returns)) if value is not None
    ]  # fmt: skip
    failed = [f"seed {seed} diverged: {metric} was not finite at update {step:,}" for seed, metric, step in entry.failed]
    wanted = [name for name in ("score", "return", "mmd_to_data") if name in entry.evaluations][:2]
    wanted += [name for name in entry.metrics if name not in ("step", "seed", "environment_steps")][:_CHARTS]
    drawn = []
    for name in wanted:
        series = charts.Series.over_seeds(entry.label, 0, *entry.curve(name, page.online))
        options = {"title": f"{name} against {page.across}", "unit": "", "size": (320, 220), "across": page.across}
        drawn.append(figure(charts.lines([series], **options), name))
    several = note("Line: mean over seeds, band: lowest to highest seed.") if len(entry.seeds) > 1 else None
    head = tag("h3", f"{entry.label}: ", tag("code", run.path))
    pictures = tag("div", drawn, class_="charts")
    return join(head, _facts(*facts), _lines(failed), tag("div", tiles, class_="tiles"), pictures, several)


@_shown.register
def _estimates(found: Estimates) -> Markup:
    marks = [
        forest.Mark(name, i % forest.SLOTS, Interval(float(value), float(low), float(high)))
        for i, (name, value, low, high) in enumerate(zip(found.names, found.value, found.low, found.high))
        if np.isfinite(value)
    ]  # fmt: skip
    drawn = figure(forest.forest(marks, f"{found.estimand}"), f"{found.method}: {found.estimand}") if marks else None
    ess = [] if found.ess is None else ["ESS"]
    body = []
    for i, name in enumerate(found.names):
        low, high = float(found.low[i]), float(found.high[i])
        ends = number(None) if np.isnan(low) else f"[{number(low)}, {number(high)}]"
        cells = [tag("td", tag("b", number(float(found.value[i])))), tag("td", ends)]
        cells += [tag("td", number(float(found.ess[i])))] if found.ess is not None else []
        body.append(tag("tr", tag("th", name, scope="row"), cells))
    table = tag("table", heads_of(["policy", "value", f"{PERCENT} interval", *ess]), tag("tbody", body))
    based = None if found.corrected else note("Model-based: no logged reward corrects an error of the fitted model.")
    return join(drawn, scroll(table), _lines(found.warnings), based)


@_shown.register
def _choice(choice: Choice) -> Markup:
    level = f"{level_in_words(choice.level)} for all policies at once"
    gain = tile("estimated gain over the behaviour policy", Interval(choice.gain, choice.low, choice.high), True, level, number)
    return decision.brief(vars(choice), gain if np.isfinite(choice.gain) else None)


@_shown.register
def _judged(judged: Judged) -> Markup:
    return _card(judged.results)


@_shown.register
def _recommended(found: Recommendation) -> Markup:
    return _card(found.results)


@_shown.register
def _explained(found: Explained) -> Markup:
    return explained.part(found)


@_shown.register
def _monitored(found: Monitored) -> Markup:
    parts = [join(tag("h3", heading), body) for _, heading, body in monitored.sections(found)]
    return join(tag("p", monitored.lead(found), class_="lead"), _facts(*monitored.facts(found)), *parts)


def _card(told: dict[str, Any]) -> Markup:
    return (decision.card(Page((), told)) if told["results"] else None) or decision.brief(told["choice"])


@_shown.register
def _designs(data: Designs) -> Markup:
    scores = data.shown(data.y)
    order = np.argsort(-data.y, kind="stable")[:_LISTED]
    table = data.decode(data.x[order])
    names = list(table)[:_LISTED]
    body = []
    for k, i in enumerate(order.tolist()):
        cells = [tag("td", number(v) if isinstance(v, float) else str(v)) for v in (table[name][k] for name in names)]
        row = tag("th", str(data.numbered(i)), scope="row")
        body.append(tag("tr", row, tag("td", tag("b", number(float(scores[i])))), cells))
    sought = f"{'least' if data.minimise else 'greatest'} {data.target}"
    facts = _facts(("designs", f"{len(data):,}"), ("variables", f"{len(data.variables):,}"), ("sought", sought))
    drawn = figure(bars.histogram(scores, f"values of {data.target}", "designs"), data.target)
    listed = scroll(tag("table", heads_of(["row", data.target, *names]), tag("tbody", body)))
    return join(tag("h3", f"Designs {data.name}"), facts, drawn, listed, note(f"The best {len(order):,} of {len(data):,}."))


@_shown.register
def _proposals(made: Proposals) -> Markup:
    order = np.argsort(-made.predicted, kind="stable")[:_LISTED] if made.predicts else np.arange(min(len(made), _LISTED))
    predicted = -made.predicted if made.minimise else made.predicted  # as the table has them
    variables = min(made.x.shape[1], _LISTED)
    body = []
    for i in order.tolist():
        cells = [tag("td", tag("b", number(float(predicted[i])))), tag("td", number(float(made.predicted_std[i])))]
        cells += [tag("td", number(float(value))) for value in made.x[i, :variables]]
        body.append(tag("tr", tag("th", str(i), scope="row"), cells))
    how, what = made.how, "predictions" if made.how == "predicted" else f"{made.how} scores"
    head = heads_of(["design", how, "standard deviation", *(f"variable {k}" for k in range(variables))])
    best = "lowest" if made.minimise else "highest"
    which = f"those with the {best} {what} first" if made.predicts else "in the order in which they were proposed"
    text = f"{len(order):,} of {len(made):,}, {which}, as the data holds them; `decode` of the data gives names and categories."
    scores = f"{how} scores"
    drawn = figure(bars.histogram(predicted, scores, "designs"), scores.capitalize()) if made.predicts else None
    table = scroll(tag("table", head, tag("tbody", body)))
    return join(tag("h3", f"{len(made):,} designs by {made.method}"), drawn, table, note(coded(text)))
