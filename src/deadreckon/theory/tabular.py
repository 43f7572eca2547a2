"""Finite Markov decision processes: exact values and occupancies, and logs drawn from them."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.theory import solve

_action_values = solve.exactly(solve.action_values)
_occupancy = solve.exactly(solve.occupancy)
_optimal = solve.exactly(solve.policy_iteration)
_visits = solve.exactly(solve.visits)


@dataclass(frozen=True)
class MDP:
    """A finite world. An episode ends with the probability that a row of `transitions` lacks to one.

    Attributes:
        transitions: (states, actions, states) probabilities; what a row lacks to one is that of the end.
        rewards: (states, actions) means.
        initial: (states,) probabilities of an episode's first state.
        noise: standard deviation of a reward, Gaussian.
    """

    transitions: np.ndarray
    rewards: np.ndarray
    initial: np.ndarray
    noise: float = 0.0

    def __post_init__(self):
        states, actions = self.rewards.shape
        if self.transitions.shape != (states, actions, states) or self.initial.shape != (states,):
            raise UserError(
                f"rewards of shape {self.rewards.shape} need transitions {(states, actions, states)} and initial {(states,)}, "
                f"got {self.transitions.shape} and {self.initial.shape}"
            )
        mass = self.transitions.sum(-1)
        if (self.transitions < 0).any() or (mass > 1 + 1e-9).any() or (self.initial < 0).any():
            raise UserError("transitions must be probabilities that sum to at most one")
        if abs(self.initial.sum() - 1) > 1e-9:
            raise UserError(f"initial must sum to one, it sums to {self.initial.sum():g}")

    @property
    def states(self) -> int:
        """Number of states."""
        return self.rewards.shape[0]

    @property
    def actions(self) -> int:
        """Number of actions."""
        return self.rewards.shape[1]

    @classmethod
    def of(cls, log: Dataset) -> "MDP":
        """The likeliest world of a log of one-hot observations: what it saw, as often as it saw it.

        A state and action that were never seen together end the episode.
        """
        states, actions = log.observations.shape[1], log.spec.action_size
        now, following = log.observations.argmax(1), log.next_observations.argmax(1)
        usable = log.usable
        counts, rewards = np.zeros((states, actions, states + 1)), np.zeros((states, actions))
        after = np.where(log.terminals, states, following)
        np.add.at(counts, (now[usable], log.actions[usable], after[usable]), 1.0)
        np.add.at(rewards, (now[usable], log.actions[usable]), np.asarray(log.rewards, float)[usable])
        times = np.maximum(counts.sum(-1), 1.0)
        initial = np.bincount(now[log.starts], minlength=states) / log.episodes
        return cls(counts[..., :-1] / times[..., None], rewards / times, initial)

    # ---- exact solutions --------------------------------------------------------------------------------------------

    def q(self, policy: np.ndarray, discount: float) -> np.ndarray:
        """(states, actions) expected discounted return of an action and the policy after it.

        Args:
            policy: (states, actions) probabilities.
            discount: per step; 1 where every episode ends for certain.
        """
        return _action_values(self.transitions, self.rewards, policy, discount)

    def value(self, policy: np.ndarray, discount: float) -> float:
        """Expected discounted return of an episode of the policy, sum_t discount^t r_t, however long it lasts."""
        return float(self.initial @ (policy * self.q(policy, discount)).sum(1))

    def occupancy(self, policy: np.ndarray, discount: float) -> np.ndarray:
        """(states, actions) of (1 - discount) sum_t discount^t P(s_t, a_t): it sums to one where no episode ends."""
        return _occupancy(self.transitions, self.initial, policy, discount)

    def visits(self, policy: np.ndarray, steps: int) -> np.ndarray:
        """(states, actions) expected number of visits in the first `steps` steps of an episode."""
        return _visits(self.transitions, self.initial, policy, steps)

    def optimal(self, discount: float) -> np.ndarray:
        """(states, actions) values of the best policy, by policy iteration.

        Raises:
            UserError: a discount that is not below one: values need not be finite.
        """
        if not 0.0 <= discount < 1.0:
            raise UserError(f"discount must be in [0, 1), got {discount}")
        return _optimal(self.transitions, self.rewards, discount)

    # ---- logs -------------------------------------------------------------------------------------------------------

    def log(self, policy: np.ndarray, episodes: int, steps: int, rng: np.random.Generator, name: str = "mdp") -> Dataset:
        """A log of episodes of a policy, cut after `steps` steps (a timeout) where they have not ended.

        Observations are one-hot states; the column `behavior_log_probs` holds the policy's own log-probabilities.
        """
        alive = np.ones(episodes, bool)
        state = _choose(np.broadcast_to(self.initial, (episodes, self.states)), rng)
        flow = np.concatenate([self.transitions, 1.0 - self.transitions.sum(-1, keepdims=True)], -1).clip(0.0)
        seen, taken, got, ended, lasted = [], [], [], [], []
        for _ in range(steps):
            action = _choose(policy[state], rng)
            reward = self.rewards[state, action] + self.noise * rng.standard_normal(episodes)
            following = _choose(flow[state, action], rng)
            ends = following == self.states
            for column, now in zip((seen, taken, got, ended, lasted), (state, action, reward, ends, alive)):
                column.append(now)
            alive = alive & ~ends
            state = np.where(alive, following, state)  # an episode that has ended stays where it was
        kept = np.stack(lasted, 1)  # (episodes, steps)
        seen, taken, got, ended = (np.stack(column, 1) for column in (seen, taken, got, ended))
        timeouts = np.zeros_like(ended)
        timeouts[np.arange(episodes), kept.sum(1) - 1] = True
        timeouts &= ~ended
        return Dataset.from_arrays(
            observations=np.eye(self.states, dtype=np.float32)[seen[kept]], actions=taken[kept], rewards=got[kept],
            terminals=ended[kept], timeouts=timeouts[kept], final_observations=np.eye(self.states, dtype=np.float32)[state],
            behavior_log_probs=np.log(policy[seen, taken])[kept], action_space=Discrete(self.actions), name=name,
        )  # fmt: skip


def _choose(probabilities: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n,) draws from the rows of (n, k) probabilities."""
    edges = probabilities.cumsum(-1)
    return (rng.random(len(edges))[:, None] * edges[:, -1:] >= edges).sum(-1)


