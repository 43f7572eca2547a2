"""Scales, ticks and paths of a chart: what its marks are drawn with."""

import math
from typing import Any

import numpy as np

from deadreckon.report.markup import Markup, tag

POINTS = 240  # most points of a line
LABEL = 110, 16  # width and height that a name beside a line may take
LETTERS = 15  # of such a name; tooltips and legends have it all


class Axis:
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
        self.ticks = _decades(low, high) if symlog else []
        if len(self.ticks) < 2:  # of one alone no scale is read
            self.ticks = _nice(low, high, most)

    def label(self, tick: float) -> str:
        """A tick as a number, with as many digits as tell it from its neighbours."""
        apart = min((b - a for a, b in zip(self.ticks, self.ticks[1:])), default=0.0)
        return short(tick, 3 if self.symlog or not apart or not tick else max(3, _digits(tick, apart)))

    def _bend(self, value: np.ndarray | float) -> np.ndarray:
        value = np.asarray(value, float)
        return np.sign(value) * np.log10(1 + np.abs(value)) if self.symlog else value

    def __call__(self, value: np.ndarray | float) -> np.ndarray:
        """Where a value is drawn."""
        return self.start + (self._bend(value) - self.low) / (self.high - self.low) * (self.end - self.start)


def _nice(low: float, high: float, most: int) -> list[float]:
    raw = (high - low) / (most - 1)
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(m * size for m in (1, 2, 2.5, 5, 10) if m * size >= raw * 0.999)
    if math.floor(high / step + 1e-9) <= math.ceil(low / step - 1e-9):
        step /= 2  # 10, 5 or 2, of which one multiple would be within
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


def _decades(low: float, high: float) -> list[float]:
    top = max(abs(low), abs(high), 1.0)
    every = max(1, math.ceil(math.log10(top) / 4))
    sizes = [10.0**k for k in range(0 if every == 1 else every, math.ceil(math.log10(top)) + 1, every)]
    return [t for t in [*(-s for s in reversed(sizes)), 0.0, *sizes] if low <= t <= high]


def _digits(value: float, step: float) -> int:
    """Significant digits of a multiple of a step that has two, such as 2.5 or 1."""
    return math.floor(math.log10(abs(value))) - math.floor(math.log10(step * (1 + 1e-9))) + 2


def short(value: float, digits: int = 3) -> str:
    """A number of so many significant digits as a tick has it."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if size <= abs(value) < 1e12:
            return f"{value / size:.{max(digits, 6)}g}{unit}".replace("-", "\N{MINUS SIGN}")
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}").replace("e+", "e")


def cut(name: str, letters: int = LETTERS) -> str:
    """A name of at most so many letters, which fit beside a line."""
    return name if len(name) <= letters else f"{name[: letters - 1]}\N{HORIZONTAL ELLIPSIS}"


def path(x: np.ndarray, y: np.ndarray, closed: bool = False) -> str:
    """The way through points, as SVG has it."""
    out, pen = [], False
    for a, b in zip(x, y):
        good = math.isfinite(a) and math.isfinite(b)
        if good:
            out.append(f"{'L' if pen else 'M'}{a:.1f} {b:.1f}")
        pen = good
    return "".join(out) + ("Z" if closed and out else "")


def columns(x: Axis, top: float, height: float) -> list[Markup]:
    """Grid lines through rows one under another, with their ticks below."""
    parts = []
    for t in x.ticks:
        parts.append(tag("line", x1=f"{x(t):.1f}", x2=f"{x(t):.1f}", y1=top - 4, y2=height - 24, class_="grid"))
        parts.append(tag("text", x.label(t), x=f"{x(t):.1f}", y=height - 8, class_="tick mid"))
    return parts


def levels(y: Axis, left: float, right: float, apart: int = 7) -> list[Markup]:
    """Grid lines across a chart, with their ticks at the left, so many pixels `apart`."""
    parts = []
    for t in y.ticks:
        parts.append(tag("line", x1=left, x2=right, y1=f"{y(t):.1f}", y2=f"{y(t):.1f}", class_="grid"))
        parts.append(tag("text", y.label(t), x=left - apart, y=f"{y(t) + 4:.1f}", class_="tick end"))
    return parts


def svg(parts: Any, width: int, height: int, title: str, style: str = "chart", **attributes: Any) -> Markup:
    """A drawing of this size; `title` is shown where the pointer rests, and read by screen readers."""
    size = f"0 0 {width} {height}"
    return tag("svg", tag("title", title), parts, viewBox=size, role="img", aria_label=title, class_=style, **attributes)
