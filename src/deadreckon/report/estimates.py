"""What the policies were estimated at from the log alone, beside what they are truly worth where a simulator tells."""

import math
from typing import Any

from deadreckon.ope.estimates import LOGGED
from deadreckon.report import charts
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import coloured, figure, heads_of, note, scroll
from deadreckon.report.text import number, percent
from deadreckon.stats.interval import NORMAL, PERCENT, level_in_words


def section(page: Page) -> Markup | None:
    """A chart of estimate against truth for each method, and the table of all estimates."""
    told = page.estimates
    if told is None:
        return None
    truth, level = told["truth"], level_in_words(told["choice"]["level"])
    how = note(
        f"Values: {told['estimand']['words']}; {PERCENT} intervals, each on its own. Gains: over the behaviour policy, "
        f"estimated by the same method on the same episodes, with intervals of {level} for all policies at once; the first "
        "method decides. ",
        "ESS: effective sample size, the number of equally weighted episodes that the weights amount to. "
        if any(each["effective"] for each in told["results"]) else None,
        "Without support: the share of a policy's actions, in states of the log, that the behaviour policy hardly takes. "
        "Arrows: an interval continues beyond its chart. Model-based: no logged reward corrects the model's errors. ",
        f"True values are means of {truth['episodes']} episodes, in the charts with {PERCENT} intervals." if truth else None,
    )  # fmt: skip
    drawn = None
    if truth:
        named = coloured(page, told)
        legend = charts.keys(list(dict.fromkeys(named)), "estimate = true value")
        slots = [slot for _, slot in named]
        drawn = join(legend, tag("div", [_scatter(told, each, slots) for each in told["results"]], class_="charts two"))
    return join(drawn, scroll(_table(told)), how)


def _scatter(told: dict[str, Any], result: dict[str, Any], slots: list[int]) -> Markup:
    truth = told["truth"]
    points: list[Any] = []  # of as many numbers as `scatter` takes, which the type of `*ends` does not say
    for i, each in enumerate(told["policies"]):
        ends = (result[end][i] for end in ("value", "low", "high"))
        points.append((each["name"], slots[i], truth["mean"][i], NORMAL * truth["error"][i], *ends))
    return figure(charts.scatter(points, "true value", "estimate"), f"{result['method']}: estimate against true value")


def _table(told: dict[str, Any]) -> Markup:
    truth, results, choice = told["truth"], told["results"], told["choice"]
    heads = ["policy", *(["true value"] if truth else [])]
    for each in results:
        heads += [each["method"], "gain", *(["ESS"] if each["effective"] else [])]
    heads += ["without support", "objections"]
    rows = []
    names = [each["name"] for each in told["policies"]] + [LOGGED]
    for i, name in enumerate(names):
        known = i < len(told["policies"])
        badge = None if known else "made the log"
        if name == choice["name"]:
            badge = "deploy" if choice["deploy"] else "best candidate"
        cells = [tag("th", name, tag("small", badge) if badge else None, scope="row")]
        if truth:
            cells.append(_true(truth["mean"][i], truth["error"][i]) if known else tag("td", number(None)))
        for each in results:
            cells.append(_range(each["value"][i], each["low"][i], each["high"][i]))
            cells.append(_range(*each["gain"][i], signed=True) if i < len(each["gain"]) else tag("td", number(None)))
            cells += [tag("td", number(each["effective"][i]))] if each["effective"] else []
        cells.append(tag("td", percent(told["support"]["missing"][i] if known else None)))
        own = choice["objections"][i] if known else []
        said = [tag("small", line) for line in own] if own else tag("small", "none" if known else number(None))
        rows.append(tag("tr", cells, tag("td", said, class_="text"), class_=None if known else "log"))
    return tag("table", heads_of(heads), tag("tbody", rows))


def _true(value: float, error: float) -> Markup:
    return tag("td", tag("b", number(value)), tag("small", f"standard error {number(error)}"))


def _range(value: float | None, low: float | None, high: float | None, signed: bool = False) -> Markup:
    """A number with its ends, of which one or both may be endless."""
    ends = None
    if low is not None and high is not None and not math.isnan(low):
        beyond = lambda end: ("\N{MINUS SIGN}" if end < 0 else "") + "\N{INFINITY}"  # noqa: E731
        shown = (number(end, signed=signed) if math.isfinite(end) else beyond(end) for end in (low, high))
        ends = tag("small", f"[{', '.join(shown)}]")
    return tag("td", tag("b", number(value, signed=signed)), ends)
