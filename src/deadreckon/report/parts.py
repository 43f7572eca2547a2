"""Pieces that several sections share."""

from collections.abc import Callable, Iterable
from typing import Any

from deadreckon.report import charts
from deadreckon.report.entries import Page
from deadreckon.report.forest import SLOTS
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.text import NONE, brackets, score
from deadreckon.runs.decision_record import is_from
from deadreckon.stats.interval import Interval


def note(*text: Any) -> Markup:
    """A paragraph that explains."""
    return tag("p", *text, class_="note")


def coded(text: str) -> list[Any]:
    """Text whose parts between backquotes are commands."""
    return [tag("code", part) if i % 2 else part for i, part in enumerate(text.split("`"))]


def breakable(text: str) -> Markup:
    """Text that may be broken after underscores, which names of columns have in place of spaces."""
    parts = text.split("_")
    return join(*(join(part, "_", tag("wbr")) for part in parts[:-1]), parts[-1])


def figure(chart: Markup, caption: str | None = None, **attributes: Any) -> Markup:
    """A chart with its caption."""
    return tag("figure", tag("figcaption", caption) if caption else None, chart, **attributes)


def legend(page: Page) -> Markup:
    """Buttons for all agents of the page."""
    return charts.legend([(e.label, page.slot(e)) for e in page.entries])


def unit_of(page: Page) -> str:
    """What a policy's worth is counted in."""
    return "score" if any("score" in e.evaluations for e in page.entries) else "return"


def scroll(table: Markup) -> Markup:
    """A table that scrolls by itself where the page is narrow, and says so there."""
    hint = tag("p", "more columns: scroll sideways \N{RIGHTWARDS ARROW}", class_="hint", aria_hidden="true")
    inner = tag("div", table, class_="scroll", tabindex="0", role="region", aria_label="table, scrolls sideways")
    return tag("div", hint, inner, class_="scrolls")


def tile(
    name: str, value: Interval | None, signed: bool, more: str | None = None, shown: Callable[..., str] | None = None
) -> Markup:
    """A number with its interval, its name above and more below."""
    if value is None:
        return tag("div", tag("small", name), tag("b", NONE), class_="tile")
    ends = brackets(value, signed=signed, shown=shown)
    number = score(value, signed=signed) if shown is None else shown(value.value, signed=signed)
    small = tag("small", more) if more else None
    return tag("div", tag("small", name), tag("b", number), tag("span", ends), small, class_="tile")


def coloured(page: Page, told: dict[str, Any]) -> list[tuple[str, int]]:
    """Of each policy that was estimated its run and colour: those of the page, or the run's name and a colour that is left."""
    of = [
        next((e for e in page.entries if any(is_from(each, folder.path) for folder, _ in e.folders)), None)
        for each in told["policies"]
    ]
    others = dict.fromkeys(each["run"] for each, e in zip(told["policies"], of) if e is None)
    left = {run: (len(page.entries) + i) % SLOTS for i, run in enumerate(others)}
    return [(each["run"], left[each["run"]]) if e is None else (e.label, page.slot(e)) for each, e in zip(told["policies"], of)]


def heads_of(names: Iterable[str]) -> Markup:
    """A table's head; names such as MB-FF stay on one line."""
    return tag("thead", tag("tr", [tag("th", name, scope="col", class_="whole") for name in names]))
