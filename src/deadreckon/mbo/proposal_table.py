"""The columns added to proposals in their table: predictions, intervals, distances, and the nearest scored designs."""

import math
from typing import Any

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import shown_interval
from deadreckon.mbo.front import Front
from deadreckon.mbo.nn_distance import neighbours
from deadreckon.stats.interval import PERCENT

# Descriptions of the columns, for one target or several.
MEAN = "what the model predicts"
ONE = "standard deviation of one new measurement, noise included"
TRUE = "standard deviation of the true score, by the model, not calibrated"
OF_MEAN = "standard deviation of the true score, by the model, multiplied as that of a measurement is by the calibration"
DISTANCE = "to the nearest scored row; 1 is the median distance of a scored row to its nearest neighbour"
NEAREST = "row of the data that is nearest, counted from 0 without the line of names"
# Columns that are written for each of several targets.
OF_TARGET = ("predicted", "predicted_std", "predicted_low", "predicted_high", "mean_std", "nearest_score")
DIGITS, EXACT = 6, 12  # significant digits of predictions, and of measured scores


def added_columns(data: Designs, made: Proposals, true: np.ndarray | None = None) -> dict[str, list[Any]]:
    """Columns to append to the variables; a name that a variable has gets an underscore.

    Args:
        data: scored designs.
        made: the proposals.
        true: (n,) scores of an oracle, where there is one.

    Returns:
        {name: (n,) values}: `predicted`, `predicted_std`, the ends of the 95 % interval `predicted_low` and `predicted_high`
        (all with the sign of the table's target), `mean_std` if the method separates the true score from noise, `distance` in
        typical distances between neighbours, `nearest_row` of the data (counted from 0) with its score `nearest_score`, and
        `true` if there is an oracle. Values that the method does not have are NaN.
    """
    far, rows = neighbours(data, made.x, 1)
    more = _predictions(data, made)
    more |= {"distance": rounded(far[:, 0], 1.0), "nearest_row": data.numbered(rows[:, 0]).tolist()}
    more["nearest_score"] = _measured(data, rows[:, 0])
    if true is not None:
        more["true"] = np.asarray(data.shown(true)).tolist()
    return {free_name(name, data): values for name, values in more.items()}


def added_columns_of_front(front: Front) -> dict[str, list[Any]]:
    """The same for several targets, whose names are appended to those of `OF_TARGET`; all share distance and nearest row."""
    first, x = front.data[0], front.made[0].x
    far, rows = neighbours(first, x, 1)
    more: dict[str, list[Any]] = {}
    for data, made in zip(front.data, front.made):
        more |= {f"{name}_{data.target}": values for name, values in _predictions(data, made).items()}
    more |= {"distance": rounded(far[:, 0], 1.0), "nearest_row": first.numbered(rows[:, 0]).tolist()}
    more |= {f"nearest_score_{data.target}": _measured(data, rows[:, 0]) for data in front.data}
    return {free_name(name, first): values for name, values in more.items()}


def _predictions(data: Designs, made: Proposals) -> dict[str, list[Any]]:
    low, high = shown_interval(data, made.predicted, made.predicted_std)
    more = {"predicted": data.shown(made.predicted), "predicted_std": made.predicted_std}
    more |= {"predicted_low": low, "predicted_high": high} | ({} if made.mean_std is None else {"mean_std": made.mean_std})
    spread = float(data.y.std())
    return {name: rounded(np.asarray(values), spread) for name, values in more.items()}


def rounded(values: np.ndarray, spread: float) -> list[float]:
    """Numbers with `DIGITS` significant digits, or more if they are large compared with `spread`, their standard deviation."""
    # At least to a thousandth of the spread, so that scores between 1064.001 and 1064.005 can be distinguished.
    size = np.minimum(np.where(values == 0, spread, np.abs(values)), 100 * spread)
    return [
        round(float(value), DIGITS - 1 - math.floor(math.log10(each))) if math.isfinite(value) else float(value)
        for value, each in zip(values, size)
    ]  # fmt: skip


def _measured(data: Designs, rows: np.ndarray) -> list[float]:
    """Scores of rows, rounded to remove the rounding errors of means and sums."""
    return [float(f"{score:.{EXACT}g}") for score in data.shown(data.y[rows])]


def about(data: Designs, made: Proposals) -> dict[str, list[Any]]:
    """A description of proposals as a table of two columns: method, data, quality of predictions, meaning of the columns."""
    sought = "small" if data.minimise else "large"
    lines: dict[str, Any] = {
        "method": made.method, "seed": made.seed, "data": data.name, "rows": len(data),
        "target": f"{data.target}, to be made {sought}", "best of the data": float(data.shown(data.y.max())),
    }  # fmt: skip
    if made.quality is not None:
        lines["out of fold"] = str(made.quality)
    if made.warning:
        lines["warning"] = made.warning
    if made.fitted is not None:
        lines |= {
            "predicted": MEAN,
            "predicted_std": ONE if made.noisy else TRUE,
            "predicted_low, predicted_high": interval_of(made),
        }
    elif made.measured:
        lines["predicted"] = "the measured score"
    elif made.requested:
        lines["predicted"] = "the score for which the method makes its designs, not that of a model"
    elif made.predicts:
        lines["predicted"] = "the method's prediction of the score"
    else:
        lines["predicted"] = "empty: the method has no model of the score"
    lines |= {**({} if made.mean_std is None else {"mean_std": OF_MEAN}), "distance": DISTANCE, "nearest_row": NEAREST}
    return {"what": list(lines), "value": list(lines.values())}


def interval_of(made: Proposals) -> str:
    """What the intervals are of, in words, and whether they were calibrated on unseen designs."""
    return f"the {PERCENT} interval of {made.of_what}{'' if made.quality else ', by the model, not calibrated'}"


def about_front(front: Front) -> dict[str, list[Any]]:
    """A description of proposals for several targets; see `about`."""
    first = front.data[0]
    lines: dict[str, Any] = {
        "method": "expected hypervolume improvement, a Gaussian process for each target",
        "data": first.name, "rows": len(first),
        **{f"target {each.target}": f"to be made {'small' if each.minimise else 'large'}" for each in front.data},
        **{f"out of fold, {d.target}": str(m.quality) for d, m in zip(front.data, front.made) if m.quality is not None},
        **{f"warning, {d.target}": m.warning for d, m in zip(front.data, front.made) if m.warning},
        **{f"note {i}": line for i, line in enumerate(front.notes, 1)},
        "hypervolume of the data": front.before,
        "expected to be added": "not known" if front.unskilled else front.gain,
        "predicted_TARGET": MEAN,
        "predicted_std_TARGET": ONE,
        "predicted_low_TARGET, predicted_high_TARGET": interval_of(front.made[0]),
        "mean_std_TARGET": OF_MEAN,
        "distance": DISTANCE,
        "nearest_row": NEAREST,
        "nearest_score_TARGET": "measured value in that row",
    }  # fmt: skip
    return {"what": list(lines), "value": list(lines.values())}


def free_name(name: str, data: Designs) -> str:
    """The name of a column, with underscores appended until no variable has it."""
    taken = {variable.name for variable in data.variables}
    while name in taken:
        name += "_"
    return name
