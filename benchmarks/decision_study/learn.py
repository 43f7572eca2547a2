"""The package's own agents on the learning part of a log, small and quick, and what they learned as functions of arrays.

Batches are fetched (`stream=True`) and the spec is shared, so that programs depend on the sizes of observations and actions
alone and every log after the first is learned from without compiling.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import numpy as np

from deadreckon.agents.awac import AWAC
from deadreckon.agents.bc import BC
from deadreckon.agents.cql import CQL
from deadreckon.agents.iql import IQL
from deadreckon.agents.td3_bc import TD3BC
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete, Spec
from deadreckon.nets.distributions import LOG_STD_MAX, LOG_STD_MIN
from deadreckon.nets.mlp import MLP
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import Categorical, Deterministic, TanhGaussian
from deadreckon.training.fit import Fit
from decision_study.problem import Choices, Normal, softmax

STEPS, BATCH, HIDDEN = 600, 64, (32,)
SMALL = {"hidden": HIDDEN, "batch_size": BATCH}
QUICK = {"actor_lr": 3e-3, "critic_lr": 3e-3, "tau": 0.02}


@cache
def shared(observations: int, action: Box | Discrete) -> Spec:
    """One spec for all logs of a shape, so that what is compiled for one is compiled for all."""
    return Spec.empty((observations,), action, "any")


class SharedRows(TransitionSource):
    """Rows of a log that tells nothing of itself but its shape, once it is in view."""

    @property
    def spec(self) -> Spec:
        """Of its shape; bounds are the view's affair."""
        action = self.log.action_space
        box = action if isinstance(action, Discrete) else Box((-1.0,) * action.size, (1.0,) * action.size)
        return shared(self.log.observations.shape[1], box)


def agents(discrete: bool, discount: float) -> dict[str, Any]:
    """Candidates that are learned."""
    discount = min(discount, 0.99)
    more = {"discount": discount, **SMALL, **QUICK}
    drawing = {} if discrete else {"likelihood": "tanh_normal"}  # as when the study was made, and as `plain` writes out
    iql, clone = IQL(**more, **drawing), BC(lr=3e-3, **SMALL)
    if discrete:
        cql = CQL(cql_weight=1.0, temperature=0.1, temperature_lr=3e-3, **more)
        return {"bc": clone, "iql": iql, "cql": cql}
    return {"bc": clone, "iql": iql, "awac": AWAC(**more, **drawing), "td3_bc": TD3BC(**more)}


def learned(log: Dataset, discount: float, seed: int) -> dict[str, Any]:
    """What each learns from a log, as policies of numpy; one whose numbers go bad is left out."""
    log = replace(log, rewards=(log.rewards / (log.rewards.std() or 1.0)).astype(np.float32), extras={})
    out = {}
    for name, agent in agents(isinstance(log.action_space, Discrete), discount).items():
        rows = SharedRows(log, agent.needs(log.spec))
        fit = Fit([agent.resolve(rows.spec, STEPS)], rows, [seed], STEPS, chunk=STEPS, stream=True)
        for _ in fit.chunks():
            pass
        if fit.failures[0] is None:
            state = jax.tree.map(lambda leaf: leaf[0], fit.states)
            out[name] = plain(EnvPolicy.of(agent.policy(state), rows.view))
    return out


def plain(policy: EnvPolicy) -> Choices | Normal:
    """A policy without a compiler, which would want every number of rows anew."""
    inner, view = policy.inner, policy.view
    if isinstance(inner, Categorical):
        net = forward(inner.net)
        return Choices(lambda seen: softmax(net(np.asarray(view.observe(np.asarray(seen))))))
    mean, std = (None if each is None else np.asarray(each) for each in (view.mean, view.std))
    look = lambda seen: seen if mean is None else (seen - mean) / std  # noqa: E731
    bounds = np.asarray(view.low, float), np.asarray(view.high, float)
    if isinstance(inner, Deterministic):
        net = forward(inner.net)
        return Normal(lambda seen: (net(look(seen)), None), bounds, draws=False)
    assert isinstance(inner, TanhGaussian)
    net = forward(inner.net)

    def head(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        center, log_std = np.split(net(look(seen)), 2, -1)
        return center, np.exp(np.clip(log_std, LOG_STD_MIN, LOG_STD_MAX))

    return Normal(head, bounds)


def forward(net: MLP) -> Callable[[np.ndarray], np.ndarray]:
    """A network of rectified units as a function of arrays."""
    assert net.activation == "relu"
    assert not net.normalise
    weights, biases = [np.asarray(w) for w in net.weights], [np.asarray(b) for b in net.biases]

    def run(x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, np.float32)
        for w, b in zip(weights[:-1], biases[:-1]):
            x = np.maximum(x @ w + b, 0.0)
        return (x @ weights[-1] + biases[-1]).astype(float)

    return run
