"""Pieces that several sections share."""

from collections.abc import Iterable
from typing import Any

from deadreckon.report import charts
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, tag


def note(*text: Any) -> Markup:
    """A paragraph that explains."""
    return tag("p", *text, class_="note")


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
    """A table that scrolls by itself where the page is narrow."""
    return tag("div", table, class_="scroll", tabindex="0", role="region", aria_label="table, scrolls sideways")


def heads_of(names: Iterable[str]) -> Markup:
    """A table's head; names such as MB-FF stay on one line."""
    return tag("thead", tag("tr", [tag("th", name, scope="col", class_="whole") for name in names]))
