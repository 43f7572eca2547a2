"""Small worlds whose policies are tables, so that estimates can be compared with exact values."""

import numpy as np

from deadreckon.ope.critics import OutOfFold
from deadreckon.policies import BlackBoxPolicy
from deadreckon.theory.tabular import MDP, softmax


class Tanh(BlackBoxPolicy):
    """A tanh-Gaussian policy of one continuous action, with a mean before the tanh that is linear in the first observation."""

    def __init__(self, mean: float, std: float, low: float, high: float, slope: float = 0.0):
        def draw(seen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
            pre = mean + slope * seen[:, :1] + std * rng.standard_normal((len(seen), 1))
            return low + 0.5 * (np.tanh(pre) + 1.0) * (high - low)

        def log_prob(seen: np.ndarray, actions: np.ndarray) -> np.ndarray:
            unit = np.clip(2.0 * (actions[:, 0] - low) / (high - low) - 1.0, -1.0 + 1e-6, 1.0 - 1e-6)
            z = (np.arctanh(unit) - mean - slope * seen[:, 0]) / std
            return -0.5 * z**2 - np.log(std * np.sqrt(2.0 * np.pi)) - np.log1p(-(unit**2)) - np.log(0.5 * (high - low))

        super().__init__(draw, log_prob)


def as_policy(table: np.ndarray) -> BlackBoxPolicy:
    """A (states, actions) table of probabilities as a policy of one-hot observations."""
    probs = lambda observations: table[np.asarray(observations).argmax(1)]  # noqa: E731

    def draw(observations, rng):
        return (rng.random(len(observations))[:, None] >= probs(observations).cumsum(1)[:, :-1]).sum(1)

    return BlackBoxPolicy(draw, action_probs=probs)


def tables(world: MDP, count: int, spread: float, seed: int = 0) -> list[np.ndarray]:
    """Random policies: the larger `spread`, the more decided."""
    rng = np.random.default_rng(seed)
    return [softmax(spread * rng.standard_normal((world.states, world.actions))) for _ in range(count)]


def keep_nuisances(case, estimator, begins: np.ndarray, errors: np.ndarray) -> None:
    """Tells a doubly robust estimator of one fold what its critics say: (members, policies, episodes) and (policies, rows)."""
    assert estimator.folds == 1
    settled = np.ones(len(errors), bool)
    told = OutOfFold(begins.mean(0), errors, None, None, None, settled, np.square(errors).mean(1))
    case.once(("errors", estimator.fqe, estimator.samples), lambda: (told, begins))
