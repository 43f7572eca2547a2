"""What a page of proposals advises: the one to try if only one is tried, and what the model does not know."""

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import Effect
from deadreckon.mbo.first_choice import FAR, first_choice, shown_interval
from deadreckon.mbo.nn_distance import distance_to_others, neighbours
from deadreckon.mbo.validation import SHARE, Quality
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import breakable, note
from deadreckon.report.text import number, words
from deadreckon.stats.interval import PERCENT

TOGETHER = 0.9  # correlation from which on two variables are said to vary together
MANY = 500  # variables beyond which their correlations are not looked at
NEAR = 0.5  # usual distances to another proposal, within which one is told that they are nearly the same
TOP = 0.1  # share of the rows with the highest predictions, whose optimism is told


def one_to_try(data: Designs, made: Proposals, far: np.ndarray) -> Markup:
    """The proposal to try if only one is, with why; or why there is none."""
    chosen = first_choice(made, far)
    if chosen is None:
        return tag("div", tag("p", _no_choice(data, made), class_="because"), class_="card")
    low, high = (float(end[chosen]) for end in shown_interval(data, made.predicted, made.predicted_std))
    distances, rows = (each[0] for each in neighbours(data, made.x[chosen : chosen + 1], 1))
    near = int(rows[0])
    values = {name: column[0] for name, column in data.decode(made.x[chosen : chosen + 1]).items()}
    settings = [tag("div", tag("dt", breakable(name)), tag("dd", shown_value(value))) for name, value in values.items()]
    predicted = number(float(data.shown(made.predicted)[chosen]))
    tiles = [
        _tile(
            f"predicted {data.target}",
            predicted,
            None if np.isnan(low) else f"{PERCENT} interval {number(low)} to {number(high)}",
        ),
        _tile("best of the data", number(float(data.shown(data.y.max()))), _row(data, int(data.y.argmax()))),
        _tile("distance to the data", number(float(distances[0])), "usual distances"),
        _tile("nearest scored row", _row(data, near), f"{data.target} {number(float(data.shown(data.y)[near]))}"),
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
    best, row = number(float(data.shown(data.y.max()))), _row(data, int(data.y.argmax()))
    known = f"What the table shows is that its best score is {best}, in {row}."
    if made.fitted is None:
        return f"{made.method} has no model of {data.target}, so nothing says which proposal to prefer. {known}"
    return (
        "None of the proposals is preferred: the model ranks rows that it has not seen no better than chance, so the table "
        "gives no reason to expect more of one than of another, nor of any of them more than of a design drawn at random. "
        f"{known}"
    )


def _why(data: Designs, made: Proposals, far: np.ndarray, chosen: int) -> str:
    """By which rule it was chosen, and how its prediction compares with the best of the data."""
    lower, above, below = ("upper", "below", "above") if data.minimise else ("lower", "above", "below")
    highest = "lowest" if data.minimise else "highest"
    near = int((far <= FAR).sum())
    of = f"the {len(made):,} proposals" if near in (0, len(made)) else (
        f"the {near:,} proposals within {FAR:g} usual distances of a scored row"
    )  # fmt: skip
    best, mean = float(data.y.max()), float(made.predicted[chosen])
    shown_best = number(float(data.shown(best)))
    if not made.predicts:
        return f"The model ranks it first among {of}. {made.method} learns an order and predicts no scores."
    ends = shown_interval(data, made.predicted, made.predicted_std)
    end = float((ends[1] if data.minimise else ends[0])[chosen])
    if np.isnan(end):
        rule = f"Among {of} it has the {highest} prediction; {made.method} gives no standard deviation."
    else:
        rule = f"Among {of} the {lower} end of its {PERCENT} interval, {number(end)}, is the {highest}."
    if mean <= best:
        return f"{rule} The prediction is not {above} the best score of the data, {shown_best}, so no gain is predicted."
    if np.isnan(end) or data.shown(end) <= best:
        doubt = "" if np.isnan(end) else f", but the interval reaches {below} it: the proposal may score no better"
        return f"{rule} The prediction is {above} the best score of the data, {shown_best}{doubt}."
    return f"{rule} The whole interval is {above} the best score of the data, {shown_best}."


def _tile(name: str, value: str, more: str | None) -> Markup:
    return tag("div", tag("small", name), tag("b", value), tag("span", more) if more else None, class_="tile")


def _row(data: Designs, i: int) -> str:
    """A row of the table, as messages call it; how many measurements it is the mean of, where these are several."""
    count = 1 if data.replicates is None else int(data.replicates[i])
    return f"row {int(data.numbered(np.array([i]))[0]):,}" + (f" (mean of {count})" if count > 1 else "")


def shown_value(value: object) -> str:
    """A value of a variable as tables show it."""
    return number(value) if isinstance(value, float) else str(value)


def doubts(data: Designs, made: Proposals, far: np.ndarray, effects: list[Effect]) -> Markup:
    """What the model does not know, each as a sentence from measured figures."""
    lines = [
        *_of_quality(data, made),
        *_of_distance(data, made, far),
        *_of_each_other(data, made),
        *_of_ends(data, made, effects),
        *_of_effects(data, made, effects),
    ]
    lines += _of_correlation(data)
    return tag("ul", [tag("li", line) for line in lines], class_="plain")


def _of_quality(data: Designs, made: Proposals) -> list[str]:
    quality = made.quality
    if quality is None:
        return ["How well the method predicts rows that it has not seen was not measured: its predictions may rest on nothing."]
    rows = f"{len(quality.observed):,} rows"
    lines = []
    if quality.skilled:
        lines.append(
            f"Rows that it had not seen ({rows}) it ranks with a rank correlation of {_plain(quality.rank_correlation)} (1 is "
            "the right order, 0 is chance)."
        )
    else:
        lines.append(
            f"It ranks rows that it has not seen no better than chance: their rank correlation is "
            f"{_plain(quality.rank_correlation)} over {rows}."
        )
    if quality.r2 > 0:
        lines.append(
            f"Of the variance of these scores it predicts {quality.r2:.0%} (R2); what is left is noise, or was not learned."
        )
    else:
        lines.append(f"The mean score of the table predicts unseen rows better than the model does (R2 {_plain(quality.r2)}).")
    lines.append(_of_optimism(data, quality))
    lines.append(
        f"{quality.coverage:.0%} of these scores lie in their {SHARE:.0%} intervals; the standard deviations were multiplied "
        f"by {number(quality.factor)} for that. Of proposals, which are chosen for their predictions, fewer may."
    )
    return lines


def _of_optimism(data: Designs, quality: Quality) -> str:
    """How predictions that are the highest of many compare with their scores, and the typical error."""
    count = max(1, round(TOP * len(quality.observed)))
    top = np.argsort(-quality.predicted, kind="stable")[:count]
    said, was = (number(float(data.shown(each[top].mean()))) for each in (quality.predicted, quality.observed))
    error = number(float(np.median(np.abs(quality.observed - quality.predicted))))
    best = "lowest" if data.minimise else "highest"
    return (
        f"Half of its predictions of unseen rows miss by more than {error}; for the {count:,} rows with the {best} predictions "
        f"it predicted {said} on average, and the scores were {was}."
    )


def _of_distance(data: Designs, made: Proposals, far: np.ndarray) -> list[str]:
    count, middle = int((far > FAR).sum()), number(float(np.median(far)))
    if not count:
        return [
            f"No proposal lies more than {FAR:g} usual distances from a scored row; half of them lie more than {middle} away."
        ]
    return [
        f"{count:,} of {len(made):,} proposals ({count / len(made):.0%}) {'lies' if count == 1 else 'lie'} more than {FAR:g} "
        "usual distances from any scored row, where no data supports the prediction."
    ]


def _of_each_other(data: Designs, made: Proposals) -> list[str]:
    """Proposals that are nearly the same experiment."""
    if len(made) < 2 or (middle := float(np.median(distance_to_others(data, made.x)))) > NEAR:
        return []
    return [
        f"Half of the proposals lie within {number(middle)} usual distances of another one, and are likely to be right or "
        "wrong together; a least distance between them (apart) spreads them, at the cost of lower predictions."
    ]


def _of_ends(data: Designs, made: Proposals, effects: list[Effect]) -> list[str]:
    """Proposals outside what the data holds, and at the ends of what is allowed in variables that are known to matter."""
    idle = {each.column for each in effects if each.distinct(len(effects)) is False and not each.depends(len(effects))}
    idle |= {column for column, _ in data.rules.fixed}
    outside, at = np.zeros(len(made), bool), []
    for i, v in enumerate(data.variables):
        seen, x = data.x[:, i], made.x[:, i]
        if v.kind == "categorical":
            outside |= ~np.isin(x, seen)
            continue
        slack = 1e-5 * max(float(np.ptp(seen)), 1e-30)
        outside |= (x < seen.min() - slack) | (x > seen.max() + slack)
        if i in idle or v.low == v.high:
            continue
        for end, name in ((v.low, "lower"), (v.high, "upper")):
            count = int((np.abs(x - end) <= slack).sum()) if np.isfinite(end) else 0
            if 2 * count >= len(made):
                at.append((count, f"in {count:,} {v.name} is at its {name} end ({shown_value(data_value(v, end))})"))
    lines = []
    if outside.any():
        lines.append(
            f"{int(outside.sum()):,} of {len(made):,} proposals have a value beyond the data, or a level that no row has: "
            "there the model extrapolates."
        )
    if at:
        said = words([text for _, text in sorted(at, key=lambda each: -each[0])[:5]])
        lines.append(f"Of {len(made):,} proposals, {said} of what is allowed: better values may lie beyond.")
    return lines


def data_value(v: object, value: float) -> object:
    """A value that a design holds as tables have it: of an ordinal variable its level."""
    levels = getattr(v, "levels", ())
    return levels[int(value)] if levels else int(value) if getattr(v, "kind", "") == "integer" else float(value)


def _of_effects(data: Designs, made: Proposals, effects: list[Effect]) -> list[str]:
    if effects and made.quality is not None and not made.quality.skilled:
        return [
            "What it shows of the effects of variables cannot be told from none either, since it ranks no better than chance."
        ]
    known = [each for each in effects if each.distinct(len(effects)) is not None]
    if made.fitted is not None and effects and not known:
        return [
            f"Whether effects of variables differ from none is not known: {made.method} does not say how sure it is of them."
        ]
    flat = [each for each in known if not each.distinct(len(effects)) and not each.depends(len(effects))]
    turning = [each for each in known if each.depends(len(effects))]
    name = lambda each: data.variables[each.column].name  # noqa: E731
    lines = []
    if flat and len(flat) == len(known):
        lines.append("The effect of no variable can be told from none in this data.")
    elif flat:
        lines.append(
            f"The {'effects' if len(flat) > 1 else 'effect'} of {_listed(list(map(name, flat)))} cannot be told from none in "
            f"this data ({len(flat):,} of {len(known):,} variables), which is not the same as having none."
        )
    if turning:
        lines.append(
            f"What {_listed(list(map(name, turning)))} {'do' if len(turning) > 1 else 'does'} depends on the other variables: "
            "nothing that could be told on average, but something in single rows."
        )
    return lines


def _of_correlation(data: Designs) -> list[str]:
    """Variables whose effects cannot be told apart, since they vary together."""
    columns = [int(i) for i in data.coordinates.numeric if np.ptp(data.x[:, i]) > 0]
    if not 1 < len(columns) <= MANY:
        return []
    found = np.asarray(np.corrcoef(data.x[:, columns].astype(np.float64), rowvar=False))
    pairs = [(i, j) for i in range(len(columns)) for j in range(i) if abs(found[i, j]) >= TOGETHER]
    pairs.sort(key=lambda pair: -abs(found[pair]))
    if not pairs:
        return []
    name = lambda i: data.variables[columns[i]].name  # noqa: E731
    said = [f"{name(j)} and {name(i)} (correlation {_plain(float(found[i, j]))})" for i, j in pairs[:3]]
    more = f", and {len(pairs) - 3:,} more pairs" if len(pairs) > 3 else ""
    return [
        f"What one does cannot be told from what the other does, since they vary together in the data: {'; '.join(said)}{more}."
    ]


def _listed(names: list[str]) -> str:
    return words(names) if len(names) <= 8 else f"{', '.join(names[:8])} and {len(names) - 8:,} more"


def _plain(value: float) -> str:
    return f"{value:.2f}".replace("-", "\N{MINUS SIGN}")


def rule_note(made: Proposals) -> Markup:
    """By which rule the proposal is chosen."""
    return note(
        f"Rule: the proposal whose {PERCENT} interval has the best lower end (the upper end where the target is to be small), "
        f"or the best prediction where the method gives no interval, among those within {FAR:g} usual distances of a scored "
        f"row. The interval is of {made.of_what}. Rows are counted from 0, without the line of names; proposals are the rows "
        "of proposals.csv, counted likewise."
    )
