"""Which proposal to try if only one is tried."""

import numpy as np

from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.stats.interval import NORMAL

FAR = 3.0  # typical distances to the nearest scored design beyond which a design is called far


def interval(mean: np.ndarray, std: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lower and upper end of the 95 % interval around predictions; NaN where there is no standard deviation."""
    half = NORMAL * (np.full(len(mean), np.nan) if std is None else np.where(np.isfinite(std), std, np.nan))
    return mean - half, mean + half


def shown_interval(data: Designs, mean: np.ndarray, std: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The same interval with the sign of the table's target, the lower end first."""
    low, high = (data.shown(end) for end in interval(mean, std))
    return (high, low) if data.minimise else (low, high)


def tested_std(made: Proposals) -> np.ndarray | None:
    """(n,) standard deviations of predictions; None if these were not tested: what their intervals cover is then not known."""
    return None if made.quality is None else made.predicted_std


def first_choice(made: Proposals, far: np.ndarray) -> int | None:
    """The proposal to try if only one is tried: that with the greatest lower end of its interval, or else prediction.

    If the model predicts only an order, it is the first in that order. Intervals that were not tested are not used. Proposals
    farther than `FAR` from the data are considered only if all are.

    Args:
        made: the proposals.
        far: (n,) distances to the data, in typical distances (`mbo.nn_distance`).

    Returns:
        Its index; None if the method has no model of the score, or one whose order cannot be distinguished from chance.
    """
    if made.fitted is None or made.by_chance:
        return None
    low, _ = interval(made.predicted, tested_std(made))
    value = low if np.isfinite(low).all() else made.predicted if made.predicts else made.fitted.predict(made.x)[0]
    near = far <= FAR
    return int(np.where(near if near.any() else True, value, -np.inf).argmax())