def softmax(preferences: Any, temperature: float = 1.0) -> np.ndarray:
    """(states, actions) policy that prefers larger numbers."""
    scaled = np.asarray(preferences, float) / temperature
    weights = np.exp(scaled - scaled.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


# ---- worlds -----------------------------------------------------------------------------------------------------------


def chain(length: int = 5, slip: float = 0.1, noise: float = 0.0) -> MDP:
    """A row of states: action 1 steps right, 0 goes back to the first, a slip swaps them. Past the last: 1, and the end."""
    transitions = np.zeros((length, 2, length))
    rewards = np.zeros((length, 2))
    for s in range(length):
        for a in (0, 1):
            for happens, probability in ((a, 1.0 - slip), (1 - a, slip)):
                if happens == 0:
                    transitions[s, a, 0] += probability
                elif s + 1 < length:
                    transitions[s, a, s + 1] += probability
                else:
                    rewards[s, a] += probability  # and the episode ends
    return MDP(transitions, rewards, np.eye(length)[0], noise)


def gridworld(width: int = 4, height: int = 4, slip: float = 0.1, noise: float = 0.0, goal: int | None = None) -> MDP:
    """Four moves (up, right, down, left) on a grid without an end; a slip moves any way. States are numbered row by row.

    Being in the goal, the last corner unless said otherwise, pays 1, a step elsewhere nothing.
    """
    count = width * height
    transitions, rewards = np.zeros((count, 4, count)), np.zeros((count, 4))
    moves = ((0, -1), (1, 0), (0, 1), (-1, 0))
    for s in range(count):
        x, y = s % width, s // width
        targets = [
            int(np.clip(x + dx, 0, width - 1)) + width * int(np.clip(y + dy, 0, height - 1)) for dx, dy in moves
        ]
        for a in range(4):
            transitions[s, a, targets[a]] += 1.0 - slip
            for target in targets:
                transitions[s, a, target] += slip / 4
    rewards[count - 1 if goal is None else goal] = 1.0
    return MDP(transitions, rewards, np.eye(count)[0], noise)


def garnet(
    states: int = 10, actions: int = 3, branches: int = 3, ending: float = 0.0, noise: float = 0.0, seed: int = 0
) -> MDP:
    """A random world: each action leads to `branches` random states, and ends the episode with probability `ending`."""
    rng = np.random.default_rng(seed)
    transitions = np.zeros((states, actions, states))
    for s in range(states):
        for a in range(actions):
            where = rng.choice(states, branches, replace=False)
            transitions[s, a, where] = (1.0 - ending) * rng.dirichlet(np.ones(branches))
    return MDP(transitions, rng.standard_normal((states, actions)), rng.dirichlet(np.ones(states)), noise)


class Worlds(NamedTuple):
    """Many worlds of one shape, for what runs over thousands of them at once.

    Attributes:
        transitions: (n, states, actions, states); rows sum to one.
        rewards: (n, states, actions), within ±1.
        initial: (n, states).
    """

    transitions: np.ndarray
    rewards: np.ndarray
    initial: np.ndarray

    def world(self, i: int) -> MDP:
        """One of them."""
        return MDP(self.transitions[i], self.rewards[i], self.initial[i])


def garnets(count: int, rng: np.random.Generator, states: int = 6, actions: int = 3) -> Worlds:
    """Random worlds of all kinds: one successor of each action up to all, a certain first state or any, few rewards or many."""
    branches = rng.integers(1, states + 1, count)
    order = rng.random((count, states, actions, states)).argsort(-1)
    weights = rng.exponential(size=order.shape) * (order < branches[:, None, None, None])
    starts = rng.dirichlet(np.ones(states), count) ** rng.choice([0.0, 1.0, 8.0], count)[:, None]
    rewards = rng.uniform(-1.0, 1.0, (count, states, actions))
    kept = rng.random(rewards.shape) < rng.choice([0.2, 1.0], count)[:, None, None]
    return Worlds(weights / weights.sum(-1, keepdims=True), rewards * kept, starts / starts.sum(-1, keepdims=True))


def policies(count: int, rng: np.random.Generator, states: int = 6, actions: int = 3) -> np.ndarray:
    """(count, states, actions) random policies, from nearly even to nearly decided."""
    weights = rng.gamma(rng.choice([0.2, 1.0, 5.0], count)[:, None, None], size=(count, states, actions)) + 1e-6
    return weights / weights.sum(-1, keepdims=True)
