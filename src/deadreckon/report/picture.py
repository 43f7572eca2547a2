"""Learning curves of many runs as one SVG file that needs nothing else, for documents."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from deadreckon.errors import UserError
from deadreckon.files import write_text
from deadreckon.report import charts, forest
from deadreckon.report.entries import Entry, read
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import asset

PANEL = 460, 300  # width and height of one chart
HEAD = 26  # above it, for its title


def picture(
    path: Path | str,
    panels: Mapping[str, Sequence[Path | str]],
    *,
    quantity: str = "score",
    columns: int = 2,
    names: Mapping[str, str] | None = None,
    references: Mapping[str, Mapping[str, float]] | None = None,
    symlog: bool = False,
) -> Path:
    """Draws a quantity against updates, a panel for each group of runs; line: mean over seeds, band: lowest to highest.

    Of runs that all learned online it is drawn against environment steps.

    Args:
        path: of the SVG file.
        panels: title to run folders; runs whose folders have the same name have the same colour in all panels.
        quantity: a column of the evaluations or metrics, such as `score`, `return`, `estimated_value`, `q`.
        columns: panels side by side.
        names: what to call a folder's name in the legend.
        references: panel title to named horizontal lines.
        symlog: a symmetric logarithmic vertical axis.

    Returns:
        The path.

    Raises:
        UserError: no panel, a path that is not a run, or no run that has the quantity.
    """
    runs = {title: [read([folder]).entries[0] for folder in folders] for title, folders in panels.items()}
    labels = list(dict.fromkeys(e.folder.path.name for entries in runs.values() for e in entries))
    if not labels:
        raise UserError(f"{path}: there is nothing to draw")
    if not any(len(e.curve(quantity)[0]) for entries in runs.values() for e in entries):
        raise UserError(f"{path}: none of the runs has a column {quantity!r}")
    drawn = {}
    for title, entries in runs.items():
        acted = all(e.online for e in entries)
        series = [_series(e, labels.index(e.folder.path.name), quantity, acted) for e in entries if len(e.curve(quantity)[0])]
        lines, across = list((references or {}).get(title, {}).items()), "environment steps" if acted else "updates"
        drawn[title] = charts.lines(
            series, title=title, unit=quantity, size=PANEL, references=lines, symlog=symlog, across=across
        )
    return sheet(path, drawn, [(names or {}).get(label, label) for label in labels], columns)


def sheet(path: Path | str, panels: Mapping[str, Markup], names: Sequence[str], columns: int = 2) -> Path:
    """Charts of the size `PANEL` side by side in an SVG file, under a legend; the colour of `names[i]` is slot i."""
    columns = min(columns, len(panels))
    width, height = PANEL
    keys, below = _legend(names, columns * width)
    drawn = []
    for i, (title, chart) in enumerate(panels.items()):
        x, y = i % columns * width, below + i // columns * (height + HEAD)
        placed = Markup(re.sub(r"^<svg ", f'<svg x="{x}" y="{y + HEAD}" width="{width}" height="{height}" ', chart))
        drawn.append(join(tag("text", title, x=x + 8, y=y + 18, class_="title"), placed))
    full = columns * width, below + math.ceil(len(panels) / columns) * (height + HEAD)
    whole = tag(
        "svg", tag("style", style()), tag("rect", width="100%", height="100%", class_="back"), keys, drawn,
        xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {full[0]} {full[1]}", width=full[0], height=full[1],
    )  # fmt: skip
    text = re.sub(r' data-hover="[^"]*"', "", whole)
    return write_text(path, text)


def _series(entry: Entry, slot: int, quantity: str, environment: bool) -> charts.Series:
    curve = entry.curve(quantity, environment)
    return charts.Series.over_seeds(entry.label, slot % forest.SLOTS, *curve, dashed=slot >= forest.SLOTS)


def _legend(names: Sequence[str], width: int) -> tuple[Markup, int]:
    """Names with their lines, as many a row as fit, and the height that they take."""
    parts, x, y = [], 12, 20
    for slot, name in enumerate(names):
        needed = 48 + 9 * len(name)  # capitals are wide
        if x + needed > width and x > 12:
            x, y = 12, y + 22
        line = tag("path", d=f"M{x} {y - 4}h26", class_="line dashed" if slot >= forest.SLOTS else "line")
        colour = slot % forest.SLOTS
        parts.append(tag("g", line, forest.marker(colour, x + 13, y - 4), class_=f"s{colour}"))
        parts.append(tag("text", name, x=x + 33, y=y, class_="key"))
        x += needed
    return tag("g", parts), y + 12


def style() -> Markup:
    """The page's colours and the rules for charts, in light: a document's paper is white."""
    css = asset("page.css")
    root = css[css.index("--back") : css.index("}")]
    drawn = re.compile(r"\.(s\d|car|speed\d|own|chart|grid|cursor|reference|line|band|marker|end|floor|way|reach|visited)\b")
    rules = [line for line in css.splitlines() if drawn.match(line)]
    own = (
        f"svg {{ {root} font-family: system-ui, sans-serif; }} .back {{ fill: var(--card); }} "
        ".title { font-size: 15px; font-weight: 600; fill: var(--ink); } .key { font-size: 13.5px; fill: var(--ink); }"
    )
    return Markup("\n".join([own, *rules]))
