"""The decision card."""

import math

from deadreckon.report import charts
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import figure, note, unit_of
from deadreckon.report.rows import Difference, rows
from deadreckon.report.text import brackets, score
from deadreckon.report.verdict import Verdict
from deadreckon.runs.evaluate import Interval


def decision(page: Page, found: Verdict) -> Markup:
    """What to do, by how much it is better, why, and what that does not show."""
    best = found.best
    unit = unit_of(page)
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
    lines = [tag("p", line) for line in found.beaten]
    why = tag("div", tag("h3", "What beats imitation, and why"), lines, class_="why") if lines else None
    how = note(
        "Numbers are means over seeds and episodes of the last evaluation; brackets are 95 % intervals, in which both seeds "
        "and episodes count as chance. Differences between agents are paired: episode i starts alike for all. "
        + (f"The logged behaviour's worth is the {_how(page)}; its own uncertainty is in the difference." if found.log else "")
    )
    limits = tag("div", tag("h3", "What this does not show"), _caveats(found))
    lower = tag("div", why, limits, class_="split lower" if why else "lower")
    return tag(
        "div", tag("div", tag("div", text), _forest(page), class_="split"), lower, how,
        class_=f"card {kind}",
    )  # fmt: skip


def _how(page: Page) -> str:
    known = [str(e.behavior["how"]) for e in page.entries if e.behavior and e.behavior.get("how")]
    return known[0] if known else "return found in the log"


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
    unit = unit_of(page)
    bars = []
    for r in rows(page):
        spread = r.score if unit == "score" else r.returns
        if spread and math.isfinite(spread.mean):
            bars.append((r.label, page.slot(r.entry) if r.entry else None, spread))
    if not bars:
        return None
    return figure(charts.forest(bars, unit, [("expert", 100.0)] if unit == "score" else []))
