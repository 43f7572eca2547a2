"""What the study asks of a log: the log, what is to be known about policies on it, and who knows the truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.policies.policy import BlackBoxPolicy

HOLD, LOG, WORLD, TRUTH, WORSE = range(5)  # purposes of randomness, beside the seed
SIZES = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000)  # rows; a trial's is the next one
HELD = 0.2  # of the episodes, or of the clusters


class Estimand(NamedTuple):
    """What of a policy is asked: the expected sum of discount^t r_t over the first `horizon` steps (None: all) of its draws."""

    discount: float
    horizon: int | None = None
    greedy: bool = False


# ---- policies -------------------------------------------------------------------------------------------------------


class Choices(BlackBoxPolicy):
    """A policy of discrete actions by its probabilities: observations (n, d) to (n, actions)."""

    def __init__(self, probs: Callable[[np.ndarray], np.ndarray]):
        def draw(observations: np.ndarray, rng: np.random.Generator) -> np.ndarray:
            return choose(probs(observations), rng)

        def log_prob(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
            with np.errstate(divide="ignore"):
                return np.log(probs(observations)[np.arange(len(actions)), actions])

        super().__init__(draw, log_prob, probs)
        self.probs, self.draws = probs, True


class Normal(BlackBoxPolicy):
    """A Gaussian policy of continuous actions, or a tanh-Gaussian one within `bounds`, or one that draws nothing.

    Args:
        head: observations (n, d) to means and deviations (n, actions) each; deviations None: it draws nothing.
        bounds: least and greatest action, which make it a tanh-Gaussian.
    """

    def __init__(self, head: Callable[[np.ndarray], Any], bounds: Any = None, draws: bool = True):
        super().__init__(self._draw, self._density if draws else None)
        self.head, self.bounds, self.draws = head, bounds, draws

    def at(self, observations: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(..., n, actions) the actions that standard normal `z` (..., n, actions) makes of it."""
        mean, std = self.head(observations)
        pre = mean + np.zeros_like(z) if std is None else mean + std * z
        if self.bounds is None:
            return pre
        low, high = self.bounds
        return low + 0.5 * (np.tanh(pre) + 1.0) * (high - low)

    def _draw(self, observations: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        mean, _ = self.head(observations)
        return self.at(observations, rng.standard_normal(mean.shape))

    def _density(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        mean, std = self.head(observations)
        pre, scale = actions, 0.0
        if self.bounds is not None:
            low, high = self.bounds
            unit = np.clip(2.0 * (actions - low) / (high - low) - 1.0, -1.0 + 1e-6, 1.0 - 1e-6)
            pre = np.arctanh(unit)
            scale = np.log1p(-np.square(unit)) + np.log(0.5 * (high - low))
        z = (pre - mean) / std
        return (-0.5 * np.square(z) - np.log(std) - 0.5 * np.log(2 * np.pi) - scale).sum(-1)


def choose(probabilities: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n,) draws from the rows of (n, k)."""
    edges = probabilities.cumsum(1)
    return (rng.random(len(edges))[:, None] * edges[:, -1:] >= edges[:, :-1]).sum(1)


def softmax(x: np.ndarray) -> np.ndarray:
    """Along the last axis."""
    weights = np.exp(x - x.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


def tilted(chances: np.ndarray, advantage: np.ndarray, by: float) -> np.ndarray:
    """(n, k) chances times exp(by * advantage in its deviations): better than they are for `by` above zero, worse below."""
    scale = advantage.std() or 1.0
    with np.errstate(divide="ignore"):
        return softmax(np.log(chances) + by * (advantage - advantage.mean(1, keepdims=True)) / scale)


# ---- problems -------------------------------------------------------------------------------------------------------


class World(Protocol):
    """Who knows the truth."""

    def gains(self, policies: Sequence[Any], errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """(policies,) how much better each is than the log's own policy, the standard errors of that (0: exact), which are
        brought below `errors` where that takes no more than a few seconds, and the value of the log's own."""
        ...

    def scores(self, policy: Any, log: Dataset, hidden: Mapping[str, np.ndarray]) -> np.ndarray:
        """(episodes,) scores whose mean is the gain without bias: doubly robust, by what nobody else knows."""
        ...


@dataclass(frozen=True)
class Problem:
    """A log and what is asked of it.

    Attributes:
        log: all of it; `behavior_log_probs` in its extras where `known`.
        estimand: what of a policy is asked.
        world: knows the truth.
        candidates: policies that were made by hand, by name.
        hidden: (rows, ...) what only the world may see.
        cluster: the extra column that says which rows depend on each other beyond their episode; None: none.
        known: whether the log tells the probabilities of its actions.
        supported: whether the log takes all actions that candidates take.
        null: whether no policy can be better or worse than another.
    """

    log: Dataset
    estimand: Estimand
    world: World
    candidates: Mapping[str, Any]
    hidden: Mapping[str, np.ndarray] = field(default_factory=dict)
    cluster: str | None = None
    known: bool = True
    supported: bool = True
    null: bool = False

    def truth(self, policy: Any, error: float = 0.0) -> float:
        """The value of a policy under the estimand."""
        gains, _, own = self.world.gains([policy], np.array([error]))
        return own + float(gains[0])

    @property
    def behavior(self) -> float:
        """The value of the policy that made the log."""
        return self.world.gains([], np.zeros(0))[2]

    @property
    def units(self) -> np.ndarray:
        """(episodes,) the cluster of each, 0, 1, ..., or its own number."""
        if self.cluster is None:
            return np.arange(self.log.episodes)
        return np.unique(self.log.extras[self.cluster][self.log.starts], return_inverse=True)[1]

    def parts(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Episodes to learn from and those that are held out: a fifth of them, or of the clusters, at random."""
        of = self.units
        units = int(of.max()) + 1
        held = np.random.default_rng([seed, HOLD]).permutation(units)[: max(round(HELD * units), 1)]
        out = np.isin(of, held)
        return np.flatnonzero(~out), np.flatnonzero(out)

    def folds(self, seed: int, count: int) -> np.ndarray:
        """(episodes,) fold of each, at random; clusters stay whole."""
        of = self.units
        units = int(of.max()) + 1
        return (np.random.default_rng([seed, HOLD]).permutation(units) % count)[of]

    def part(self, episodes: np.ndarray) -> tuple[Dataset, dict[str, np.ndarray]]:
        """These episodes of the log, and what is hidden of them."""
        rows = np.flatnonzero(np.isin(self.log.episode_of, episodes))
        return self.log.select(episodes), {name: column[rows] for name, column in self.hidden.items()}


BETTER = "in all logs (`better`), with a small gain in the 30 % of logs whose behaviour policy is nearly optimal"


@dataclass(frozen=True)
class Family:
    """Logs of one kind.

    Attributes:
        name: of the family.
        make: of a generator's seed and a number of rows.
        sizes: numbers of rows, in turn.
        split: `development`, or `confirmatory`: nobody has ever looked at its logs while something was tuned.
        better: when its logs have a candidate that is better than the log's own policy, in words.
    """

    name: str
    make: Callable[[int, int], Problem]
    better: str
    sizes: tuple[int, ...] = SIZES
    split: str = "development"

    def log(self, seed: int, rows: int | None = None) -> Problem:
        """The log of a seed; the same seed is the same log."""
        return self.make(seed, rows or self.sizes[seed % len(self.sizes)])
