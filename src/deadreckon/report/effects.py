"""Drawings of what a fitted model says that a variable does: a curve for numbers, a point a level for categories."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.report.axes import Axis, columns, cut, levels, path, short, svg
from deadreckon.report.forest import marker, whisker
from deadreckon.report.markup import Markup, tag
from deadreckon.report.text import number

WIDTH, HEIGHT = 300, 178
LEFT, RIGHT, TOP, BOTTOM = 44, 290, 12, 142
_NAME = 16  # letters of a level's name
_MARKS = 60  # rows of the data at most that are marked along the axis


@dataclass(frozen=True, eq=False)
class Panel:
    """What is drawn of one variable.

    Attributes:
        name: of the variable.
        unit: of the predictions.
        values: (g,) of the variable; of levels their indices.
        mean: (g,) predictions, and `low` and `high` the ends of their intervals; NaN where there are none.
        ends: of the axis of predictions, which panels share.
        levels: names of all levels; none of a number.
        log: whether the axis of values is logarithmic.
        faint: (g,) values that may not be proposed; None: none.
        here: value of the design that a cut goes through; None on average.
        rows: values of the data, which are marked.
        reference: a prediction to compare with, such as the best score of the data; None: none.
    """

    name: str
    unit: str
    values: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ends: tuple[float, float]
    levels: Sequence[str] = ()
    log: bool = False
    faint: np.ndarray | None = None
    here: float | None = None
    rows: np.ndarray | None = None
    reference: float | None = None


def panel(of: Panel) -> Markup:
    """Its drawing."""
    return _points(of) if of.levels else _curve(of)


def _curve(of: Panel) -> Markup:
    at = np.log10 if of.log else np.asarray
    values = at(of.values.astype(float))
    x, y = Axis(float(values[0]), float(values[-1]), LEFT + 4, RIGHT - 6, most=5), Axis(*of.ends, BOTTOM, TOP, most=4)
    parts = levels(y, LEFT, RIGHT, 5)
    for t in _ticks_of_log(of.values) if of.log else x.ticks:
        parts.append(tag("text", short(t) if of.log else x.label(t), x=f"{x(at(t)):.1f}", y=BOTTOM + 22, class_="tick mid"))
    if of.rows is not None:
        some = np.unique(of.rows)
        some = some[np.unique(np.linspace(0, len(some) - 1, min(len(some), _MARKS)).astype(int))]
        marks = "".join(f"M{x(v):.1f} {BOTTOM + 2}v5" for v in at(some.astype(float)))
        parts.append(tag("path", d=marks, class_="rug"))
    if of.reference is not None and y.low <= of.reference <= y.high:
        parts.append(
            tag("line", x1=LEFT, x2=RIGHT, y1=f"{y(of.reference):.1f}", y2=f"{y(of.reference):.1f}", class_="reference")
        )
    px, py = x(values), y(of.mean)
    inner = []
    good = np.isfinite(of.low) & np.isfinite(of.high)
    if good.any():
        edges = np.clip(y(of.high[good]), TOP, BOTTOM), np.clip(y(of.low[good])[::-1], TOP, BOTTOM)
        inner.append(
            tag("path", d=path(np.append(px[good], px[good][::-1]), np.concatenate(edges), closed=True), class_="band")
        )
    faint = np.zeros(len(px), bool) if of.faint is None else of.faint
    if faint.any():
        inner.append(tag("path", d=path(px, py), class_="line dashed faint"))
    inner.append(tag("path", d=path(px, np.where(faint, np.nan, py)), class_="line"))
    if of.here is not None:
        k = int(np.abs(of.values - of.here).argmin())
        inner.append(marker(0, float(px[k]), float(py[k])))
    parts.append(tag("g", inner, class_="s0"))
    tips = [[round(float(a), 1), round(float(b), 1), number(float(v)), _with_ends(of, i)]
            for i, (a, b, v) in enumerate(zip(px, py, of.values))]  # fmt: skip
    parts.append(tag("line", y1=TOP, y2=BOTTOM, class_="cursor", visibility="hidden"))
    hover = json.dumps([{"n": of.unit, "c": 0, "p": tips}], separators=(",", ":"))
    return svg(parts, WIDTH, HEIGHT, f"{of.unit} by {of.name}", data_hover=hover, data_across=of.name)


def _points(of: Panel) -> Markup:
    row, left = 24, 112
    height = TOP + row * len(of.values) + 26
    x = Axis(*of.ends, left + 4, RIGHT - 6, most=4)
    parts = columns(x, TOP, height)
    if of.reference is not None and x.low <= of.reference <= x.high:
        at = f"{x(of.reference):.1f}"
        parts.append(tag("line", x1=at, x2=at, y1=TOP - 4, y2=height - 24, class_="reference"))
    for k, value in enumerate(of.values.astype(int).tolist()):
        y, name = TOP + row * (k + 0.5), of.levels[value]
        chosen = of.here is not None and value == int(of.here)
        off = of.faint is not None and bool(of.faint[k])
        look = "label end" if chosen else "tick end"
        inner = [tag("title", f"{name}: {_with_ends(of, k)}")]
        inner.append(tag("text", cut(name, _NAME), x=left - 8, y=y + 4.5, class_=look))
        inner += whisker(x, float(of.low[k]), float(of.high[k]), y)
        inner.append(marker(0, float(x(of.mean[k])), y))
        parts.append(tag("g", inner, class_="s0 hollow" if off else "s0"))
    return svg(parts, WIDTH, height, f"{of.unit} by {of.name}")


def _with_ends(of: Panel, i: int) -> str:
    if math.isnan(of.low[i]):
        return number(float(of.mean[i]))
    return f"{number(float(of.mean[i]))} [{number(float(of.low[i]))}, {number(float(of.high[i]))}]"


def _ticks_of_log(values: np.ndarray) -> list[float]:
    """Powers of ten within a range, or where there are fewer than two of them, also their double and fivefold, or its ends."""
    low, high = math.log10(values[0]), math.log10(values[-1])
    powers = [10.0**k for k in range(math.floor(low), math.ceil(high) + 1)]
    inside = lambda ticks: [t for t in ticks if values[0] * 0.999 <= t <= values[-1] * 1.001]  # noqa: E731
    found = inside(powers)
    if len(found) < 2:
        found = inside([m * p for p in powers for m in (1, 2, 5)])
    if len(found) < 2:
        found = [float(values[0]), float(values[-1])]
    return found[:: max(1, math.ceil(len(found) / 5))]
