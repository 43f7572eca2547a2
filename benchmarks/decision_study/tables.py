"""Finite worlds, solved exactly: noise, short and long episodes, episodes that are cut off, and a store that orders goods."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.theory.tabular import MDP, garnet
from decision_study.problem import BETTER, LOG, WORLD, Choices, Estimand, Family, Problem, softmax, tilted

NEAR = 0.3  # share of the logs whose own policy is all but the best
LEAST = 10  # episodes


@dataclass(frozen=True)
class Table:
    """A finite world with the log's own policy, under an estimand.

    Attributes:
        world: transitions and rewards.
        features: (states, d) what a policy sees of a state.
        own: (states, actions) probabilities of the log's own policy.
        estimand: what is asked.
    """

    world: MDP
    features: np.ndarray
    own: np.ndarray
    estimand: Estimand

    def table(self, policy: Any) -> np.ndarray:
        """(states, actions) probabilities of a policy."""
        return np.asarray(policy.probs(self.features), float)

    def values(self, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q (steps, states, actions) and V (steps + 1, states); one step for all where nothing ends by the clock."""
        discount, horizon = self.estimand.discount, self.estimand.horizon
        if horizon is None:
            flow = np.einsum("sat,sa->st", self.world.transitions, table)
            v = np.linalg.solve(np.eye(len(flow)) - discount * flow, (table * self.world.rewards).sum(1))
            return (self.world.rewards + discount * self.world.transitions @ v)[None], np.stack([v, v])
        v, q = np.zeros((horizon + 1, self.world.states)), np.zeros((horizon, *table.shape))
        for t in reversed(range(horizon)):
            q[t] = self.world.rewards + discount * self.world.transitions @ v[t + 1]
            v[t] = (table * q[t]).sum(1)
        return q, v

    def value(self, table: np.ndarray) -> float:
        """Of a policy, exactly."""
        return float(self.world.initial @ self.values(table)[1][0])

    def visited(self, table: np.ndarray, steps: int) -> np.ndarray:
        """(steps, states) probabilities of being in a state at each step."""
        flow = np.einsum("sat,sa->st", self.world.transitions, table)
        out = [self.world.initial]
        for _ in range(steps - 1):
            out.append(out[-1] @ flow)
        return np.stack(out)

    @cached_property
    def own_value(self) -> float:
        """Of the log's own policy."""
        return self.value(self.own)

    def gains(self, policies: Sequence[Any], errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Exactly."""
        found = np.array([self.value(self.table(policy)) for policy in policies])
        return found - self.own_value, np.zeros(len(policies)), self.own_value

    def scores(self, policy: Any, log: Dataset, hidden: Any) -> np.ndarray:
        """Doubly robust with true values, and with the true ratios of how often states are visited at each step."""
        return self._scores(self.table(policy), log, hidden) - self._scores(self.own, log, hidden)

    def _scores(self, table: np.ndarray, log: Dataset, hidden: Any) -> np.ndarray:
        (q, v), steps, discount = self.values(table), int(log.lengths.max()), self.estimand.discount
        state, after, action = hidden["state"], hidden["after"], log.actions
        time = np.arange(len(log)) - log.starts[log.episode_of]
        asked = np.ones(len(log)) if self.estimand.horizon is None else (time < self.estimand.horizon).astype(float)
        at = np.minimum(time, len(q) - 1)
        own = self.visited(self.own, steps)
        often = np.divide(self.visited(table, steps), own, out=np.zeros_like(own), where=own > 0)
        ratio = often[time, state] * table[state, action] / self.own[state, action]
        future = np.where(log.terminals, 0.0, v[at + 1, np.minimum(after, self.world.states - 1)])
        pull = asked * discount**time * ratio * (log.rewards + discount * future - q[at, state, action])
        return v[0][state[log.starts]] + np.bincount(log.episode_of, pull, log.episodes)


def problem(table: Table, rows: int, steps: int, seed: int, candidates: dict[str, np.ndarray], name: str, known: bool = True,
            **facts: Any) -> Problem:  # fmt: skip
    """A log of a world, of about so many rows."""
    rng = np.random.default_rng([seed, LOG])
    length = min(float(table.visited(table.own, steps).sum()), steps)
    log = table.world.log(table.own, max(round(rows / length), LEAST), steps, rng, name)
    state = log.observations.argmax(1)
    after = log.next_observations.argmax(1)
    features = table.features.astype(np.float32)
    extras = dict(log.extras) if known else {}
    log = replace(
        log, observations=features[state], final_observations=features[log.final_observations.argmax(1)], extras=extras
    )
    # A policy is asked by features; which state it is in, the nearest says.
    of = lambda probs: Choices(lambda seen: probs[_nearest(seen, features)])  # noqa: E731
    return Problem(
        log, table.estimand, table, {key: of(probs) for key, probs in candidates.items()}, {"state": state, "after": after},
        known=known, **facts,
    )  # fmt: skip


def _nearest(seen: np.ndarray, features: np.ndarray) -> np.ndarray:
    if features.shape[0] == features.shape[1]:
        return seen.argmax(1)
    return np.argmax(seen @ features.T - 0.5 * np.square(features).sum(1), 1)


def candidates_of(table: Table, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Better and worse than the log's own policy for certain, by its own values."""
    q = table.values(table.own)[0].mean(0)
    by = rng.uniform(0.3, 1.0, 2)
    return {"better": tilted(table.own, q, by[0]), "worse": tilted(table.own, q, -by[1])}


def behaviour(table: Table, rng: np.random.Generator) -> np.ndarray:
    """In 30 % of the logs near the best policy, else any."""
    states, actions = table.own.shape
    if rng.random() < NEAR:
        discount = min(table.estimand.discount, 0.99)
        best = np.eye(actions)[table.world.optimal(discount).argmax(1)]
        return 0.9 * best + 0.1 / actions
    return 0.15 / actions + 0.85 * softmax(rng.choice([0.5, 1.5]) * rng.standard_normal((states, actions)))


def noise(seed: int, rows: int) -> Problem:
    """Rewards are noise of one mean, over episodes of one length; what is done moves states and nothing else."""
    rng = np.random.default_rng([seed, WORLD])
    steps, level = int(rng.choice([5, 10, 20])), rng.choice([0.0, 1.0])
    world = garnet(10, 3, 3, noise=1.0, seed=seed)
    world = replace(world, rewards=np.full((10, 3), level))
    table = Table(world, np.eye(10), np.full((10, 3), 1 / 3), Estimand(float(rng.choice([0.9, 0.99])), steps))
    table = replace(table, own=0.1 / 3 + 0.9 * softmax(rng.standard_normal((10, 3))))
    turned = {f"turned {i}": tilted(table.own, rng.standard_normal((10, 3)), 1.0) for i in range(2)}
    return problem(table, rows, steps, seed, turned, "null-sequential", null=True)


def layered(rng: np.random.Generator, layers: int = 5, width: int = 4, actions: int = 3) -> MDP:
    """From layer to layer, and past the last one the end."""
    states = layers * width
    transitions = np.zeros((states, actions, states))
    for s in range(states - width):
        first = (s // width + 1) * width
        transitions[s, :, first : first + width] = rng.dirichlet(np.full(width, 0.5), actions)
    return MDP(transitions, rng.standard_normal((states, actions)), np.pad(np.full(width, 1 / width), (0, states - width)), 0.0)


def short(known: bool) -> Callable[[int, int], Problem]:
    """Episodes that end after five steps, or after ten at most."""

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        scale = float(rng.choice([0.3, 1.0, 3.0]))
        if rng.random() < 0.5:
            world, horizon = replace(layered(rng), noise=scale), None
        else:
            world, horizon = garnet(20, 3, 3, ending=0.25, noise=scale, seed=seed), 10
        table = Table(world, np.eye(20), np.full((20, 3), 1 / 3), Estimand(float(rng.choice([0.9, 0.95, 0.99])), horizon))
        table = replace(table, own=behaviour(table, rng))
        return problem(table, rows, 10, seed, candidates_of(table, rng), "tabular-short", known)

    return make


def long(seed: int, rows: int) -> Problem:
    """Episodes of 50 to 200 steps without an end, long enough for the discount."""
    rng = np.random.default_rng([seed, WORLD])
    steps, discount = ((50, 0.9), (100, 0.95), (200, 0.98))[rng.integers(3)]
    world = garnet(10, 3, 3, noise=float(rng.choice([0.3, 1.0, 3.0])), seed=seed)
    table = Table(world, np.eye(10), np.full((10, 3), 1 / 3), Estimand(discount, None))
    table = replace(table, own=behaviour(table, rng))
    return problem(table, rows, steps, seed, candidates_of(table, rng), "tabular-long")


def cut(seed: int, rows: int) -> Problem:
    """Episodes that the recording cuts off while much is to come; asked for all of it, or for what was recorded."""
    rng = np.random.default_rng([seed, WORLD])
    steps, discount = int(rng.choice([5, 10, 20])), float(rng.choice([0.9, 0.95, 0.97]))
    world = garnet(10, 3, 3, ending=float(rng.choice([0.0, 0.03])), noise=float(rng.choice([0.3, 1.0])), seed=seed)
    table = Table(world, np.eye(10), np.full((10, 3), 1 / 3), Estimand(discount, steps if rng.random() < 0.5 else None))
    table = replace(table, own=behaviour(table, rng))
    return problem(table, rows, steps, seed, candidates_of(table, rng), "tabular-cut")


def store(seed: int, rows: int) -> Problem:
    """A store that orders 0, 2, 4, 6 or 8 of a good that spoils little, for 20 days; demand is Poisson and has two seasons."""
    rng = np.random.default_rng([seed, WORLD])
    most, orders, days = 15, np.array([0, 2, 4, 6, 8]), 20
    price, cost, holding, discount = 1.0, rng.uniform(0.4, 0.7), rng.uniform(0.02, 0.15), 0.95
    demand = rng.uniform(1.5, 3.0), rng.uniform(3.5, 6.0)
    levels, ask = most + 1, np.arange(25)
    transitions, rewards = np.zeros((2 * levels, 5, 2 * levels)), np.zeros((2 * levels, 5))
    logs = [ask * np.log(rate) - rate - np.cumsum(np.log(np.maximum(ask, 1))) for rate in demand]
    chances = [np.exp(each) / np.exp(each).sum() for each in logs]
    for season in (0, 1):
        for level in range(levels):
            for a, order in enumerate(orders):
                stock = min(level + order, most)
                sold = np.minimum(ask, stock)
                s = season * levels + level
                rewards[s, a] = chances[season] @ (price * sold - holding * (stock - sold)) - cost * (stock - level)
                for after, share in ((season, 0.9), (1 - season, 0.1)):
                    np.add.at(transitions[s, a], after * levels + stock - sold, share * chances[season])
    initial = np.zeros(2 * levels)
    initial[[5, levels + 5]] = 0.5
    world = MDP(transitions, rewards, initial, noise=float(rng.choice([0.3, 1.0])))
    level, season = np.tile(np.arange(levels), 2), np.repeat([0, 1], levels)
    features = np.stack([level / most, np.square(level / most), season], 1)
    table = Table(world, features, np.full((2 * levels, 5), 0.2), Estimand(discount, days))
    if rng.random() < NEAR:
        own = 0.1 / 5 + 0.9 * np.eye(5)[world.optimal(discount).argmax(1)]
    else:  # orders up to a level, more or less
        aim = rng.uniform(3, 10)
        own = 0.1 / 5 + 0.9 * softmax(-0.5 * np.square(level[:, None] + orders - aim) / rng.uniform(2.0, 8.0))
    table = replace(table, own=own)
    return problem(table, rows, days, seed, candidates_of(table, rng), "inventory")


FAMILIES = (
    Family("null-sequential", noise, "none: all policies have the same value"),
    Family("tabular-short", short(True), BETTER),
    Family("tabular-long", long, BETTER),
    Family("tabular-cut", cut, BETTER),
    Family("tabular-unknown", short(False), "as in `tabular-short`"),
    Family("inventory", store, BETTER, split="confirmatory"),
)
