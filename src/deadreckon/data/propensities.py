"""Whether logged propensities can be those of the logged actions."""

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.data.told import action_names

_ROWS = 200_000  # that are looked at
_FEW = 100  # rows below which nothing is said
_ERRORS, _EXCESS = 4.0, 0.1  # by which a mean of weights must be above 1: in standard errors, and in itself


def about_propensities(log: Dataset) -> list[str]:
    """Advice on propensities of discrete actions that are too small.

    Whatever the policy was, the weights 1 / propensity of the rows that take an action, and 0 for the others, have a mean of 1,
    or less where the action is sometimes impossible. A mean that is surely above 1 says that the column holds something else,
    such as the probability of one and the same action in all rows.
    """
    if LOG_PROBS not in log.extras or isinstance(log.action_space, Box) or len(log) < _FEW:
        return []
    actions = np.asarray(log.actions[:_ROWS])
    weights = np.exp(-np.asarray(log.extras[LOG_PROBS][:_ROWS], np.float64))
    for action, name in enumerate(action_names(log)):
        own = np.where(actions == action, weights, 0.0)
        mean, error = float(own.mean()), float(own.std()) / np.sqrt(len(own))
        if mean > 1.0 + max(_EXCESS, _ERRORS * error):
            text = f"propensities are too small: the weights 1 / propensity of action {name} have the mean {mean:.2f}"
            return [f"{text}, but at most 1 is possible; check that they belong to the logged actions"]
    return []
