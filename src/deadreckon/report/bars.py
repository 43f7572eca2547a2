"""Charts of what a log holds: histograms, bars of shares, and where pairs of numbers lie."""

from collections.abc import Sequence

import numpy as np

from deadreckon.report.axes import Axis, cut, levels, svg
from deadreckon.report.markup import Markup, tag
from deadreckon.report.text import number

_BINS = 24
_CELLS = 44, 28  # of a density, across and up
_NAME = 17  # letters of a bar's name
_LARGEST = 8e307  # of both signs, whose difference is a number too; larger ones are drawn there
_MOST = 12  # bars; those that are left become one


def histogram(values: np.ndarray, title: str, unit: str = "rows") -> Markup:
    """How often values of (rows,) numbers occur; few different ones have a bar each. `unit` is what is counted."""
    values = np.asarray(values, np.float64)
    values = np.clip(values[np.isfinite(values)], -_LARGEST, _LARGEST)
    if not len(values):
        return tag("p", "no values", class_="empty")
    kinds, counts = np.unique(values, return_counts=True)
    narrow = kinds[-1] - kinds[0] < 2 * _BINS * np.spacing(np.abs(kinds).max())  # no number lies between the ends of a bin
    if len(kinds) <= _MOST or narrow:
        short_names, long_names = ([f"{kind:.{digits}g}" for kind in kinds.tolist()] for digits in (6, 17))
        return shares(short_names if len(set(short_names)) == len(kinds) else long_names, counts, title, unit)
    counts, edges = np.histogram(values, _BINS)
    width, height, left, right, top, bottom = 300, 170, 38, 292, 22, 140
    x, y = Axis(float(edges[0]), float(edges[-1]), left, right), Axis(0.0, float(counts.max()), bottom, top, most=3)
    parts = [tag("text", unit, x=2, y=12, class_="axis"), *levels(y, left, right, 5)]
    for count, low, high in zip(counts.tolist(), edges, edges[1:]):
        said = tag("title", f"{number(float(low))} to {number(float(high))}: {count:,} {unit}")
        a, b, up = float(x(low)), float(x(high)), float(y(count))
        size = {"width": f"{max(b - a - 1, 0.5):.1f}", "height": f"{bottom - up:.1f}"}
        parts.append(tag("rect", said, x=f"{a + 0.5:.1f}", y=f"{up:.1f}", class_="bar", **size))
    parts += [tag("text", x.label(t), x=f"{x(t):.1f}", y=bottom + 18, class_="tick mid") for t in x.ticks]
    return _drawing(parts, width, height, title)


def shares(names: Sequence[str], counts: np.ndarray, title: str, unit: str = "rows") -> Markup:
    """A bar for each name with its share of them; the most frequent ones, in the given order, and the rest."""
    counts = np.asarray(counts)
    chosen = np.sort(np.argsort(-counts, kind="stable")[: _MOST if len(counts) <= _MOST else _MOST - 1])
    rows = [(names[i], int(counts[i])) for i in chosen]
    if rest := len(counts) - len(rows):
        rows.append((f"{rest:,} others", int(counts.sum()) - sum(count for _, count in rows)))
    width, row, left, right = 300, 22, 118, 240
    total, most = max(int(counts.sum()), 1), max(count for _, count in rows) or 1
    parts = []
    for i, (name, count) in enumerate(rows):
        y, long = i * row + 4, (right - left) * count / most
        parts.append(
            tag("g", tag("title", f"{name}: {count:,} {unit}"),
                tag("text", cut(name, _NAME), x=left - 8, y=y + 13, class_="tick end"),
                tag("rect", x=left, y=y, width=f"{long:.1f}", height=row - 6, rx=2, class_="bar"),
                tag("text", f"{count / total:.1%}", x=f"{left + long + 6:.1f}", y=y + 13, class_="tick"))
        )  # fmt: skip
    return _drawing(parts, width, len(rows) * row + 6, title)


def density(x: np.ndarray, y: np.ndarray, across: str, up: str) -> Markup:
    """How many of (rows,) pairs lie where: cells the darker, the more rows."""
    counts, xs, ys = np.histogram2d(x, y, _CELLS)
    width, height, left, right, top, bottom = 480, 320, 52, 466, 30, 282
    at, over = Axis(float(xs[0]), float(xs[-1]), left, right), Axis(float(ys[0]), float(ys[-1]), bottom, top)
    parts = levels(over, left, right)
    parts += [tag("text", at.label(t), x=f"{at(t):.1f}", y=bottom + 19, class_="tick mid") for t in at.ticks]
    parts += [tag("text", across, x=right, y=bottom + 36, class_="axis end"), tag("text", up, x=4, y=14, class_="axis")]
    for i, j in np.argwhere(counts > 0).tolist():
        a, b, low, high = float(at(xs[i])), float(at(xs[i + 1])), float(over(ys[j])), float(over(ys[j + 1]))
        strength = 0.15 + 0.85 * np.log1p(counts[i, j]) / np.log1p(counts.max())
        parts.append(
            tag("rect", tag("title", f"{int(counts[i, j]):,} rows"), x=f"{a:.1f}", y=f"{high:.1f}", width=f"{b - a:.1f}",
                height=f"{low - high:.1f}", class_="visited", opacity=f"{strength:.2f}")
        )  # fmt: skip
    return _drawing(parts, width, height, f"{up} against {across}")


def _drawing(parts: list[Markup], width: int, height: int, title: str) -> Markup:
    return svg(tag("g", parts, class_="s0"), width, height, title)
