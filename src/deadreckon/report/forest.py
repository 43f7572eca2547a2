"""Values with their intervals: a row each (forest plots and bars)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deadreckon.report.axes import LETTERS, Axis, columns, cut, svg
from deadreckon.report.markup import Markup, tag
from deadreckon.report.text import number
from deadreckon.stats.interval import Interval

_SHAPES = (
    "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z", "M-3.5-3.5H3.5V3.5H-3.5Z", "M0-4.6L4.4 3.4H-4.4Z", "M0-5L5 0L0 5L-5 0Z",
    "M0 4.6L4.4-3.4H-4.4Z", "M-4.5-1.5H-1.5V-4.5H1.5V-1.5H4.5V1.5H1.5V4.5H-1.5V1.5H-4.5Z", "M-4.5-2.5H4.5V2.5H-4.5Z",
    "M-2.5-4.5H2.5V4.5H-2.5Z",
)  # fmt: skip
SLOTS = len(_SHAPES)  # colours with their shapes, beyond which they are used again


def marker(slot: int, x: float, y: float) -> Markup:
    """The shape that goes with a colour, so that colour alone never tells agents apart."""
    return tag("path", d=_SHAPES[slot], transform=f"translate({x:.1f} {y:.1f})", class_="marker")


class Mark(NamedTuple):
    """A row of `forest`.

    Attributes:
        name: on the left.
        slot: colour; None: the behaviour policy.
        spread: mean and interval, whose ends may be infinite.
        dots: values that the mean is of, such as seeds'.
        hollow: something speaks against it.
    """

    name: str
    slot: int | None
    spread: Interval
    dots: Sequence[float] = ()
    hollow: bool = False


def forest(marks: Sequence[Mark], unit: str, references: Sequence[tuple[str, float]] = ()) -> Markup:
    """Means with their intervals, one under another, and named upright lines. What is much wider ends in arrows."""
    width, row, top, left, right = 480, 30, 24, 140, 462
    height = top + row * len(marks) + 26
    points = [v for m in marks for v in (m.spread.value, *m.dots)] + [v for _, v in references]
    x = Axis(*robust(points, [m.spread for m in marks]), left, right)
    parts = columns(x, top, height)
    for name, value in references:
        at = float(x(value))
        parts.append(tag("line", x1=f"{at:.1f}", x2=f"{at:.1f}", y1=top - 4, y2=height - 24, class_="reference"))
        half = 3.4 * len(name)
        parts.append(tag("text", name, x=f"{min(max(at, half), width - half):.1f}", y=13, class_="name mid"))
    for k, mark in enumerate(marks):
        y, spread = top + row * (k + 0.5), mark.spread
        ends = f" [{number(spread.low)}, {number(spread.high)}]" if not math.isnan(spread.low) else ""
        inner = [tag("title", f"{mark.name}: {number(spread.value)}{ends}")]
        inner.append(tag("text", _inner_cut(mark.name), x=left - 12, y=y + 4.5, class_="label end"))
        inner += whisker(x, spread.low, spread.high, y)
        if len(mark.dots) > 1:
            inner += [tag("circle", cx=f"{x(v):.1f}", cy=y + 8, r=2.2, class_="seed") for v in mark.dots if math.isfinite(v)]
        inner.append(marker(mark.slot or 0, float(x(spread.value)), y))
        colour = "log" if mark.slot is None else f"s{mark.slot}"
        parts.append(tag("g", inner, class_=f"{colour} hollow" if mark.hollow else colour))
    return svg(parts, width, height, unit, f"chart v{width}")


def robust(points: Sequence[float], spreads: Sequence[Interval]) -> tuple[float, float]:
    """Least and greatest value to draw: all points, and the ends of intervals that are not much further out than the others'.

    One interval from two seeds, a hundred times as wide as the rest, would leave the rest no room to differ.
    """
    points = [v for v in points if math.isfinite(v)] or [0.0]
    low, high = min(points), max(points)
    halves = [(s.high - s.low) / 2 for s in spreads if math.isfinite(s.low) and math.isfinite(s.high)]
    room = max(high - low, 1.5 * float(np.median(halves)) if halves else 0.0) or 0.5 * abs(high) or 1.0
    ends = [v for s in spreads for v in (s.low, s.high) if not math.isnan(v)]
    return max(low - room, min([low, *ends])), min(high + room, max([high, *ends]))


def whisker(axis: Axis, low: float, high: float, at: float, upright: bool = False) -> list[Markup]:
    """A line between two ends, with an arrow where an end is beyond the axis; nothing where there is no interval."""
    if math.isnan(low) or math.isnan(high):
        return []
    inside = sorted((axis.start, axis.end))
    ends = [min(max(float(axis(end)), inside[0]), inside[1]) for end in (low, high)]
    line = dict(x1=at, x2=at, y1=f"{ends[0]:.1f}", y2=f"{ends[1]:.1f}") if upright else dict(
        x1=f"{ends[0]:.1f}", x2=f"{ends[1]:.1f}", y1=at, y2=at
    )  # fmt: skip
    parts = [tag("line", **line, class_="whisker")]
    for end, pixel, sign in ((low, ends[0], -1), (high, ends[1], 1)):
        if abs(float(axis(end)) - pixel) > 0.5:
            turn = (-90 if sign > 0 else 90) if upright else (0 if sign > 0 else 180)
            place = f"{at:.1f} {pixel:.1f}" if upright else f"{pixel:.1f} {at:.1f}"
            parts.append(tag("path", d="M0-5.5L9 0L0 5.5Z", transform=f"translate({place}) rotate({turn})", class_="arrow"))
    return parts


def _inner_cut(name: str) -> str:
    """A name that keeps its end, which tells seeds apart."""
    return name if len(name) <= LETTERS + 2 else f"{name[: LETTERS - 6]}\N{HORIZONTAL ELLIPSIS}{name[-7:]}"


def bars(rows: Sequence[tuple[str, int, Interval, float | None]], unit: str) -> Markup:
    """Bars from zero, one under another, with whiskers and a tick where somebody else's value lies.

    Args:
        rows: name, colour, mean with ends, and the other value, each.
        unit: of the axis, for screen readers.
    """
    width, row, top, left, right = 480, 26, 10, 128, 466
    height = top + row * len(rows) + 26
    x = Axis(*_ends(rows), left, right)
    parts = columns(x, top, height)
    for k, (name, slot, spread, other) in enumerate(rows):
        y = top + row * (k + 0.5)
        inner = [tag("title", f"{name}: {number(spread.value)}")]
        inner.append(tag("text", cut(name), x=left - 14, y=y + 4.5, class_="label end"))
        if math.isfinite(spread.value):
            a, b = sorted((float(x(0.0)), float(x(spread.value))))
            inner.append(tag("rect", x=f"{a:.1f}", y=y - 8, width=f"{b - a:.1f}", height=16, rx=2, class_="bar"))
            inner.append(tag("line", x1=f"{x(spread.low):.1f}", x2=f"{x(spread.high):.1f}", y1=y, y2=y, class_="whisker"))
        if other is not None:
            inner.append(tag("line", x1=f"{x(other):.1f}", x2=f"{x(other):.1f}", y1=y - 11, y2=y + 11, class_="other"))
        parts.append(tag("g", inner, class_=f"s{slot}"))
    return svg(parts, width, height, unit, f"chart v{width}")


def _ends(rows: Sequence[tuple[str, int, Interval, float | None]]) -> tuple[float, float]:
    values = [v for _, _, i, other in rows for v in (i.low, i.high, i.value, other) if v is not None and math.isfinite(v)]
    return min([0.0, *values]), max([0.0, *values])
