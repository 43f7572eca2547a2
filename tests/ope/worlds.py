"""Small worlds whose policies are tables, so that estimates can be compared with exact values."""

import numpy as np

from deadreckon.ope.critics import OutOfFold
from deadreckon.policies import BlackBoxPolicy
from deadreckon.theory.tabular import MDP, softmax


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
