"""Charts as inline SVG: colours are CSS variables, so that both themes and print need nothing else; hover is in page.js."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.report.axes import LABEL, POINTS, Axis, cut, levels, path, svg
from deadreckon.report.forest import marker, robust, whisker
from deadreckon.report.markup import Markup, tag
from deadreckon.report.text import number
from deadreckon.stats.interval import Interval


@dataclass(frozen=True)
class Series:
    """A line with its band.

    Attributes:
        name: as the tooltip shows it.
        slot: colour.
        x: (n,) updates or environment steps.
        y: (n,) values; not finite where the line breaks.
        low: (n,) lower end of the band, or None.
        high: (n,) upper end.
        dashed: drawn so.
    """

    name: str
    slot: int
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    dashed: bool = False

    @classmethod
    def over_seeds(cls, name: str, slot: int, x: np.ndarray, values: np.ndarray, dashed: bool = False) -> "Series":
        """Mean, least and greatest of (n, seeds) values; seeds that are not finite are left out."""
        if len(x) > POINTS:
            keep = np.unique(np.linspace(0, len(x) - 1, POINTS).astype(int))
            x, values = x[keep], values[keep]
        good = np.isfinite(values)
        some = good.any(1)
        mean = np.where(some, np.where(good, values, 0).sum(1) / np.maximum(good.sum(1), 1), np.nan)
        low = np.where(some, np.where(good, values, np.inf).min(1, initial=np.inf), np.nan)
        high = np.where(some, np.where(good, values, -np.inf).max(1, initial=-np.inf), np.nan)
        banded = values.shape[1] > 1
        return cls(name, slot, x, mean, low if banded else None, high if banded else None, dashed)


def lines(
    series: Sequence[Series],
    *,
    title: str,
    unit: str,
    size: tuple[int, int] = (480, 300),
    references: Sequence[tuple[str, float]] = (),
    symlog: bool = False,
    labels: bool = False,
    across: str = "updates",
    ticks: int | None = None,
) -> Markup:
    """Lines over updates, or whatever `across` names.

    Args:
        series: what to draw.
        title: read by screen readers.
        unit: of the vertical axis, written above it.
        size: of the drawing.
        references: named horizontal lines.
        symlog: a symmetric logarithmic vertical axis.
        labels: names at the lines' ends instead of a legend.
        across: unit of the horizontal axis.
        ticks: most numbers along it; None: 4, which leaves room for long ones, or 7 on a wide drawing.
    """
    width, height = size
    bottom, left, top = height - 38, 52, 30
    right = width - (136 if labels else 14)
    finite = [v[np.isfinite(v)] for s in series for v in (s.y, s.low, s.high) if v is not None]
    values = np.concatenate([*finite, [value for _, value in references]]) if finite else np.zeros(0)
    steps = np.concatenate([s.x for s in series]) if series else np.zeros(0)
    if not len(values) or not len(steps):
        return tag("p", "nothing finite to draw", class_="empty")
    # What cannot be negative is shown from zero on, so that small differences do not look large.
    floor = min(float(values.min()), 0.0) if values.min() >= 0 or symlog else float(values.min())
    y = Axis(floor, float(values.max()), bottom, top, symlog)
    x = Axis(min(0.0, float(steps.min())), float(steps.max()), left, right, most=ticks or (7 if width > 600 else 4))
    parts = levels(y, left, right)
    parts += [tag("text", x.label(t), x=f"{x(t):.1f}", y=bottom + 19, class_="tick mid") for t in x.ticks]
    parts.append(tag("text", across, x=right, y=bottom + 34, class_="axis end"))
    parts.append(
        tag("text", ", ".join(filter(None, (unit, "symmetric log scale" if symlog else ""))), x=4, y=14, class_="axis")
    )
    places = [_end(x, y, s) for s in series]
    ends = _spread([*places, *((right, float(y(value))) for _, value in references)], top, bottom)
    for (name, value), end in zip(references, ends[len(series) :]):
        parts.append(tag("line", x1=left, x2=right, y1=f"{y(value):.1f}", y2=f"{y(value):.1f}", class_="reference"))
        beside = {"x": right + 11, "y": f"{end + 4:.1f}"} if labels else {"x": left + 6, "y": f"{y(value) - 5:.1f}"}
        parts.append(tag("text", name, class_="name", **beside))
    hover = []
    for s, end in zip(series, ends):
        px, py = x(s.x), y(s.y)
        inner = []
        if s.low is not None and s.high is not None:
            good = (np.isfinite(s.low) | np.isfinite(s.high)) & ~np.isnan(s.low) & ~np.isnan(s.high)
            heights = np.concatenate([y(s.high[good]), y(s.low[good])[::-1]])
            # An infinite end lies beyond the chart: the band is drawn to its edge.
            around = np.concatenate([px[good], px[good][::-1]]), np.clip(heights, top, bottom)
            inner.append(tag("path", d=path(*around, closed=True), class_="band"))
        inner.append(tag("path", d=path(px, py), class_="line dashed" if s.dashed else "line"))
        good = np.flatnonzero(np.isfinite(py))
        if len(good):
            inner.append(marker(s.slot, float(px[good[-1]]), float(py[good[-1]])))
            if labels:
                inner.append(tag("text", cut(s.name), x=f"{px[good[-1]] + 11:.1f}", y=f"{end + 4:.1f}", class_="label"))
        parts.append(tag("g", inner, class_=f"s{s.slot}", data_agent=s.slot))
        tips = [[round(float(px[i]), 1), round(float(py[i]), 1), f"{s.x[i]:,.0f}", number(float(s.y[i]))] for i in good]
        hover.append({"n": s.name, "c": s.slot, "p": tips})
    parts.append(tag("line", y1=top, y2=bottom, class_="cursor", visibility="hidden"))
    told = {"data_hover": json.dumps(hover, separators=(",", ":")), "data_across": across}
    return svg(parts, width, height, title, f"chart v{width}", **told)


def _end(x: Axis, y: Axis, s: Series) -> tuple[float, float]:
    """Where a line ends."""
    good = np.flatnonzero(np.isfinite(s.y))
    return (float(x(s.x[good[-1]])), float(y(s.y[good[-1]]))) if len(good) else (math.nan, math.nan)


def _spread(places: Sequence[tuple[float, float]], top: float, bottom: float) -> list[float]:
    """Heights of labels, moved apart where they would cover one another, in their order."""
    out = [place for _, place in places]
    order = sorted((i for i, place in enumerate(out) if math.isfinite(place)), key=lambda i: out[i])
    for sign, way in ((1.0, order), (-1.0, order[::-1])):
        done: list[int] = []
        for i in way:
            near = [sign * out[j] + LABEL[1] for j in done if abs(places[i][0] - places[j][0]) < LABEL[0]]
            out[i] = sign * max([sign * out[i], sign * (top if sign > 0 else bottom), *near])
            done.append(i)
    return out


def keys(names: Sequence[tuple[str, int]], line: str | None = None) -> Markup:
    """What colours and shapes mean, and a dotted line, beside charts that nothing is hidden in."""
    shown = []
    if line is not None:
        drawn = tag("svg", tag("path", d="M0 7H26", class_="reference"), viewBox="0 0 26 14")
        shown.append(tag("span", drawn, line, class_="key"))
    for name, slot in names:
        shown.append(tag("span", tag("svg", marker(slot, 13, 7), viewBox="0 0 26 14", class_=f"s{slot}"), name, class_="key"))
    return tag("div", shown, class_="keys")


def legend(names: Sequence[tuple[str, int]]) -> Markup:
    """Buttons that hide an agent in every chart."""
    buttons = []
    for name, slot in names:
        line = tag("path", d="M0 7H26", class_="line")
        swatch = tag("svg", line, marker(slot, 13, 7), viewBox="0 0 26 14", class_=f"s{slot}")
        buttons.append(tag("button", swatch, name, type="button", data_toggle=slot, aria_pressed="true", class_="key"))
    return tag("div", buttons, class_="legend", role="group", aria_label="show or hide agents")


def scatter(
    points: Sequence[tuple[str, int, float, float, float, float, float]], across: str, unit: str, diagonal: bool = True,
    references: Sequence[tuple[str, float]] = (),
) -> Markup:  # fmt: skip
    """Points with whiskers both ways, and the diagonal on which both axes agree. What is much wider ends in arrows.

    Args:
        points: name, colour, and x with its half-width, and y with its lower and upper end, each.
        across: unit of the horizontal axis.
        unit: of the vertical one, written above it.
        diagonal: whether both axes measure the same.
        references: named vertical lines.
    """
    width, height, left, right, top, bottom = 480, 340, 58, 462, 30, 302
    finite = [p for p in points if math.isfinite(p[2]) and math.isfinite(p[4])]
    if not finite:
        return tag("p", "nothing finite to draw", class_="empty")
    wide = [Interval(p[2], p[2] - p[3], p[2] + p[3]) for p in finite]
    wide += [Interval(value, value, value) for _, value in references]
    x = Axis(*robust([*(p[2] for p in finite), *(value for _, value in references)], wide), left, right)
    y = Axis(*robust([p[4] for p in finite], [Interval(*p[4:]) for p in finite]), bottom, top)
    parts = levels(y, left, right)
    parts += [tag("text", x.label(t), x=f"{x(t):.1f}", y=bottom + 19, class_="tick mid") for t in x.ticks]
    parts.append(tag("text", across, x=right, y=bottom + 34, class_="axis end"))
    parts.append(tag("text", unit, x=4, y=14, class_="axis"))
    both = max(x.low, y.low), min(x.high, y.high)
    if diagonal and both[0] < both[1]:
        where = {f"{axis}{i + 1}": f"{of(v):.1f}" for i, v in enumerate(both) for axis, of in (("x", x), ("y", y))}
        parts.append(tag("line", **where, class_="reference"))
    for i, (name, value) in enumerate(references):
        at, late = float(x(value)), x(value) > (left + right) / 2
        parts.append(tag("line", x1=f"{at:.1f}", x2=f"{at:.1f}", y1=top, y2=bottom, class_="reference"))
        place = {"x": f"{at + (-5 if late else 5):.1f}", "y": bottom - 6 - 16 * i}
        parts.append(tag("text", name, class_="name end" if late else "name", **place))
    for name, slot, across_value, half, value, lower, upper in finite:
        px, py = float(x(across_value)), float(y(value))
        ends = f" [{number(lower)}, {number(upper)}]" if not math.isnan(lower) else ""
        inner = [tag("title", f"{name}: {unit} {number(value)}{ends}, {across} {number(across_value)}")]
        inner += whisker(x, across_value - half, across_value + half, py)
        inner += whisker(y, lower, upper, px, upright=True)
        inner.append(marker(slot, px, py))
        parts.append(tag("g", inner, class_=f"s{slot}"))
    return svg(parts, width, height, f"{unit} against {across}", f"chart v{width}")
