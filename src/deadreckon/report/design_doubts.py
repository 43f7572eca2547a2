"""What the models of a page of proposals do not know, from measured figures."""

from collections.abc import Sequence

import numpy as np

from deadreckon.mbo.batch import repeats_told
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import Effect
from deadreckon.mbo.first_choice import FAR
from deadreckon.mbo.misfits import misfits_told
from deadreckon.mbo.nn_distance import distance_to_others
from deadreckon.mbo.unscored import unscored_told
from deadreckon.mbo.validation import Quality
from deadreckon.report.design_edges import at_ends, at_rules, placed
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.text import number, words
from deadreckon.stats.interval import LEVEL

TOGETHER = 0.9  # correlation from which on two variables are said to vary together
MANY = 500  # variables beyond which their correlations are not looked at
NEAR = 0.5  # typical distances to another proposal, within which one is told that they are nearly the same
TOP = 0.1  # share of the rows with the highest predictions, whose optimism is told
TRUSTED = 0.9  # share of what is predicted that came true, below which it is told


def doubts(data: Designs, made: Proposals, far: np.ndarray, effects: list[Effect]) -> Markup:
    """What the model does not know, each as a sentence from measured figures."""
    idle = {each.column for each in effects if each.distinct(len(effects)) is False and not each.depends(len(effects))}
    lines = [
        *_of_quality(data, made),
        *_of_batch(data, made, far, idle, not made.by_chance),
        *_of_effects(data, made, effects),
        *_of_correlation(data),
    ]
    return _listing(lines)


def doubts_of_several(data: Sequence[Designs], made: Sequence[Proposals], far: np.ndarray) -> Markup:
    """The same of several targets: of each model, and of the proposals, which are the same for all."""
    parts = [
        join(tag("h3", f"The model of {each.target}"), _listing(_of_quality(each, proposals)))
        for each, proposals in zip(data, made)
    ]
    lines = [*_of_batch(data[0], made[0], far, set(), not all(each.by_chance for each in made)), *_of_correlation(data[0])]
    return join(*parts, tag("h3", "The proposals"), _listing(lines))


def _listing(lines: list[str]) -> Markup:
    return tag("ul", [tag("li", line) for line in lines], class_="plain")


def _of_batch(data: Designs, made: Proposals, far: np.ndarray, idle: set[int], ranks: bool) -> list[str]:
    """Of the proposals: where they lie, and, where any model `ranks`, at which ends they stand."""
    return [
        *_of_distance(data, made, far),
        *(f"{line}." for line in (*repeats_told(data, made.x), *unscored_told(data, made.x))),
        *_of_each_other(data, made, ranks),
        *_of_extrapolation(data, made),
        *(_of_ends(data, made, idle) if ranks else []),
    ]


def _of_quality(data: Designs, made: Proposals) -> list[str]:
    quality = made.quality
    if made.requested:
        return [f"{made.method} has no model that predicts scores: whether its designs reach the requested score is not known."]
    if quality is None:
        return ["How well the method predicts unseen rows was not measured, so its predictions may be worthless."]
    rows = f"{len(quality.observed):,} rows"
    lines = []
    if quality.rank_correlation > quality.limit:
        lines.append(
            f"Rows that it had not seen ({rows}) it ranks with a rank correlation of {_plain(quality.rank_correlation)} (1 is "
            "the right order, 0 is chance)."
        )
    else:
        lines.append(
            f"Its order of unseen rows cannot be distinguished from chance: the rank correlation is "
            f"{_plain(quality.rank_correlation)} over {rows}, and chance alone gives up to {_plain(quality.limit)} in 39 of 40 "
            "tables of this size."
        )
    if not quality.scored:
        return lines
    if quality.r2 > 0:
        lines.append(
            f"Of the variance of these scores it predicts {quality.r2:.0%} (R2); the rest is noise, or was not learned."
        )
    else:
        lines.append(f"The mean score of the table predicts unseen rows better than the model does (R2 {_plain(quality.r2)}).")
    named = f"{data.target}: "  # a column keeps its case
    lines += [f"{line if line.startswith(named) else line[:1].upper() + line[1:]}." for line in misfits_told(data, quality)]
    lines.append(_of_optimism(data, quality))
    return [*lines, *_of_calibration(quality)]


def _of_calibration(quality: Quality) -> list[str]:
    """What was made of predictions and intervals by what they were worth."""
    calibration = quality.calibration
    assert calibration is not None
    if not quality.skilled:
        return [
            "Predictions of proposals are shrunk to what holds on unseen rows, and their intervals are as wide as scores "
            "scatter around that."
        ]
    lines = [
        f"{quality.coverage:.0%} of these scores lie in their {LEVEL:.0%} intervals. Of proposals, which are chosen for their "
        "predictions, fewer may."
    ]
    if calibration.b < TRUSTED:
        lines.append(
            f"On unseen rows only {calibration.b:.0%} of the deviation of predictions from their mean came true, and "
            "only that is kept for the proposals."
        )
    return lines


def _of_optimism(data: Designs, quality: Quality) -> str:
    """How predictions that are the highest of many compare with their scores, and the typical error."""
    count = max(1, round(TOP * len(quality.observed)))
    mean, top = quality.crosswise[0], np.argsort(-quality.predicted, kind="stable")[:count]
    said, was = (number(float(data.shown(each[top].mean()))) for each in (mean, quality.observed))
    error = number(float(np.median(np.abs(quality.observed - mean))))
    best = "lowest" if data.minimise else "highest"
    return (
        f"Half of its predictions of unseen rows miss by more than {error}; for the {count:,} rows with the {best} predictions "
        f"it predicted {said} on average, and the scores were {was}."
    )


