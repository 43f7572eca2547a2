"""Fitted Q evaluation of the package, small, for many logs: batches are fetched, so that no log is compiled for."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from deadreckon.data.batch import redrawn
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Discrete
from deadreckon.ope.fqe import FQE, Critics, Scale
from deadreckon.training.fit import Fit
from decision_study.learn import SharedRows

MEMBERS = 3
SETTINGS = FQE(members=MEMBERS, hidden=(32,), batch_size=64, lr=3e-3, weight_decay=1e-5, tau=0.05)
ONCE, OFTEN = 600, 1_500  # updates of one decision and of many: a target moves by a twentieth of the way each


def fqe(log: Dataset, policies: Sequence[Any], discount: float, seed: int) -> np.ndarray:
    """(members, policies + 1) estimates of the policies and, last, of the log's own, each member on redrawn episodes."""
    rng, starts = np.random.default_rng([seed, 9]), log.starts
    reward = log.rewards.astype(float)
    std = float(reward.std()) or 1.0
    low, high = reward.min() / std, reward.max() / std
    if log.terminals.any():
        low, high = min(low, 0.0), max(high, 0.0)
    after = np.where(log.terminals | log.timeouts, np.arange(len(log)), np.arange(len(log)) + 1)
    weight = redrawn(log.episodes, MEMBERS, seed)
    count, full = len(policies), 5 if isinstance(log.action_space, Discrete) else 6
    policies = [*policies, *[policies[0]] * (full - count)]  # always as many, so that one program serves
    names = MEMBERS, len(policies) + 1
    scale, share = Scale(std, std / (1.0 - discount), float(low), float(high)), 1.0 - discount
    learner = Critics(SETTINGS, discount, scale, share=share, first=0.0, members=names[0], policies=names[1], stops=False)
    extra = {"policy": _table(log, log.next_observations, policies, after, rng), "weight": weight[log.episode_of]}
    rows = SharedRows(log, learner.needs(log.spec), extra)
    steps = OFTEN if discount > 0 else ONCE
    fit = Fit([learner], rows, [seed], steps, chunk=steps, stream=True)
    for _ in fit.chunks():
        pass
    targets = fit.states.targets
    seen = np.asarray(rows.view.observe(log.observations[starts]))
    table = _table(log, log.observations[starts], policies, starts, rng)
    values = np.stack([[_value(targets, m, p, seen, table[:, p]) for p in range(names[1])] for m in range(MEMBERS)])
    values = np.delete(values, range(count, len(policies)), 1)
    return scale.unit * np.einsum("mpn,nm->mp", values, weight / weight.sum(0))


def _value(targets: Any, m: int, p: int, seen: np.ndarray, own: np.ndarray) -> np.ndarray:
    inputs = seen if own.ndim == 2 else np.concatenate([seen, own[:, 0]], 1)
    for i, (w, b) in enumerate(zip(targets.weights, targets.biases)):
        inputs = (np.maximum(inputs, 0.0) if i else inputs) @ np.asarray(w[0, m, p]) + np.asarray(b[0, m, p])
    return (inputs * own).sum(1) if own.ndim == 2 else inputs[:, 0]


def _table(log: Dataset, seen: np.ndarray, policies: Sequence[Any], rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the policies and, last, the log itself do: probabilities, or one action each."""
    if isinstance(log.action_space, Discrete):
        told = [policy.probs(seen) for policy in policies]
        return np.stack([*told, np.eye(log.action_space.n)[log.actions[rows]]], 1).astype(np.float32)
    view = Normalizer.of(log.spec)
    drawn = [policy.fn(seen, rng) for policy in policies]
    return np.stack([view.to_unit(np.asarray(each)) for each in (*drawn, log.actions[rows])], 1)[:, :, None].astype(np.float32)
