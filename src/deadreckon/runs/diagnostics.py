"""Diagnostics of a policy from the log and the critics, without a simulator."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.policies.deployed import EnvPolicy, first_actions
from deadreckon.runs.evaluate import action_key
from deadreckon.stats.interval import LEVEL
from deadreckon.stats.means import student
from deadreckon.tasks.task import Task
from deadreckon.training.pictures import Seen, of_pictures

SAMPLE = 1024  # logged rows that policies are compared on
SEGMENTS, LENGTH = 16, 300  # segments of a log for figures, and most rows of each
SPLITS = 400  # random splits of them, for the MMD of a copy of the behaviour policy


def two_sample_mmd(x: Float[np.ndarray, "n d"], y: Float[np.ndarray, "m d"], variance: float) -> float:
    """Root of the unbiased Gaussian-kernel MMD^2 between two samples, zero where the estimate is negative (Gretton 2012)."""

    def mean(a: np.ndarray, b: np.ndarray, same: bool) -> float:
        k = _kernel(a, b, variance)
        if not same:
            return float(k.mean())
        n = len(a)
        return float((k.sum() - np.trace(k)) / (n * (n - 1)))

    return math.sqrt(max(mean(x, x, True) + mean(y, y, True) - 2.0 * mean(x, y, False), 0.0))


def _kernel(a: np.ndarray, b: np.ndarray, variance: float) -> np.ndarray:
    """(n, m) Gaussian kernel between rows."""
    squared = np.square(a).sum(-1)[:, None] + np.square(b).sum(-1)[None] - 2.0 * a @ b.T
    return np.exp(-np.maximum(squared, 0.0) / np.float32(2.0 * variance))


def mmd_of_copy(rows: Float[np.ndarray, "n d"], variance: float, rng: np.random.Generator) -> float:
    """The bound of `two_sample_mmd` for a share `LEVEL` of random splits of one sample into halves (a permutation test).

    A policy whose MMD is no greater than that cannot be distinguished from the one that made the rows.
    """
    half = len(rows) // 2
    k = _kernel(rows[: 2 * half], rows[: 2 * half], variance)
    np.fill_diagonal(k, 0.0)
    first = np.argsort(rng.random((SPLITS, 2 * half)), 1) < half  # of each split, which rows are in the first half
    within = (first @ k * first).sum(1) + (~first @ k * ~first).sum(1)
    squared = within / (half * (half - 1)) - 2.0 * (k.sum() - within) / 2.0 / half**2
    return math.sqrt(max(float(np.quantile(squared, LEVEL)), 0.0))


class LogProbe:
    """A fixed sample of the log on which policies are compared with the logged actions.

    `mmd_to_data`: two-sample MMD between (state, logged action) and (state, policy's action), states standardised, actions
    in [-1, 1], the kernel's variance the median squared distance; two disjoint halves of the sample, so that a perfect
    copy gives about zero. With images only actions are compared: thousands of pixels would outweigh them.
    `mmd_of_copy`: the bound that such a copy stays below in 95 % of samples of this size.
    `outside_range`: share of the policy's actions beyond the range of the log in some dimension.
    """

    def __init__(self, log: Dataset):
        rng = np.random.default_rng(0)
        rows = np.sort(rng.choice(len(log), min(SAMPLE, len(log)), replace=False))
        rng.shuffle(rows)
        self.observations = np.asarray(log.observations[rows])
        statistics = log.spec.observation
        states = (self.observations - statistics.mean) / (statistics.std + 1e-6)
        states = states.reshape(len(rows), -1).astype(np.float32)
        self.states = states[:, :0] if of_pictures(log.spec) else states
        self.range = log.spec.actions.min - 1e-5, log.spec.actions.max + 1e-5
        self.discrete = log.spec.action.size if log.spec.discrete else 0
        self.half = half = len(rows) // 2
        logged = np.concatenate([self.states, self._scaled(np.asarray(log.actions[rows]))], -1)
        self.logged = logged[:half]
        pairs = np.square(self.logged[: half // 2] - self.logged[half // 2 : 2 * (half // 2)]).sum(-1)
        self.variance = max(float(np.median(pairs)), 1e-6) if len(pairs) else 1.0
        # Two rows per side are the fewest that the estimate is defined for.
        self.copy = mmd_of_copy(logged, self.variance, rng) if half >= 2 else math.nan

    def __call__(self, policy: EnvPolicy) -> dict[str, float]:
        """The measures of one policy, with sampled instead of greedy actions."""
        actions = np.asarray(first_actions(policy, jax.device_put(self.observations), jax.random.key(0), False))
        outside = ((actions < self.range[0]) | (actions > self.range[1])).reshape(len(actions), -1).any(1).mean()
        drawn = np.concatenate([self.states, self._scaled(actions)], -1)[self.half :]
        distance = two_sample_mmd(self.logged, drawn, self.variance) if self.half >= 2 else math.nan
        return {"mmd_to_data": distance, "mmd_of_copy": self.copy, "outside_range": float(outside)}

    def _scaled(self, actions: np.ndarray) -> np.ndarray:
        """Actions to compare: one-hot, or scaled so that the log's range is [-1, 1]."""
        if self.discrete:
            return np.eye(self.discrete, dtype=np.float32)[actions]
        low, high = self.range
        return ((actions - low) / np.maximum(high - low, 1e-6) * 2.0 - 1.0).astype(np.float32)


def logged_value(log: Dataset, task: Task) -> dict[str, Any]:
    """The value of the behaviour policy of the log over one horizon of the task, from the log alone.

    Complete episodes, from a start to their end, are used unchanged. If recordings were cut earlier and nothing ended (goals
    that change on the way), the mean reward per step is extrapolated to the horizon.

    Returns:
        `mean`, `low`, `high` (Student's interval over episodes, of a ratio by its linearisation; None where there is none), and
        `how` in words.
    """
    returns, lengths = np.asarray(task.logged_returns(log), np.float64), log.lengths
    if bool(log.terminals.any()) or lengths.mean() >= 0.9 * task.horizon:
        values, how = returns, "mean return of the logged episodes"
    else:
        each = returns.sum() / lengths.sum()
        values = task.horizon * (each + (returns - each * lengths) / lengths.mean())
        how = f"mean logged reward per step, times the horizon of {task.horizon}"
    low, high = student(values) if len(values) > 1 else (None, None)
    return {"mean": float(values.mean()), "low": low, "high": high, "how": how}


def log_segments(log: Dataset) -> np.ndarray:
    """(SEGMENTS, length, *shape) segments of consecutive rows, evenly spaced over the log; for figures."""
    length = min(LENGTH, len(log))
    starts = np.linspace(0, len(log) - length, SEGMENTS).astype(int)
    return np.stack([np.asarray(log.observations[s : s + length]) for s in starts])


def _own(agent: Agent, state: Any, observation: Array, action: Array) -> Array | None:
    if isinstance(state, Seen):
        return agent.q_value(state.inner, state.encoder(observation), action)
    return agent.q_value(state, observation, action)


@eqx.filter_jit
def _q(agents: Agent, states: Any, observations: Array, actions: Array) -> Array | None:
    return eqx.filter_vmap(_own)(agents, states, observations, actions)


def estimated_values(
    agents: Agent, states: Any, view: Normalizer, policies: list[EnvPolicy], starts: np.ndarray
) -> np.ndarray | None:
    """(lanes, episodes) each lane's Q at initial observations and the actions of its policy; None without a critic.

    The actions are those that `evaluate` with seed 0 takes first at these starts. Q extrapolates beyond timeouts, while a
    return in the simulator stops at the horizon: with a discount of 0.99 and 300 steps the two differ by up to 0.99^300 = 5 %
    of the value.

    Args:
        agents: lifted, one per lane.
        states: (lanes, ...).
        view: normaliser of the agents' inputs.
        policies: one per lane.
        starts: (episodes, *shape) raw initial observations.
    """
    raw = jnp.asarray(starts)
    actions = jnp.stack([first_actions(policy, raw, action_key(0, 0), True) for policy in policies])
    seen = jnp.broadcast_to(view.observe(raw), (len(policies), *raw.shape))
    q = _q(agents, states, seen, view.to_unit(actions))
    return None if q is None else np.asarray(q)