def _of_distance(data: Designs, made: Proposals, far: np.ndarray) -> list[str]:
    count, middle = int((far > FAR).sum()), number(float(np.median(far)))
    if not count:
        return [
            f"No proposal lies more than {FAR:g} typical distances from a scored row; half of them lie more than {middle} away."
        ]
    return [
        f"{count:,} of {len(made):,} proposals ({count / len(made):.0%}) {'lies' if count == 1 else 'lie'} more than {FAR:g} "
        "typical distances from any scored row, where no data supports the prediction."
    ]


def _of_each_other(data: Designs, made: Proposals, ranks: bool) -> list[str]:
    """Proposals that are nearly the same experiment."""
    if len(made) < 2 or (middle := float(np.median(distance_to_others(data, made.x)))) > NEAR:
        return []
    return [
        f"Half of the proposals lie within {number(middle)} typical distances of another one, and are likely to be right or "
        f"wrong together; a least distance between them (--apart 1) spreads them{', at some cost in predictions' * ranks}."
    ]


def _of_extrapolation(data: Designs, made: Proposals) -> list[str]:
    """Proposals outside what the data holds."""
    outside = np.zeros(len(made), bool)
    for i, v in enumerate(data.variables):
        seen, x = (placed(v, each.x[:, i]) for each in (data, made))
        slack = 1e-5 * max(float(np.ptp(seen)), 1e-30)
        outside |= ~np.isin(x, seen) if v.kind == "categorical" else (x < seen.min() - slack) | (x > seen.max() + slack)
    if not outside.any():
        return []
    return [
        f"{int(outside.sum()):,} of {len(made):,} proposals have a value beyond the data, or a level that no row has: "
        "there the model extrapolates."
    ]


def _of_ends(data: Designs, made: Proposals, idle: set[int]) -> list[str]:
    """Where half of the proposals are at an end of what is allowed; `idle` variables are not known to matter."""
    lines = []
    if ends := at_ends(data, made.x, idle | {column for column, _ in data.rules.fixed}):
        lines.append(f"Of {len(made):,} proposals, {words(ends)} of what is allowed: better values may lie beyond.")
    if rules := at_rules(data, made.x):
        lines.append(f"Of {len(made):,} proposals, {words(rules)}: better values may lie beyond.")
    return lines


def _of_effects(data: Designs, made: Proposals, effects: list[Effect]) -> list[str]:
    if effects and made.by_chance:
        return ["For the same reason, the effects of variables cannot be distinguished from zero either."]
    if made.quality is None and made.fitted is not None and made.fitted.averages is not None and effects:
        return ["Whether effects of variables differ from none is not known either, because predictions were not tested."]
    known = [each for each in effects if each.distinct(len(effects)) is not None]
    if made.fitted is not None and effects and not known:
        return [
            f"Whether effects of variables differ from none is not known: {made.method} does not estimate their uncertainty."
        ]
    flat = [each for each in known if not each.distinct(len(effects)) and not each.depends(len(effects))]
    turning = [each for each in known if each.depends(len(effects))]
    name = lambda each: data.variables[each.column].name  # noqa: E731
    lines = []
    if flat and len(flat) == len(known):
        lines.append("The effect of no variable can be distinguished from zero in this data.")
    elif flat:
        lines.append(
            f"The {'effects' if len(flat) > 1 else 'effect'} of {_listed(list(map(name, flat)))} cannot be distinguished from "
            f"zero in this data ({len(flat):,} of {len(known):,} variables), which is not the same as having none."
        )
    if turning:
        lines.append(
            f"{'Effects' if len(turning) > 1 else 'The effect'} of {_listed(list(map(name, turning)))} "
            f"{'depend' if len(turning) > 1 else 'depends'} on the other variables: on average it cannot be distinguished from "
            "zero, in single rows it can."
        )
    return lines


def _of_correlation(data: Designs) -> list[str]:
    """Variables whose effects cannot be told apart, since they vary together."""
    numeric = data.coordinates.numeric
    varied = np.ptp(data.x[:, numeric], axis=0) > 0
    columns = [int(i) for i in numeric[varied]]
    if not 1 < len(columns) <= MANY:
        return []
    # As the models see them: the values of a variable on a log scale are correlated less than their logarithms.
    seen = data.coordinates.encode(data.x)[:, : len(numeric)][:, varied]
    found = np.asarray(np.corrcoef(seen.astype(np.float64), rowvar=False))
    pairs = [(i, j) for i in range(len(columns)) for j in range(i) if abs(found[i, j]) >= TOGETHER]
    pairs.sort(key=lambda pair: -abs(found[pair]))
    if not pairs:
        return []
    name = lambda i: data.variables[columns[i]].name  # noqa: E731
    said = [f"{name(j)} and {name(i)} (correlation {_plain(float(found[i, j]))})" for i, j in pairs[:3]]
    more = f", and {len(pairs) - 3:,} more pairs" if len(pairs) > 3 else ""
    return [f"Effects of variables that vary together in the data cannot be separated: {'; '.join(said)}{more}."]


def _listed(names: list[str]) -> str:
    return words(names) if len(names) <= 8 else f"{', '.join(names[:8])} and {len(names) - 8:,} more"


def _plain(value: float) -> str:
    return f"{value:.2f}".replace("-", "\N{MINUS SIGN}")
