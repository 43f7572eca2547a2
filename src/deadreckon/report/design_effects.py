"""Sections about the fitted model: what each variable does on average, and around one proposal."""

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import MOST, ROWS, Effect, cuts
from deadreckon.mbo.first_choice import shown_interval
from deadreckon.report.design_edges import shown_value
from deadreckon.report.effects import Panel, panel
from deadreckon.report.forest import robust
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import breakable, figure, note
from deadreckon.report.text import number
from deadreckon.stats.interval import NORMAL, PERCENT, Interval

OPEN = 12  # variables that are shown at once; the others are folded away
AROUND = 8  # likewise around a proposal


def on_average(data: Designs, made: Proposals, effects: list[Effect]) -> Markup | None:
    """What each variable does on average, the greatest change first."""
    if made.fitted is None or not effects:
        return None
    drawn = _panels(data, made, effects, None)
    captions = [_caption(data, each, len(effects), not made.by_chance) for each in effects]
    untested = " It is not known whether effects differ from none." if made.quality is None else ""
    parts = [
        f"Each curve is the prediction averaged over {min(len(data), ROWS):,} rows of the data in which the variable has the "
        "value shown and the others are as they are (partial dependence).",
        f"Vertical axis: {'the order by the model' if made.fitted.is_order else f'predicted {data.target}'}, the same for all.",
    ]
    if any(each.std is not None for each in effects):
        parts.append(f"Bands and whiskers: {PERCENT} interval of this average, calibrated on unseen rows.")
    if any(each.equal for each in data.rules.linear):
        parts.append("Parts that must sum to a number make room for one another in their proportions.")
    parts.append("Marks along the axis are values of the data; between and beyond them there is only the model.")
    parts.append("The effects of variables that change together in the data cannot be separated.")
    left = int((np.ptp(data.x, axis=0) > 0).sum()) - len(effects)
    if left:
        parts.append(f"These are the {MOST} variables with the greatest changes; {left:,} are left out.")
    warning = f"{made.warning.capitalize()}.{untested} " if made.warning else None
    said = tag("p", warning, "This is what the fitted model says, not what is true.")
    return join(said, note(" ".join(parts)), _folded(drawn, captions, OPEN))


def around(data: Designs, made: Proposals, chosen: int, effects: list[Effect]) -> Markup | None:
    """Cuts through one proposal: one variable changes, the others are held."""
    if made.fitted is None or not effects:
        return None
    fixed = {column for column, _ in data.rules.fixed}
    found = cuts(data, made.fitted, made.x[chosen], [each.column for each in effects if each.column not in fixed])
    found.sort(key=lambda each: -each.change)
    best = None if made.fitted.is_order else float(data.shown(data.y.max()))
    drawn = _panels(data, made, found, best, made.x[chosen])
    captions = [join(breakable(data.variables[each.column].name), _held(data, made.x[chosen], each.column)) for each in found]
    dashed = any(each.allowed is not None and not each.allowed.all() for each in found)
    sums = any(each.equal for each in data.rules.linear)
    calibrated = ", by the model, not calibrated" if made.quality is None else ""
    dotted = "" if best is None else " Dotted line: best score of the data."
    text = (
        f"The prediction as one variable of proposal {chosen} changes and the others are held; the marker is the proposal."
        f"{dotted}{' Dashed or hollow: what bounds or rules do not allow.' if dashed else ''} "
        + (f"Bands and whiskers: {PERCENT} interval{calibrated}. " if found and found[0].std is not None else "")
        + ("Parts that must sum to a number make room for the one that changes, unless they are fixed. " if sums else "")
        + "A flat curve says that this setting need not be exact, a steep one that it must be."
    )
    return join(note(text), _folded(drawn, captions, AROUND))


def _panels(
    data: Designs, made: Proposals, effects: list[Effect], reference: float | None, design: np.ndarray | None = None
) -> list[Markup]:
    """A drawing of each effect, all with the same axis of predictions."""
    assert made.fitted is not None
    order = made.fitted.is_order
    means = [each.mean if order else data.shown(each.mean) for each in effects]
    stds = [None if order or each.std is None else each.half / NORMAL * each.std for each in effects]
    intervals = [shown_interval(data, each.mean, std) for each, std in zip(effects, stds)]
    points = [float(v) for mean in means for v in mean]
    spreads = [Interval(*map(float, each)) for mean, ends in zip(means, intervals) for each in zip(mean, *ends)]
    ends = robust(points if reference is None else [*points, reference], [each for each in spreads if np.isfinite(each.low)])
    drawn = []
    for each, mean, (low, high) in zip(effects, means, intervals):
        v = data.variables[each.column]
        drawn.append(
            panel(
                Panel(
                    v.name, "order by the model" if order else f"{data.target}, predicted", each.values, mean, low, high, ends,
                    levels=tuple(map(str, v.levels)), log=v.log, faint=None if each.allowed is None else ~each.allowed,
                    here=None if design is None else float(design[each.column]), rows=data.x[:, each.column],
                    reference=reference,
                )
            )
        )  # fmt: skip
    return drawn


def _caption(data: Designs, effect: Effect, variables: int, ranks: bool) -> Markup:
    """The name, and the change in words; of a model that does not rank unseen designs no change is significant."""
    text = f"changes the average by {number(effect.change)}"
    if effect.change_std is not None:
        text += f" \N{PLUS-MINUS SIGN} {number(effect.half * effect.change_std)}"
    if effect.rows is not None:
        low, high = (number(end) for end in effect.rows)
        text += f", single rows by {low} to {high}"
    if not ranks or effect.distinct(variables) is False:
        depends = ranks and effect.depends(variables)
        text += "; depends on other variables" if depends else "; not distinguishable from no effect"
    return join(breakable(data.variables[effect.column].name), tag("small", text))


def _held(data: Designs, design: np.ndarray, column: int) -> Markup:
    value = data.decode(design[None])[data.variables[column].name][0]
    return tag("small", f"here {shown_value(value)}")


def _folded(drawn: list[Markup], captions: list[Markup], shown: int) -> Markup:
    """Figures, the first at once and the others behind a line to click on."""
    figures = [figure(each, caption) for each, caption in zip(drawn, captions)]
    first = tag("div", figures[:shown], class_="charts")
    if len(figures) <= shown:
        return first
    rest = tag("div", figures[shown:], class_="charts")
    return join(first, tag("details", tag("summary", f"{len(figures) - shown:,} more variables, with smaller changes"), rest))
