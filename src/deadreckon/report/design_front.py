"""The page about designs for several targets: the front of the data, the predicted one, and the hypervolume of both."""

from pathlib import Path

import numpy as np

from deadreckon.files import replacing
from deadreckon.mbo.front import Front
from deadreckon.mbo.hypervolume import non_dominated
from deadreckon.report import charts
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number
from deadreckon.stats.interval import NORMAL, PERCENT

SHOWN = 50  # designs in a table
POINTS = 300  # designs of the data in the chart


def write_front(front: Front, out: Path | str) -> Path:
    """Writes one self-contained HTML page; an old one is replaced."""
    data, n = front.data[0], len(front.made[0])
    names = " and ".join(each.target for each in front.data)
    point = ", ".join(f"{each.target} {number(float(v))}" for each, v in zip(front.data, front.shown(front.reference)))
    lead = (
        f"The hypervolume of the data is {number(front.before)}, measured from {point}. The proposals are expected to add "
        f"{number(front.gain)}. {' '.join(f'{line.capitalize()}.' for line in front.warnings)}"
    )
    counts = f"{len(data):,} designs, {len(data.variables):,} variables"
    facts = [
        ("method", front.made[0].method), ("data", data.name), ("learned from", counts), ("seed", str(front.made[0].seed)),
        *((each.target, "to be made small" if each.minimise else "to be made large") for each in front.data),
    ]  # fmt: skip
    sections: list[tuple[str, str, Markup | None]] = [
        ("front", "Fronts", _chart(front) if len(front.data) == 2 else None),
        ("observed", "Front of the data", _table(front, data.x, front.observed, non_dominated(front.observed))),
        ("designs", "Designs", _table(front, front.made[0].x, front.predicted, np.ones(n, bool), predicted=True)),
        ("quality", "Quality of the models, out of fold", _quality(front)),
    ]
    text = document(f"{n:,} designs for {names}", lead.strip(), facts, sections)
    with replacing(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(out)


def _chart(front: Front) -> Markup:
    observed, predicted = front.shown(front.observed), front.shown(front.predicted)
    best, rows = non_dominated(front.observed), np.arange(len(observed))
    kept = rows[best | np.isin(rows, np.linspace(0, len(rows) - 1, min(len(rows), POINTS)).astype(int))]
    half = NORMAL * np.stack([made.predicted_std for made in front.made], 1)
    nan, mark = float("nan"), ("", " (front)")
    points = [
        (f"row {row}{mark[int(best[i])]}", 2 - int(best[i]), float(observed[i, 0]), 0.0, float(observed[i, 1]), nan, nan)
        for i, row in zip(kept, front.data[0].numbered(kept))
    ] + [
        (f"design {i}", 0, float(x), 0.0, float(y), float(y - half[i, 1]), float(y + half[i, 1]))
        for i, (x, y) in enumerate(predicted)
    ]  # fmt: skip
    drawn = charts.scatter(points, front.data[0].target, front.data[1].target, diagonal=False)
    text = (
        f"Circles with whiskers: proposals as they are predicted, with the {PERCENT} interval for a new measurement of "
        f"{front.data[1].target}. The others are designs of the data: squares the {int(best.sum()):,} on its front, which no "
        "other is at least as good as in both and better in one."
    )
    return join(figure(drawn), note(text))


def _table(front: Front, x: np.ndarray, scores: np.ndarray, rows: np.ndarray, predicted: bool = False) -> Markup:
    """Designs by their first target, the best first."""
    chosen = np.flatnonzero(rows)
    chosen = chosen[np.argsort(-scores[chosen, 0], kind="stable")][:SHOWN]
    shown, table = front.shown(scores), front.data[0].decode(x[chosen])
    heads = ["design" if predicted else "row"]
    for each in front.data:
        heads += [f"{each.target}{', predicted' if predicted else ''}", *([f"{each.target}, std"] if predicted else [])]
    lines = []
    for k, i in enumerate(chosen):
        cells = [tag("th", str(i if predicted else front.data[0].numbered(i)), scope="row")]
        for j, made in enumerate(front.made):
            cells.append(tag("td", tag("b", number(float(shown[i, j])))))
            cells += [tag("td", number(float(made.predicted_std[i])))] if predicted else []
        cells += [tag("td", number(v) if isinstance(v, float) else str(v)) for v in (table[name][k] for name in table)]
        lines.append(tag("tr", cells))
    text = f"{len(chosen):,} of {int(rows.sum()):,}."
    if predicted:
        text += " The standard deviations are of a new measurement."
    return join(scroll(tag("table", heads_of([*heads, *table]), tag("tbody", lines))), note(text))


def _quality(front: Front) -> Markup | None:
    told = [str(made.quality) for made in front.made if made.quality is not None]
    return join(*(note(f"{line}.") for line in told)) if told else None
