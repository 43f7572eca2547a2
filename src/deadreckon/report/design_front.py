"""The page about designs for several targets: fronts, hypervolume, and what is asked, predicted and not known."""

from pathlib import Path

import numpy as np

from deadreckon.mbo.effects import permitted
from deadreckon.mbo.front import Front
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.report import charts
from deadreckon.report.design_asked import asked, learned_from
from deadreckon.report.design_doubts import doubts_of_several
from deadreckon.report.design_edges import shown_value
from deadreckon.report.design_table import proposals_table
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number, words
from deadreckon.stats.interval import NORMAL, PERCENT

SHOWN = 50  # designs in a table
POINTS = 300  # designs of the data in the chart


def write_front(front: Front, out: Path | str) -> Path:
    """Writes one self-contained HTML page; an old one is replaced."""
    data, made = front.data, front.made
    n, far = len(made[0]), nn_distance(data[0], made[0].x)
    facts = [
        ("method", made[0].method), ("data", data[0].name), ("training data", learned_from(data[0])),
        ("seed", str(made[0].seed)),
        *((each.target, "to be made small" if each.minimise else "to be made large") for each in data),
    ]  # fmt: skip
    sections: list[tuple[str, str, Markup | None]] = [
        ("front", "Fronts", _chart(front) if len(data) == 2 else None),
        ("doubts", "What the models do not know", doubts_of_several(data, made, far)),
        ("asked", "What was asked", asked(data, n)),
        ("designs", "Designs", proposals_table(data, made, far, shown=SHOWN)),
        ("observed", "Front of the data", _observed(front)),
        ("quality", "Quality of the models, out of fold", _quality(front)),
    ]
    text = document(f"{n:,} designs for {words([each.target for each in data])}", _lead(front), facts, sections)
    return save_page(text, out)


def _lead(front: Front) -> str:
    """What is not known first, then the hypervolume, and what is expected to be gained where the models have any skill."""
    parts, bad = [], front.unskilled
    if bad:
        untested = "it was not tested how well the model predicts unseen rows"
        doubts = {each.target: made.quality.doubt if made.quality else untested for each, made in zip(front.data, front.made)}
        parts += [f"Of {target}, {doubts[target]}." for target in bad]
        parts.append(f"Proposals may be worthless for {words(bad)}, and their expected gain is not known.")
    point = ", ".join(f"{each.target} {number(float(v))}" for each, v in zip(front.data, front.shown(front.reference)))
    both, size = ("both targets", "area") if len(front.data) == 2 else ("all targets", "volume")
    parts.append(
        f"The hypervolume of the data is {number(front.before)}, measured from {point}: the {size} of outcomes, better than "
        f"this point, that some row of the data already reaches in {both} at once."
    )
    if broken := int((~permitted(front.data[0])).sum()):
        counted = "rows that break a rule of the proposals do" if broken > 1 else "row that breaks a rule of the proposals does"
        parts.append(f"{broken:,} {counted} not count.")
    if not bad:
        parts.append(f"The proposals are expected to add {number(front.gain)}.")
    parts += [f"{line[0].upper()}{line[1:]}." for line in front.notes]
    return " ".join(parts)


def _chart(front: Front) -> Markup:
    observed, predicted = front.shown(front.observed), front.shown(front.predicted)
    best, rows = front.best, np.arange(len(observed))
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
        f"{front.data[1].target}. Squares: the {int(best.sum()):,} designs on the front of the data, which no other is at "
        "least as good as in both and better in one. Triangles: the other designs of the data."
    )
    return join(tag("div", figure(drawn), class_="charts two"), note(text))


def _observed(front: Front) -> Markup:
    """The front of the data by the first target, the best first."""
    first, best = front.data[0], np.flatnonzero(front.best)
    rows = best[np.argsort(-front.observed[best, 0], kind="stable")][:SHOWN]
    scores, table = front.shown(front.observed[rows]), first.decode(first.x[rows])
    lines = []
    for k, row in enumerate(first.numbered(rows)):
        cells = [tag("td", tag("b", number(float(score)))) for score in scores[k]]
        cells += [tag("td", shown_value(values[k])) for values in table.values()]
        lines.append(tag("tr", tag("th", str(row), scope="row"), cells))
    heads = heads_of(["row", *(each.target for each in front.data), *table])
    return join(scroll(tag("table", heads, tag("tbody", lines))), note(f"{len(rows):,} of {len(best):,}."))


def _quality(front: Front) -> Markup | None:
    told = [str(made.quality) for made in front.made if made.quality is not None]
    return join(*(note(f"{line}.") for line in told)) if told else None
