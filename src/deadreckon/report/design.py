"""The page about proposed designs: what they promise, how far from the data they lie, and what they are worth by a judge."""

from pathlib import Path

import numpy as np

from deadreckon.files import replacing
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Scores
from deadreckon.report import charts
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number
from deadreckon.stats.interval import NORMAL, PERCENT

SHOWN = 25  # proposals in the table
COLUMNS = 10  # variables in the table
FAR = 3.0  # beyond so many usual distances a design is called far


def write_design(data: Designs, made: Proposals, far: np.ndarray, out: Path | str, scores: Scores | None = None) -> Path:
    """Writes one self-contained HTML page about proposals.

    Args:
        data: the scored designs that they rest on.
        made: the proposals.
        far: (n,) how far each lies from the data (`mbo.reach`).
        out: the page; an old one is replaced.
        scores: what they are truly worth, where there is a judge.
    """
    sections: list[tuple[str, str, Markup | None]] = [
        ("promised", "Promised and kept" if scores else "Promised, and how far out", _chart(data, made, far, scores)),
        ("designs", "Designs", _table(data, made, far, scores)),
    ]
    counts = f"{len(data):,} designs, {len(data.variables):,} variables"
    facts = [("method", made.method), ("data", data.name), ("learned from", counts), ("seed", str(made.seed))]
    text = document(f"{len(made):,} designs for {data.target}", _lead(data, made, far, scores), facts, sections)
    with replacing(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(out)


def _lead(data: Designs, made: Proposals, far: np.ndarray, scores: Scores | None) -> str:
    """The most important thing in a sentence or two."""
    best = number(float(data.shown(data.y.max())))
    parts = [f"The best of the data has {data.target} {best}."]
    if made.promises:
        parts.append(f"The best proposal promises {number(float(data.shown(made.predicted.max())))}.")
    if scores is not None:
        kept, middle = (number(data.shown(scores.percentile(q))) for q in (100, 50))
        parts.append(f"Judged, the best of them has {kept} and the median {middle}.")
    share = float((far > FAR).mean())
    if share > 0:
        parts.append(f"{share:.0%} lie more than {FAR:g} usual distances from any scored design: no data speaks for them.")
    return " ".join(parts)


def _chart(data: Designs, made: Proposals, far: np.ndarray, scores: Scores | None) -> Markup:
    if not made.promises:
        return note(f"{made.method} promises nothing.")
    across = far if scores is None else data.shown(scores.true)
    doubt = np.where(np.isfinite(made.doubt), NORMAL * made.doubt, np.nan)
    value = data.shown(made.predicted)
    points = [
        (f"design {i}", 0, float(across[i]), 0.0, float(value[i]), float(value[i] - doubt[i]), float(value[i] + doubt[i]))
        for i in range(len(made))
    ]
    unit = "usual distances to the data" if scores is None else f"{data.target}, judged"
    text = (
        f"Whiskers: {PERCENT} of what the method believes, where it has a doubt. A usual distance is the median distance of a "
        "scored design to its nearest neighbour, in standardised coordinates."
    )
    if scores is not None:
        text += " Above the dashed line more was promised than is true."
    drawn = charts.scatter(points, unit, f"{data.target}, promised", diagonal=scores is not None)
    return join(figure(drawn), note(text))


def _table(data: Designs, made: Proposals, far: np.ndarray, scores: Scores | None) -> Markup:
    """The proposals that promise most, or the first, in the data's own words."""
    order = np.argsort(-made.predicted, kind="stable")[:SHOWN]
    table = data.decode(made.x[order])
    names = list(table)[:COLUMNS]
    heads = ["design", "promised", "doubt", *(["judged"] if scores else []), "distance", *names]
    rows = []
    for k, i in enumerate(order):
        values = [made.doubt[i], *([data.shown(scores.true)[i]] if scores else []), far[i]]
        cells = [tag("th", str(i), scope="row"), tag("td", tag("b", number(float(data.shown(made.predicted)[i]))))]
        cells += [tag("td", number(float(value))) for value in values]
        cells += [tag("td", number(v) if isinstance(v, float) else str(v)) for v in (table[name][k] for name in names)]
        rows.append(tag("tr", cells))
    head = heads_of(heads)
    left = len(table) - len(names)
    more = f" {left:,} more variables are in the CSV." if left else ""
    which = f"{len(order)} that promise most" if made.promises else f"first {len(order)}"
    shown = f"The {which}, of {len(made):,}." if len(made) > len(order) else "All of them."
    return join(scroll(tag("table", head, tag("tbody", rows))), note(f"{shown}{more}"))
