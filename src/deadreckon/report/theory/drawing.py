"""What the pictures of theory share: CSV files, lines, shades and SVG files."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from deadreckon.data.formats.csv_out import write_rows
from deadreckon.files import replacing, write_text
from deadreckon.report import charts
from deadreckon.report.markup import Markup, tag
from deadreckon.report.picture import PANEL, style

Made = tuple[list[Path], list[str]]  # files, and what to say
SHADES = 9  # of a picture; more are not told apart


def columns(path: Path, values: Mapping[str, np.ndarray]) -> Path:
    """A CSV file of equally long columns."""
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        rows = zip(*(np.asarray(column).tolist() for column in values.values()))
        write_rows(file, [values, *([f"{v:.8g}" if isinstance(v, float) else v for v in row] for row in rows)])
    return path


def lines(x: np.ndarray, named: Mapping[str, np.ndarray], names: Sequence[str], unit: str, across: str, **more) -> Markup:
    """Lines whose colours are their places in `names`."""
    series = [charts.Series(name, names.index(name), np.asarray(x, float), np.asarray(y, float)) for name, y in named.items()]
    return charts.lines(series, title=f"{unit} against {across}", unit=unit, across=across, size=PANEL, ticks=7, **more)


def drawing(path: Path, size: tuple[int, int], *parts: Markup | list[Markup]) -> Path:
    """An SVG file that needs nothing else, in the charts' colours."""
    rules = (
        ".shade { fill: var(--c1) } .ground { fill: var(--floor); stroke: var(--line) }"
        " .way { fill: none; stroke-width: 3; stroke: var(--c) } .thin { fill: none; stroke: var(--ink); stroke-width: 1.4 }"
        " .dots { fill: none; stroke: var(--ink); stroke-dasharray: 3 3 } .dot { fill: var(--c0) }"
        " .cell { fill: none; stroke: var(--grid) }"
        " .word { font-size: 13px; fill: var(--ink) } .soft { font-size: 12px; fill: var(--soft) } .mid { text-anchor: middle }"
        " .query { stroke: var(--no); stroke-width: 1.5 }"
    )
    whole = tag(
        "svg", tag("style", style(), Markup(rules)), tag("rect", width="100%", height="100%", class_="back"), *parts,
        xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {size[0]} {size[1]}", width=size[0], height=size[1],
    )  # fmt: skip
    return write_text(path, re.sub(r' data-hover="[^"]*"', "", whole))


def shades(values: np.ndarray, shape_of: Callable[..., str], most: float) -> list[Markup]:
    """One path a shade for all places whose value falls into it."""
    level = np.clip(np.rint(SHADES * values / most), 0, SHADES).astype(int)
    return [
        tag("path", d="".join(shape_of(*at) for at in np.argwhere(level == k)), class_="shade", opacity=f"{k / SHADES:.2f}")
        for k in range(1, SHADES + 1)
        if (level == k).any()
    ]
