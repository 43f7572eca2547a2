"""The share of a policy's actions that the log covers; for the rest an estimate is extrapolation.

A model of the behaviour policy gives the likelihood of an action in its state. An action is covered unless its likelihood is
below the 1 % quantile of those of the logged actions. This bound comes from episodes that the model was not trained on, and so
holds for new episodes of the behaviour policy, regardless of the model's fit (split conformal prediction: Vovk et al. 2005, Lei
et al. 2018). It is exact if rows are independent, and approximate for rows in episodes, if there are more than a few.

Actions are checked only in states of the log: a covered policy may still lead to states that are not in the log.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.data.batch import TransitionSource
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets import distributions as dist
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import in_blocks
from deadreckon.ope.ends import NEAR
from deadreckon.policies.kinds import Categorical
from deadreckon.randomness import generator

LEVEL = 0.99  # share of the log's actions that are covered
# The bound is computed from this share of the log's rows, or from more if these have too few rows or episodes; never from more
# than half of the rows.
HELD, FEWEST_ROWS, FEWEST_EPISODES = 0.1, 200, 5
MOST = 8192  # most of these rows that are used
FITTED = 1_000_000  # number of rows that is enough to train the model
MODEL = BehaviorModel(steps=5_000, lr=1e-3)  # default; the bound is valid even if the model fits poorly


def coverage(case: OPEInput, model: BehaviorModel = MODEL) -> Float[np.ndarray, "policies"]:
    """The share of each policy's actions, at states of the log, that the log covers.

    Args:
        case: log and policies.
        model: settings of the behaviour model.

    Returns:
        (policies,) of 0 .. 1, without the behaviour policy, which has 0.99; NaN if the log is too short: the bound needs a
        hundred rows from five episodes, which must be at most half of all rows.
    """
    return case.once(("coverage", model), lambda: _coverage(case, model))


def _coverage(case: OPEInput, model: BehaviorModel) -> np.ndarray:
    actor, teach = case.actor, case.teaching()
    rng = generator(case.seed, "coverage")
    if teach is not None:  # the bound is computed from evaluated episodes, with a model of the others
        data, kept = case.log, case.data
        rows = len(kept)
        if kept.episodes < FEWEST_EPISODES or np.ceil(LEVEL * (rows + 1)) > rows:
            return np.full(len(case.policies), np.nan)
        others = rng.permutation(teach.data.episodes)
        taught = teach.data
    else:
        data = taught = case.data
        held, others, rows = [], [], 0
        for episode, length in zip(order := rng.permutation(data.episodes), data.lengths[order]):
            enough = rows >= max(HELD * len(data), FEWEST_ROWS) and len(held) >= FEWEST_EPISODES
            if enough or rows + length > 0.5 * len(data):
                others.append(episode)
            else:
                held.append(episode)
                rows += length
        if len(held) < FEWEST_EPISODES or np.ceil(LEVEL * (rows + 1)) > rows:
            return np.full(len(case.policies), np.nan)
        kept = data.select(held)
    part = taught.select(others[: int(np.searchsorted(np.cumsum(taught.lengths[others]), FITTED)) + 1])
    view = Normalizer.of(data.spec)
    if not data.spec.discrete:
        # At the bounds the density of a tanh-Gaussian may be infinite.
        part = dataclasses.replace(part, actions=view.from_unit(np.clip(view.to_unit(part.actions), -NEAR, NEAR)))
    learned = TransitionSource(part, model.needs(data.spec))
    fitted, _ = case.train(model, learned, model.steps, "coverage")
    net = fitted.log_probs if isinstance(fitted, Categorical) else fitted

    pick = np.sort(rng.choice(len(kept), min(len(kept), MOST), replace=False))
    seen, taken = np.asarray(kept.observations[pick]), np.asarray(kept.actions[pick])
    told = in_blocks(lambda part: net(learned.view.observe(part)).T, seen).T  # outputs of the model
    table = actor.table(seen, 1, "coverage")
    if data.spec.discrete:
        return _owned(case, (table * (told >= _bound(told[np.arange(len(told)), taken]))[:, None]).sum(-1).mean(0))
    bound = _bound(_log_density(told, view.to_unit(taken)))
    return _owned(case, np.array([(_log_density(told, table[:, i, 0]) >= bound).mean() for i in range(len(actor.names))]))


def _owned(case: OPEInput, shares: np.ndarray) -> np.ndarray:
    """(policies,) shares, of cross-fitted policies the mean over folds."""
    return np.bincount(case.owner, shares) / np.bincount(case.owner)


def _bound(likely: np.ndarray) -> float:
    """The value that at least 99 % of new values reach: the k-th largest of n, with k = ceil(0.99 (n + 1))."""
    return float(np.sort(likely)[len(likely) - int(np.ceil(LEVEL * (len(likely) + 1)))])


@jax.jit
def _log_density(told: Any, actions: Any) -> Array:
    return dist.log_prob(dist.gaussian_head(told), jnp.arctanh(jnp.clip(actions, -NEAR, NEAR)))
