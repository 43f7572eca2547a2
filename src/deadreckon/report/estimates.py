"""What the policies were estimated at from the log alone, and whether the simulator agrees."""

import math
from typing import Any

from deadreckon.ope.coverage import LEVEL
from deadreckon.ope.estimate import LOGGED
from deadreckon.report import charts
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number, percent
from deadreckon.runs.offline import checked


def section(page: Page) -> Markup | None:
    """The card, a chart of estimate against truth for each method, and the table of all estimates."""
    told = page.estimates
    if told is None:
        return None
    choice, truth = told["choice"], told["truth"]
    stamp = ("Deploy", "yes") if choice["deploy"] else ("Do not deploy", "no")
    more = [tag("li", line) for line in (*choice["evidence"], *choice["warnings"])]
    card = tag(
        "div",
        tag("p", tag("strong", stamp[0], class_=f"stamp {stamp[1]}"), tag("span", choice["name"], class_="which")),
        tag("p", f"From the log alone: {choice['reason']}.", class_="because"),
        tag("ul", more, class_="caveats") if more else None,
        tag("p", f"Checked: {checked(told)}."),
        class_=f"card {stamp[1]}",
    )
    manner = "best guesses" if told["greedy"] else "draws"
    how = note(
        f"Values are discounted returns (factor {told['discount']:g}) of the policies' {manner}, with 95 % intervals. "
        "Gains are over the log's own policy, judged by the same method from the same redraws, at a level that holds for all "
        "policies at once. Chosen, among those that mostly do what the log shows, is the gain with the highest lower end (of "
        "few members: the highest gain). Within the log: the share of a policy's actions, in states of the log, that are "
        f"as likely there as all but the least likely {100 - 100 * LEVEL:.0f} % of the log's own. "
        + (f"True values are means of {truth['episodes']} episodes." if truth else "")
    )
    drawn = tag("div", [_scatter(page, told, each) for each in told["results"]], class_="charts two") if truth else None
    return join(card, drawn, scroll(_table(told)), how)


def _scatter(page: Page, told: dict[str, Any], result: dict[str, Any]) -> Markup:
    slots = {folder.path.name: page.slot(e) for e in page.entries for folder, _ in e.folders}
    truth = told["truth"]
    points = []
    for i, each in enumerate(told["policies"]):
        across = truth["mean"][i], 1.96 * truth["error"][i]
        points.append((each["name"], slots.get(each["run"], 0), *across, *(result[end][i] for end in ("value", "low", "high"))))
    return figure(charts.scatter(points, "true value", "estimate"), f"{result['method']}: estimate against truth")


def _table(told: dict[str, Any]) -> Markup:
    truth, results = told["truth"], told["results"]
    heads = ["policy", *(["true value"] if truth else []), "within the log"]
    for each in results:
        heads += [each["method"], "gain"]
    rows = []
    names = [each["name"] for each in told["policies"]] + [LOGGED]
    for i, name in enumerate(names):
        cells = [tag("th", name, tag("small", "chosen") if name == told["choice"]["name"] else None, scope="row")]
        if truth:
            known = i < len(truth["mean"])
            cells.append(_cell(truth["mean"][i] if known else math.nan, truth["error"][i] if known else None))
        cells.append(tag("td", percent(told["covered"][i] if i < len(told["covered"]) else None)))
        for each in results:
            cells.append(_range(each["value"][i], each["low"][i], each["high"][i]))
            cells.append(_range(*each["gain"][i]) if i < len(each["gain"]) else tag("td", number(None)))
        rows.append(tag("tr", cells))
    head = heads_of(heads)
    return tag("table", head, tag("tbody", rows))


def _cell(value: float, error: float | None) -> Markup:
    half = None if error is None else tag("small", f"\N{PLUS-MINUS SIGN}{number(error)}")
    return tag("td", tag("b", number(value)), half)


def _range(value: float, low: float, high: float) -> Markup:
    ends = f"[{number(low)}, {number(high)}]" if math.isfinite(low) else None
    return tag("td", tag("b", number(value)), tag("small", ends) if ends else None)
