"""How much of what a policy does lies within what the log shows; of the rest an estimate is extrapolation.

A model of the policy that made the log says how far an action lies from what was done in such a state: its squared distance
in the model's deviations, before the tanh, or of discrete actions minus the logarithm of its probability. An action is covered
where that is no more than 99 % of logged actions have. The bound comes from episodes that the model has not seen, so that it
holds for new ones of the log's own policy however well the model fits (split conformal prediction: Vovk et al. 2005, Lei et al.
2018).

Actions are looked at in states of the log alone: a policy that is covered may still lead to states that the log never saw.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.batch import Rows
from deadreckon.nets import distributions as dist
from deadreckon.ope.critics import in_blocks
from deadreckon.ope.estimate import BehaviorModel, Case

LEVEL = 0.99  # of the log's own actions are covered
HELD = 0.1  # of the log's rows the bound comes from, and at most so many:
ROWS = 8192
FITTED = 1_000_000  # rows are enough for the model
DRAWS = 4  # purpose of draws, beside those of `Case`
MOSTLY = 2 / 3  # of what a policy does is to be covered; below, one is warned


def coverage(case: Case, model: BehaviorModel | None = None) -> np.ndarray:
    """The share of each policy's actions, at states of the log, that the log covers.

    Args:
        case: log and policies.
        model: how the policy that made the log is learned; None: as by default.

    Returns:
        (policies,) of 0 .. 1, without the log's own policy, which has 0.99; NaN where the log is a single episode.
    """
    model = BehaviorModel() if model is None else model
    return case.once(("coverage", model), lambda: _coverage(case, model))


def _coverage(case: Case, model: BehaviorModel) -> np.ndarray:
    data, actor = case.data, case.actor
    if data.episodes < 2:
        return np.full(len(actor.names), np.nan)
    rng = np.random.default_rng([case.seed, DRAWS])
    order = rng.permutation(data.episodes)
    rows = np.cumsum(data.lengths[order])
    held = int(np.clip(np.searchsorted(rows, min(HELD * len(data), ROWS)) + 1, 1, data.episodes - 1))
    enough = int(np.searchsorted(rows, rows[held - 1] + FITTED)) + 1
    learned = Rows(data.select(order[held:enough]), model.needs(data.spec))
    net, _ = case.train(model, learned, model.steps, "coverage")

    kept = data.select(order[:held])
    pick = np.sort(rng.choice(len(kept), min(len(kept), ROWS), replace=False))
    seen, taken = np.asarray(kept.observations[pick]), np.asarray(kept.actions[pick])
    told = in_blocks(lambda part: net(learned.view.observe(part)).T, seen).T  # what the model's network says
    table = actor.table(seen, 1, DRAWS)
    if data.spec.discrete:
        far = -np.asarray(jax.nn.log_softmax(told))
        return (table * (far <= _bound(far[np.arange(len(far)), taken]))[:, None]).sum(-1).mean(0)
    bound = _bound(_distance(told, np.asarray(learned.view.to_unit(taken))))
    return np.array([(_distance(told, table[:, i, 0]) <= bound).mean() for i in range(len(actor.names))])


def _bound(far: np.ndarray) -> float:
    """What at least 99 % of new ones do not exceed: the k-th of n, with k = ceil(0.99 (n + 1))."""
    k = int(np.ceil(LEVEL * (len(far) + 1)))
    return float(np.sort(far)[k - 1]) if k <= len(far) else np.inf


@jax.jit
def _squares(told: Any, actions: Any) -> Any:
    model = dist.gaussian_head(told)
    return jnp.square((jnp.arctanh(actions) - model.mean) * jnp.exp(-model.log_std)).sum(-1)


def _distance(told: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """(rows,) of actions in (-1, 1)."""
    return np.asarray(_squares(told, actions))
