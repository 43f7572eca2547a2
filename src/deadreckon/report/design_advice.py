"""What a page of proposals advises: the one to try if only one is tried."""

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import best_permitted, most_expected
from deadreckon.mbo.first_choice import FAR, first_choice, interval, shown_interval, tested_std
from deadreckon.mbo.nn_distance import neighbours
from deadreckon.mbo.unscored import NEAREST, missing_near, prevail
from deadreckon.report.design_asked import broken_rule, row_name
from deadreckon.report.design_edges import shown_value
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import breakable, note
from deadreckon.report.text import number
from deadreckon.stats.interval import PERCENT


def one_to_try(data: Designs, made: Proposals, far: np.ndarray) -> Markup:
    """The proposal to try if only one is, with why; or why there is none."""
    chosen = first_choice(made, far)
    if chosen is None:
        return tag("div", tag("p", _no_choice(data, made), class_="because"), class_="card")
    low, high = (float(end[chosen]) for end in shown_interval(data, made.predicted, tested_std(made)))
    distances, rows = (each[0] for each in neighbours(data, made.x[chosen : chosen + 1], 1))
    near = int(rows[0])
    values = {name: column[0] for name, column in data.decode(made.x[chosen : chosen + 1]).items()}
    settings = [tag("div", tag("dt", breakable(name)), tag("dd", shown_value(value))) for name, value in values.items()]
    predicted, best, within = number(float(data.shown(made.predicted)[chosen])), int(data.y.argmax()), best_permitted(data)
    breaks = "" if broken_rule(data, best) is None else ", breaks a rule"
    inside = [] if within == best else [
        _tile("best within the rules", number(float(data.shown(data.y[within]))), row_name(data, within))
    ]  # fmt: skip
    tiles = [
        _tile(
            f"predicted {data.target}",
            predicted,
            None if np.isnan(low) else f"{PERCENT} interval {number(low)} to {number(high)}",
        ),
        _tile("best of the data", number(float(data.shown(data.y[best]))), row_name(data, best) + breaks),
        *inside,
        _tile("distance to the data", number(float(distances[0])), "typical distances"),
        _tile("nearest scored row", row_name(data, near), f"{data.target} {number(float(data.shown(data.y)[near]))}"),
    ]
    return tag(
        "div",
        tag("p", tag("strong", f"Proposal {chosen}", class_="stamp"), class_="which lesser"),
        tag("p", _why(data, made, far, chosen), class_="because"),
        tag("dl", settings, class_="settings"),
        tag("div", tiles, class_="tiles"),
        class_="card",
    )  # fmt: skip


def _no_choice(data: Designs, made: Proposals) -> str:
    best, row = number(float(data.shown(data.y.max()))), row_name(data, int(data.y.argmax()))
    known = f"The best score of the table is {best}, in {row}."
    if made.fitted is None:
        return f"{made.method} has no model of {data.target}, so no proposal can be preferred. {known}"
    assert made.quality is not None  # else it would not be doubted
    return (
        f"None of the proposals is preferred: {made.quality.doubt}, so what the model expects of one more than of another, or "
        f"of any more than of a design drawn at random, may be luck. {known}"
    )


def _why(data: Designs, made: Proposals, far: np.ndarray, chosen: int) -> str:
    """By which rule it was chosen, and how its prediction compares with the data."""
    lower, highest = ("upper", "lowest") if data.minimise else ("lower", "highest")
    near = int((far <= FAR).sum())
    of = f"the {len(made):,} proposals" if near in (0, len(made)) else (
        f"the {near:,} proposals within {FAR:g} typical distances of a scored row"
    )  # fmt: skip
    if not made.predicts:
        return f"The model ranks it first among {of}. {made.method} learns an order and predicts no scores."
    ends = shown_interval(data, made.predicted, tested_std(made))
    end = float((ends[1] if data.minimise else ends[0])[chosen])
    if np.isnan(made.predicted_std[chosen]):
        rule = f"Among {of} it has the {highest} prediction; {made.method} gives no standard deviation."
    elif made.quality is None:
        rule = f"Among {of} it has the {highest} prediction, which was not tested on unseen rows and may be worthless."
    else:
        rule = f"Among {of} the {lower} end of its {PERCENT} interval, {number(end)}, is the {highest}."
    return f"{rule} {_compared(data, made, chosen)}{_without_score(data, made, chosen)}"


def _without_score(data: Designs, made: Proposals, chosen: int) -> str:
    """That rows without a score prevail around it, if they do."""
    own = made.x[[chosen]]
    if not prevail(data, own)[0]:
        return ""
    return (
        f" But rows without a score prevail around it ({missing_near(data, own)[0]} of the {NEAREST} nearest): if these runs "
        "failed, this one may, too, as the model knows nothing of failures."
    )


def _compared(data: Designs, made: Proposals, chosen: int) -> str:
    """How its prediction compares with those of measured rows, and with the best measurement."""
    above, below = ("below", "above") if data.minimise else ("above", "below")
    assert made.fitted is not None  # else none would be chosen
    row, expected = most_expected(data, made.fitted)
    mean, gain = float(made.predicted[chosen]), float(made.predicted[chosen]) - expected
    known = f"{row_name(data, row)}, {number(float(data.shown(expected)))}"
    if gain <= 0:
        compared = f"The prediction is not {above} that for {known}, so no gain over the measured designs is predicted."
    else:
        compared = f"The prediction is {number(gain)} {above} the best one for a measured design ({known})."
    best = best_permitted(data)
    shown_best = number(float(data.shown(data.y[best])))
    kept = "the data" if best == int(data.y.argmax()) else "rows that satisfy the rules"
    score = f"the best score of {kept}, {shown_best}"
    worst = interval(made.predicted, tested_std(made))[0][chosen]
    if worst > data.y[best]:
        return f"{compared} The whole interval is {above} {score}."
    if mean > data.y[best]:
        doubt = "" if np.isnan(worst) else f", but the interval reaches {below} it: one measurement of it may be no better"
        return f"{compared} It is {above} {score}{doubt}."
    return f"{compared} It is not {above} {score}, part of which may be the noise of that measurement."


def _tile(name: str, value: str, more: str | None) -> Markup:
    return tag("div", tag("small", name), tag("b", value), tag("span", more) if more else None, class_="tile")


def rule_note(made: Proposals) -> Markup:
    """By which rule the proposal is chosen."""
    return note(
        f"Rule: the proposal whose {PERCENT} interval has the best lower end (the upper end where the target is to be small), "
        "or the best prediction where the method gives no interval or its intervals were not tested, among those within "
        f"{FAR:g} typical distances of a scored row. The interval is of {made.of_what}. Rows are counted from 0, without the "
        "line of names; proposals are the rows of proposals.csv, counted likewise."
    )
