"""The page about proposed designs: which to try first, what is predicted of them, and what the model says and does not know."""

from pathlib import Path

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import averages, best_permitted, most_expected
from deadreckon.mbo.first_choice import FAR, first_choice
from deadreckon.mbo.problems.problem import Scores
from deadreckon.report import charts
from deadreckon.report.design_advice import one_to_try, rule_note
from deadreckon.report.design_asked import asked, learned_from
from deadreckon.report.design_doubts import doubts
from deadreckon.report.design_effects import around, on_average
from deadreckon.report.design_table import proposals_table
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number
from deadreckon.stats.interval import NORMAL, PERCENT

POINTS = 300  # designs in the chart of quality
MANY = 500  # variables beyond which their effects are not looked at


def write_design(data: Designs, made: Proposals, far: np.ndarray, out: Path | str, scores: Scores | None = None) -> Path:
    """Writes one self-contained HTML page about proposals.

    Args:
        data: the scored designs that they rest on.
        made: the proposals.
        far: (n,) how far each lies from the data (`mbo.nn_distance`).
        out: the page; an old one is replaced.
        scores: their true scores, where there is an oracle.
    """
    what = "Requested" if made.requested else "Predicted"
    title = f"{what} and true scores" if scores else f"{what} scores and distances to the data"
    effects = averages(data, made.fitted) if made.fitted is not None and len(data.variables) <= MANY else []
    chosen = first_choice(made, far)
    sections: list[tuple[str, str, Markup | None]] = [
        ("one", "If only one is tried", join(one_to_try(data, made, far), None if chosen is None else rule_note(made))),
        ("doubts", "What the model does not know", doubts(data, made, far, effects)),
        ("asked", "What was asked", asked([data], len(made))),
        ("designs", "Designs", proposals_table([data], [made], far, scores)),
        ("predicted", title, _chart(data, made, far, scores)),
        ("quality", "Predicted and observed scores, out of fold", _quality(data, made)),
        ("variables", "What each variable does, by the model", on_average(data, made, effects)),
        ("around", f"Around proposal {chosen}", None if chosen is None else around(data, made, chosen, effects)),
    ]
    counts = ("training data", learned_from(data))
    facts = [("method", made.method), ("data", data.name), counts, ("seed", str(made.seed))]
    text = document(f"{len(made):,} designs for {data.target}", _lead(data, made, far, scores), facts, sections)
    return save_page(text, out)


def _lead(data: Designs, made: Proposals, far: np.ndarray, scores: Scores | None) -> str:
    """The most important thing in a sentence or two."""
    best, within = (number(float(data.shown(data.y[row]))) for row in (int(data.y.argmax()), best_permitted(data)))
    warning = made.warning if scores is None else None
    parts = [f"{warning.capitalize()}."] if warning else []
    parts.append(f"The best of the data has {data.target} {best}{'' if within == best else f', within the rules {within}'}.")
    if made.predicts and not made.by_chance:
        measured = ""
        if made.fitted is not None:  # the best measurement may be a lucky one, and is no measure of a prediction
            expected = number(float(data.shown(most_expected(data, made.fitted)[1])))
            measured = f"; the best prediction for a measured design is {expected}"
        what = "measured score of the proposals" if made.measured else f"{made.how} score"
        parts.append(f"The best {what} is {number(float(data.shown(made.predicted.max())))}{measured}.")
    if scores is not None:
        best_true, middle = (number(data.shown(scores.percentile(q))) for q in (100, 50))
        parts.append(f"By the oracle, the best of them has {best_true} and the median {middle}.")
    share = float((far > FAR).mean())
    if share > 0:
        parts.append(f"{share:.0%} lie more than {FAR:g} typical distances from any scored design, without support by data.")
    return " ".join(parts)


def _chart(data: Designs, made: Proposals, far: np.ndarray, scores: Scores | None) -> Markup:
    if not made.predicts or made.measured:
        return note(f"{made.method} predicts no scores.")
    across = far if scores is None else data.shown(scores.true)
    half = np.where(np.isfinite(made.predicted_std), NORMAL * made.predicted_std, np.nan)
    value = data.shown(made.predicted)
    points = [
        (f"design {i}", 0, float(across[i]), 0.0, float(value[i]), float(value[i] - half[i]), float(value[i] + half[i]))
        for i in range(len(made))
    ]
    unit = "typical distances to the data" if scores is None else f"{data.target}, true"
    if made.requested:
        what, above = "requested", "the true score is lower than the requested one"
        text = "The method makes its designs for the requested score; no model predicts which score they have."
    else:
        what, above = "predicted", "the score is overestimated"
        calibrated = "" if made.quality else ", by the model, not calibrated"
        text = f"Whiskers: {PERCENT} interval of {made.of_what}{calibrated}, where the method gives a standard deviation."
    text += (
        " A typical distance is the median distance of a scored design to its nearest neighbour, in standardised coordinates."
    )
    if scores is not None:
        text += f" Above the dashed line {above}."
    drawn = charts.scatter(points, unit, f"{data.target}, {what}", diagonal=scores is not None)
    return join(tag("div", figure(drawn), class_="charts two"), note(text))


def _quality(data: Designs, made: Proposals) -> Markup | None:
    """How well the method predicts designs of the data that it did not see."""
    quality = made.quality
    if quality is None:
        return None
    mean, std = quality.corrected
    scored, half, observed = quality.scored, NORMAL * std, data.shown(quality.observed)
    predicted = data.shown(mean) if scored else mean
    rows = np.linspace(0, len(observed) - 1, min(len(observed), POINTS)).astype(int)
    low, high = predicted - half, predicted + half
    value = lambda of, i: float(of[i])  # noqa: E731
    whole = len(observed) == len(data)  # else some were drawn, whose numbers are not known here
    names = [f"row {row}" if whole else "a held-out row" for row in data.numbered(np.arange(len(observed)))]
    points = [(names[i], 0, value(observed, i), 0.0, value(predicted, i), value(low, i), value(high, i)) for i in rows]
    up = f"{data.target}, predicted" if scored else "order by the model, the best above"
    drawn = charts.scatter(points, f"{data.target}, observed", up, diagonal=scored)
    corrected = "" if quality.calibration is None else (
        " Predictions and their standard deviations, those of proposals too, are corrected by their errors on these "
        f"designs, so that the {PERCENT} interval covers its share of them; R2 is of uncorrected predictions. The interval is "
        "for a new measurement, not for the true score, which is not known."
    )
    text = (
        f"{quality}. Each design was predicted by a model that was fitted without it ({len(observed):,} in all, {len(rows):,} "
        f"are shown).{corrected} Proposals lie at the edge of the data or beyond, where errors may be larger."
    )
    return join(tag("div", figure(drawn), class_="charts two"), note(text), _compared(made))


def _compared(made: Proposals) -> Markup:
    """Which methods were tried, and why one was taken."""
    if not made.compared:
        return join()
    rows = []
    for each in made.compared:
        shown = [each.r2, each.rank_correlation, each.coverage]
        cells = [tag("td", f"{value:.2f}" if np.isfinite(value) else "-") for value in shown]
        rows.append(tag("tr", [tag("th", each.method, scope="row"), *cells]))
    head = heads_of(["method", "R2", "rank correlation", "in the interval"])
    text = f"Out of fold, by method: {made.reason}. The quality of the best of several is overestimated."
    return join(scroll(tag("table", head, tag("tbody", rows))), note(text))
