"""The table of proposals, for one target or several."""

from collections.abc import Sequence

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import shown_interval
from deadreckon.mbo.nn_distance import neighbours
from deadreckon.mbo.problems.problem import Scores
from deadreckon.report.design_edges import shown_value
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import heads_of, note, scroll
from deadreckon.report.text import number, words
from deadreckon.stats.interval import PERCENT

SHOWN = 25  # proposals
COLUMNS = 10  # variables
NEAREST = 3  # scored rows beside each proposal


def proposals_table(
    data: Sequence[Designs], made: Sequence[Proposals], far: np.ndarray, scores: Scores | None = None, shown: int = SHOWN
) -> Markup:
    """The proposals with the best predictions of the first target, or the first ones, in the columns of the data.

    Args:
        data: the same designs, with the scores of one target each.
        made: the same proposals, with what is predicted of each target.
        far: (n,) how far each lies from the data.
        scores: true scores, where there is an oracle.
        shown: how many proposals.
    """
    first, count = data[0], len(made[0])
    order = np.argsort(-made[0].predicted, kind="stable")[:shown]
    table = first.decode(made[0].x[order])
    names = list(table)[:COLUMNS]
    how = made[0].how if len(data) == 1 else "predicted"
    predicted = [f"{each.target}, predicted" for each in data] if len(data) > 1 else [how]
    heads = ["proposal", *predicted, *(["true"] if scores else []), "distance", "nearest rows", *names]
    _, near = neighbours(first, made[0].x[order], NEAREST)
    rows = []
    for k, i in enumerate(order):
        cells = [tag("th", str(i), scope="row"), *(_predicted(each, of, int(i)) for each, of in zip(data, made))]
        cells += [tag("td", number(float(value))) for value in [*([first.shown(scores.true)[i]] if scores else []), far[i]]]
        cells.append(tag("td", [tag("small", _scored(data, int(row))) for row in near[k]]))
        cells += [tag("td", shown_value(table[name][k])) for name in names]
        rows.append(tag("tr", cells))
    left = len(table) - len(names)
    more = f" {left:,} more variables are in the CSV." if left else ""
    best = f"best predictions of {first.target}" if len(data) > 1 else "best predictions"
    which = f"{len(order)} with the {best}" if made[0].predicts and how == "predicted" else f"first {len(order)}"
    told = f"The {which}, of {count:,}." if count > len(order) else "All of them."
    below = f" Below a prediction is its {PERCENT} interval." if how == "predicted" else ""
    meaning = (
        f"{below} Distance: to the nearest scored row, in typical distances. Nearest "
        f"rows: row of the data (counted from 0) and its {words([each.target for each in data])}."
    )
    return join(scroll(tag("table", heads_of(heads), tag("tbody", rows), class_="proposals")), note(f"{told}{more}{meaning}"))


def _predicted(data: Designs, made: Proposals, i: int) -> Markup:
    """A prediction with its interval."""
    low, high = (float(end[i]) for end in shown_interval(data, made.predicted, made.predicted_std))
    interval = None if np.isnan(low) else tag("small", f"{number(low)} to {number(high)}")
    return tag("td", tag("b", number(float(data.shown(made.predicted)[i]))), interval)


def _scored(data: Sequence[Designs], row: int) -> str:
    """A row of the data with its scores."""
    scores = ", ".join(number(float(each.shown(each.y)[row])) for each in data)
    return f"{int(data[0].numbered(np.array([row]))[0])}: {scores}"
