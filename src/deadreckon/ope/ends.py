"""Continuous actions near the bounds of a log, where learned densities of tanh-Gaussians say nothing.

By default the bounds are the least and the greatest logged action. Before the tanh these are far from all others, so that the
likelihood of one row can outweigh that of all the rest, and so can its importance weight. Therefore densities of such rows are
learned, and divided, at an action that is not as near.
"""

from dataclasses import replace

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer

NEAR = 0.95  # number of an action, on the scale of -1 to 1, beyond which it is near a bound
# Share and number of rows up to which actions near a bound are moved; more are usual there, such as a valve that is fully open.
FEW, ROWS = 0.01, 10


def within_bounds(log: Dataset) -> Dataset:
    """The log in which each number of a continuous action that is near its bound in a few rows has the value `NEAR` there."""
    view = Normalizer.of(log.spec)
    unit = np.asarray(view.to_unit(np.asarray(log.actions)))
    beyond = [side * unit > NEAR for side in (-1.0, 1.0)]
    moved = sum((at & (at.sum(0) <= max(FEW * len(log), ROWS)) for at in beyond), np.zeros(unit.shape, bool))
    if not moved.any():
        return log
    actions = np.where(moved, view.from_unit(np.clip(unit, -NEAR, NEAR)), log.actions).astype(np.float32)
    return replace(log, actions=actions, part_of=lambda: log.episode_ids)
