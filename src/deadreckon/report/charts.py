"""Charts as inline SVG: colours are CSS variables, so that both themes and print need nothing else; hover is in page.js."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.text import number
from deadreckon.stats.interval import Interval

POINTS = 240  # most points of a line
LABEL = 110, 16  # width and height that a name beside a line may take
LETTERS = 15  # of such a name; tooltips and legends have it all


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


class _Axis:
    """Values to pixels, linear or symmetric-logarithmic (linear within ±1), with readable ticks."""

    def __init__(self, low: float, high: float, start: float, end: float, symlog: bool = False, most: int = 6):
        if not (math.isfinite(low) and math.isfinite(high)):
            low, high = 0.0, 1.0
        if high - low < 1e-12 * max(abs(low), abs(high), 1e-9):
            low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
        self.symlog = symlog
        self.start, self.end = start, end
        a, b = float(self._bend(low)), float(self._bend(high))
        pad = 0.04 * (b - a)
        self.low, self.high = a - (pad if low else 0.0), b + pad
        self.ticks = _decades(low, high) if symlog else _nice(low, high, most)

    def _bend(self, value: np.ndarray | float) -> np.ndarray:
        value = np.asarray(value, float)
        return np.sign(value) * np.log10(1 + np.abs(value)) if self.symlog else value

    def __call__(self, value: np.ndarray | float) -> np.ndarray:
        return self.start + (self._bend(value) - self.low) / (self.high - self.low) * (self.end - self.start)


def _nice(low: float, high: float, most: int) -> list[float]:
    raw = (high - low) / (most - 1)
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(m * size for m in (1, 2, 2.5, 5, 10) if m * size >= raw * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


def _decades(low: float, high: float) -> list[float]:
    top = max(abs(low), abs(high), 1.0)
    every = max(1, math.ceil(math.log10(top) / 4))
    sizes = [10.0**k for k in range(0 if every == 1 else every, math.ceil(math.log10(top)) + 1, every)]
    return [t for t in [*(-s for s in reversed(sizes)), 0.0, *sizes] if low <= t <= high]


def _short(value: float) -> str:
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if size <= abs(value) < 1e12:
            return f"{value / size:g}{unit}".replace("-", "\N{MINUS SIGN}")
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}").replace("e+", "e")


def _cut(name: str) -> str:
    return name if len(name) <= LETTERS else f"{name[: LETTERS - 1]}\N{HORIZONTAL ELLIPSIS}"


def _path(x: np.ndarray, y: np.ndarray, closed: bool = False) -> str:
    out, pen = [], False
    for a, b in zip(x, y):
        good = math.isfinite(a) and math.isfinite(b)
        if good:
            out.append(f"{'L' if pen else 'M'}{a:.1f} {b:.1f}")
        pen = good
    return "".join(out) + ("Z" if closed and out else "")


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
    y = _Axis(floor, float(values.max()), bottom, top, symlog)
    x = _Axis(min(0.0, float(steps.min())), float(steps.max()), left, right, most=ticks or (7 if width > 600 else 4))
    parts = [tag("title", title)]
    parts += [
        join(
            tag("line", x1=left, x2=right, y1=f"{y(t):.1f}", y2=f"{y(t):.1f}", class_="grid"),
            tag("text", _short(t), x=left - 7, y=f"{y(t) + 4:.1f}", class_="tick end"),
        )
        for t in y.ticks
    ]
    parts += [tag("text", _short(t), x=f"{x(t):.1f}", y=bottom + 19, class_="tick mid") for t in x.ticks]
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
            good = np.isfinite(s.low) & np.isfinite(s.high)
            around = np.concatenate([px[good], px[good][::-1]]), np.concatenate([y(s.high[good]), y(s.low[good])[::-1]])
            inner.append(tag("path", d=_path(*around, closed=True), class_="band"))
        inner.append(tag("path", d=_path(px, py), class_="line dashed" if s.dashed else "line"))
        good = np.flatnonzero(np.isfinite(py))
        if len(good):
            inner.append(marker(s.slot, float(px[good[-1]]), float(py[good[-1]])))
            if labels:
                inner.append(tag("text", _cut(s.name), x=f"{px[good[-1]] + 11:.1f}", y=f"{end + 4:.1f}", class_="label"))
        parts.append(tag("g", inner, class_=f"s{s.slot}", data_agent=s.slot))
        tips = [[round(float(px[i]), 1), round(float(py[i]), 1), f"{s.x[i]:,.0f}", number(float(s.y[i]))] for i in good]
        hover.append({"n": s.name, "c": s.slot, "p": tips})
    parts.append(tag("line", y1=top, y2=bottom, class_="cursor", visibility="hidden"))
    return tag(
        "svg", parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=title, class_=f"chart v{width}",
        data_hover=json.dumps(hover, separators=(",", ":")), data_across=across,
    )  # fmt: skip


def _end(x: _Axis, y: _Axis, s: Series) -> tuple[float, float]:
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


_SHAPES = (
    "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z", "M-3.5-3.5H3.5V3.5H-3.5Z", "M0-4.6L4.4 3.4H-4.4Z", "M0-5L5 0L0 5L-5 0Z",
    "M0 4.6L4.4-3.4H-4.4Z", "M-4.5-1.5H-1.5V-4.5H1.5V-1.5H4.5V1.5H1.5V4.5H-1.5V1.5H-4.5Z", "M-4.5-2.5H4.5V2.5H-4.5Z",
    "M-2.5-4.5H2.5V4.5H-2.5Z",
)  # fmt: skip


def marker(slot: int, x: float, y: float) -> Markup:
    """The shape that goes with a colour, so that colour alone never tells agents apart."""
    return tag("path", d=_SHAPES[slot], transform=f"translate({x:.1f} {y:.1f})", class_="marker")


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
    x = _Axis(*_robust(points, [m.spread for m in marks]), left, right)
    parts = [tag("title", unit)]
    parts += _columns(x, top, height)
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
        inner += _whisker(x, spread.low, spread.high, y)
        if len(mark.dots) > 1:
            inner += [tag("circle", cx=f"{x(v):.1f}", cy=y + 8, r=2.2, class_="seed") for v in mark.dots if math.isfinite(v)]
        inner.append(marker(mark.slot or 0, float(x(spread.value)), y))
        colour = "log" if mark.slot is None else f"s{mark.slot}"
        parts.append(tag("g", inner, class_=f"{colour} hollow" if mark.hollow else colour))
    return tag("svg", parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=unit, class_=f"chart v{width}")


def _robust(points: Sequence[float], spreads: Sequence[Interval]) -> tuple[float, float]:
    """Least and greatest value to draw: all points, and the ends of intervals that are not much further out than the others'.

    One interval from two seeds, a hundred times as wide as the rest, would leave the rest no room to differ.
    """
    points = [v for v in points if math.isfinite(v)]
    low, high = min(points), max(points)
    halves = [(s.high - s.low) / 2 for s in spreads if math.isfinite(s.low) and math.isfinite(s.high)]
    room = max(high - low, 1.5 * float(np.median(halves)) if halves else 0.0) or 0.5 * abs(high) or 1.0
    ends = [v for s in spreads for v in (s.low, s.high) if not math.isnan(v)]
    return max(low - room, min([low, *ends])), min(high + room, max([high, *ends]))


def _whisker(axis: _Axis, low: float, high: float, at: float, upright: bool = False) -> list[Markup]:
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


def _columns(x: _Axis, top: float, height: float) -> list[Markup]:
    """Grid lines through rows one under another, with their ticks below."""
    parts = []
    for t in x.ticks:
        parts.append(tag("line", x1=f"{x(t):.1f}", x2=f"{x(t):.1f}", y1=top - 4, y2=height - 24, class_="grid"))
        parts.append(tag("text", _short(t), x=f"{x(t):.1f}", y=height - 8, class_="tick mid"))
    return parts


def bars(rows: Sequence[tuple[str, int, Interval, float | None]], unit: str) -> Markup:
    """Bars from zero, one under another, with whiskers and a tick where somebody else's value lies.

    Args:
        rows: name, colour, mean with ends, and the other value, each.
        unit: of the axis, for screen readers.
    """
    width, row, top, left, right = 480, 26, 10, 128, 466
    height = top + row * len(rows) + 26
    x = _Axis(*_ends(rows), left, right)
    parts = [tag("title", unit)]
    parts += _columns(x, top, height)
    for k, (name, slot, spread, other) in enumerate(rows):
        y = top + row * (k + 0.5)
        inner = [tag("title", f"{name}: {number(spread.value)}")]
        inner.append(tag("text", _cut(name), x=left - 14, y=y + 4.5, class_="label end"))
        if math.isfinite(spread.value):
            a, b = sorted((float(x(0.0)), float(x(spread.value))))
            inner.append(tag("rect", x=f"{a:.1f}", y=y - 8, width=f"{b - a:.1f}", height=16, rx=2, class_="bar"))
            inner.append(tag("line", x1=f"{x(spread.low):.1f}", x2=f"{x(spread.high):.1f}", y1=y, y2=y, class_="whisker"))
        if other is not None:
            inner.append(tag("line", x1=f"{x(other):.1f}", x2=f"{x(other):.1f}", y1=y - 11, y2=y + 11, class_="other"))
        parts.append(tag("g", inner, class_=f"s{slot}"))
    return tag("svg", parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=unit, class_=f"chart v{width}")


def _ends(rows: Sequence[tuple[str, int, Interval, float | None]]) -> tuple[float, float]:
    values = [v for _, _, i, other in rows for v in (i.low, i.high, i.value, other) if v is not None and math.isfinite(v)]
    return min([0.0, *values]), max([0.0, *values])


def scatter(
    points: Sequence[tuple[str, int, float, float, float, float, float]], across: str, unit: str, diagonal: bool = True
) -> Markup:
    """Points with whiskers both ways, and the diagonal on which both axes agree. What is much wider ends in arrows.

    Args:
        points: name, colour, and x with its half-width, and y with its lower and upper end, each.
        across: unit of the horizontal axis.
        unit: of the vertical one, written above it.
        diagonal: whether both axes measure the same.
    """
    width, height, left, right, top, bottom = 480, 340, 58, 462, 30, 302
    finite = [p for p in points if math.isfinite(p[2]) and math.isfinite(p[4])]
    if not finite:
        return tag("p", "nothing finite to draw", class_="empty")
    wide = [Interval(p[2], p[2] - p[3], p[2] + p[3]) for p in finite]
    x = _Axis(*_robust([p[2] for p in finite], wide), left, right)
    y = _Axis(*_robust([p[4] for p in finite], [Interval(*p[4:]) for p in finite]), bottom, top)
    parts = [tag("title", f"{unit} against {across}")]
    for t in y.ticks:
        parts.append(tag("line", x1=left, x2=right, y1=f"{y(t):.1f}", y2=f"{y(t):.1f}", class_="grid"))
        parts.append(tag("text", _short(t), x=left - 7, y=f"{y(t) + 4:.1f}", class_="tick end"))
    parts += [tag("text", _short(t), x=f"{x(t):.1f}", y=bottom + 19, class_="tick mid") for t in x.ticks]
    parts.append(tag("text", across, x=right, y=bottom + 34, class_="axis end"))
    parts.append(tag("text", unit, x=4, y=14, class_="axis"))
    both = max(x.low, y.low), min(x.high, y.high)
    if diagonal and both[0] < both[1]:
        where = {f"{axis}{i + 1}": f"{of(v):.1f}" for i, v in enumerate(both) for axis, of in (("x", x), ("y", y))}
        parts.append(tag("line", **where, class_="reference"))
    for name, slot, across_value, half, value, lower, upper in finite:
        px, py = float(x(across_value)), float(y(value))
        ends = f" [{number(lower)}, {number(upper)}]" if not math.isnan(lower) else ""
        inner = [tag("title", f"{name}: {unit} {number(value)}{ends}, {across} {number(across_value)}")]
        inner += _whisker(x, across_value - half, across_value + half, py)
        inner += _whisker(y, lower, upper, px, upright=True)
        inner.append(marker(slot, px, py))
        parts.append(tag("g", inner, class_=f"s{slot}"))
    said = f"{unit} against {across}"
    return tag("svg", parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=said, class_=f"chart v{width}")


SPEEDS = 0.5, 2.0, 5.0, 10.0  # m/s, between one colour of `spacetime` and the next
WRAP = 0.5  # of a road: a car that moves further between two steps has come round


def spacetime(
    cars: np.ndarray, seconds: float, learners: Sequence[int], title: str, size: tuple[int, int] = (480, 300)
) -> Markup:
    """Where cars are against time, coloured by their speed: waves of stopping and going are bands that run backwards.

    Args:
        cars: (steps, cars, 2) positions in m and speeds in m/s, NaN where there is no car.
        seconds: of a step.
        learners: cars whose lines are set off.
        title: read by screen readers.
        size: of the drawing.
    """
    width, height = size
    bottom, left, top, right = height - 38, 52, 30, width - 14
    steps = np.unique(np.linspace(0, len(cars) - 1, POINTS).astype(int))
    places, speeds = cars[steps, :, 0], cars[steps, :, 1]
    if not np.isfinite(places).any():
        return tag("p", "nothing finite to draw", class_="empty")
    longest = float(np.nanmax(places))
    x, y = _Axis(0.0, float(steps[-1] * seconds), left, right, most=7), _Axis(0.0, longest, bottom, top)
    px, py = x(steps * seconds), y(places)
    drawn: list[list[str]] = [[] for _ in range(len(SPEEDS) + 1)]
    own: list[str] = []
    for car in range(cars.shape[1]):
        ahead = np.abs(np.diff(places[:, car])) < WRAP * longest  # false of NaN
        own += [_path(*part) for part in _runs(px, py[:, car], ahead, ahead)] if car in learners else []
        colours = np.digitize((speeds[1:, car] + speeds[:-1, car]) / 2, SPEEDS)
        for colour in range(len(drawn)):
            drawn[colour] += [_path(*part) for part in _runs(px, py[:, car], ahead, colours == colour)]
    parts = [tag("title", title), *_columns(x, top, bottom + 24)]
    parts += [tag("text", _short(t), x=left - 7, y=f"{y(t) + 4:.1f}", class_="tick end") for t in y.ticks]
    parts.append(tag("text", "m", x=4, y=14, class_="axis"))
    parts.append(tag("text", "s", x=right, y=bottom + 34, class_="axis end"))
    names = [f"< {limit:g}" for limit in SPEEDS] + [f"{SPEEDS[-1]:g} m/s and more"]
    at = left
    for colour, name in enumerate(names):
        parts.append(tag("path", d=f"M{at} 10h16", class_=f"car speed{colour}"))
        parts.append(tag("text", name, x=at + 21, y=14, class_="axis"))
        at += 34 + 7 * len(name)
    parts += [tag("path", d="".join(d), class_=f"car speed{colour}") for colour, d in enumerate(drawn) if d]
    parts.append(tag("path", d="".join(own), class_="car own"))
    return tag("svg", parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=title, class_=f"chart v{width}")


def _runs(x: np.ndarray, y: np.ndarray, ahead: np.ndarray, wanted: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The stretches of a line whose pieces, one less than its points, all are both `ahead` and `wanted`."""
    good = np.concatenate([[False], ahead & wanted, [False]])
    begins, ends = np.flatnonzero(good[1:] & ~good[:-1]), np.flatnonzero(good[:-1] & ~good[1:])
    return [(x[begin : end + 1], y[begin : end + 1]) for begin, end in zip(begins, ends)]
