"""Calibration of propensities: known scales are recovered, and a model that was fitted too long is made less sure."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import BehaviorModel, OPEInput
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.propensities import shifts, temperature
from deadreckon.policies import BlackBoxPolicy


def log_softmax(z):
    return z - z.max(1, keepdims=True) - np.log(np.exp(z - z.max(1, keepdims=True)).sum(1, keepdims=True))


def drawn(logits, rng):
    edges = np.exp(log_softmax(logits)).cumsum(1)
    return (rng.random(len(logits))[:, None] >= edges[:, :-1]).sum(1)


def likelihood(logits, taken):
    return log_softmax(logits)[np.arange(len(taken)), taken].mean()


@pytest.mark.slow
@pytest.mark.parametrize("true", [0.5, 1.0, 3.0])
def test_a_known_temperature_is_recovered(true):
    """Within four standard errors of 50,000 rows, and no other is likelier."""
    rng = np.random.default_rng(0)
    logits = 2.0 * rng.standard_normal((50_000, 4))
    taken = drawn(logits / true, rng)
    found = temperature(logits, taken)
    assert found == pytest.approx(true, rel=0.04)
    assert temperature(log_softmax(logits), taken) == pytest.approx(found)  # logits or log-probabilities
    best = likelihood(logits / found, taken)
    assert best >= max(likelihood(logits / (found * (1 + x)), taken) for x in (-0.01, 0.01))


def test_the_exact_optimum_of_two_actions():
    """Logits of log 4 either way, and three of four rows as said: odds of 3, so T = log 4 / log 3."""
    logits = np.array([[np.log(4), 0.0]] * 4)
    assert temperature(logits, np.array([0, 0, 0, 1])) == pytest.approx(np.log(4) / np.log(3))
    # An action that is excluded changes nothing.
    more = np.concatenate([logits, np.full((4, 1), -np.inf)], 1)
    assert temperature(more, np.array([0, 0, 0, 1])) == pytest.approx(np.log(4) / np.log(3))
    assert temperature(logits, np.zeros(4, int)) == 0.01  # all as said: the surer the better
    assert temperature(logits, np.ones(4, int)) == 100.0
    assert temperature(np.zeros((4, 2)), np.ones(4, int)) == 100.0  # says nothing at any temperature


@pytest.mark.slow
def test_an_overfitted_model_is_too_sure():
    """Logistic regression on as many features as rows: out of fold T is far above one, and the likelihood improves."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    x = rng.standard_normal((1200, 100))
    taken = drawn(np.stack([0.7 * x[:, 0], np.zeros(1200)], 1), rng)
    fit, fold, test = np.split(np.arange(1200), [150, 650])
    sign = np.where(taken[fit] == 0, 1.0, -1.0)
    w = minimize(lambda w: np.logaddexp(0, -sign * (x[fit] @ w)).sum() + 0.05 * w @ w, np.zeros(100)).x
    logits = np.stack([x @ w, np.zeros(1200)], 1)
    t = temperature(logits[fold], taken[fold])
    assert t > 2.0
    assert temperature(logits[fit], taken[fit]) < 1.0  # what it was fitted to shows the opposite
    assert likelihood(logits[test] / t, taken[test]) > likelihood(logits[test], taken[test]) + 0.1


def test_shifts_make_actions_as_frequent_as_they_are():
    """A model that is right but for a shift is mended; an action that was never taken becomes rare, and not impossible."""
    rng = np.random.default_rng(0)
    logits = rng.standard_normal((20_000, 4))
    chances = np.exp(logits) / np.exp(logits).sum(1, keepdims=True)
    taken = (rng.random(len(chances))[:, None] >= chances.cumsum(1)[:, :-1]).sum(1)
    off = np.array([1.0, -0.5, 0.0, 0.3])
    found = shifts(logits + off, taken)
    assert np.ptp(found + off) < 0.12
    mended = np.exp(logits + off + found)
    mended /= mended.sum(1, keepdims=True)
    assert np.allclose(mended.mean(0), np.bincount(taken) / len(taken), atol=1e-3)

    some, few = logits[:80], np.minimum(taken[:80], 2)  # the last one is never taken
    left = np.exp(some + shifts(some, few))
    left /= left.sum(1, keepdims=True)
    assert 0.0 < left[:, 3].mean() < 0.02


def test_what_cannot_be_calibrated():
    z = np.zeros((2, 2))
    for logits, taken, match in (
        (z, np.zeros(3, int), "shapes"), (z, np.array([0, 2]), "0 .. 1"), (z * np.nan, np.zeros(2, int), "numbers"),
        (np.array([[-np.inf, 0.0], [0.0, 0.0]]), np.zeros(2, int), "excludes"), (z[:0], np.zeros(0, int), "shapes"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=match):
            temperature(logits, taken)
        with pytest.raises(UserError, match=match):
            shifts(logits, taken)


@pytest.mark.slow
@pytest.mark.parametrize("curved", [False, True])
def test_a_linear_policy_is_found_by_few_rows_and_a_curved_one_by_more(curved):
    """Out of fold, the better of a network and a linear model is near the true propensities; of the other kind it is not."""
    rng = np.random.default_rng(0)
    n, size, actions = (4_000, 2, 2) if curved else (600, 12, 4)
    x = rng.standard_normal((n, size)).astype(np.float32)
    weights = rng.standard_normal((size, actions))
    logits = np.stack([6.0 * (np.abs(x[:, 0]) < 0.7) - 3.0, np.zeros(n)], 1) if curved else x @ weights
    taken = drawn(logits, rng)
    log = Dataset.from_arrays(
        observations=x, actions=taken, rewards=np.zeros(n, np.float32), terminals=np.ones(n, bool),
        action_space=Discrete(actions),
    )  # fmt: skip
    case = OPEInput(log, [BlackBoxPolicy(lambda seen, rng: np.zeros(len(seen), int))], discount=0.0, horizon=1)
    found = out_of_fold(case, BehaviorModel(hidden=(32,), lr=3e-3, steps=1_500), 3)
    excess = likelihood(logits, taken) - found.log_probs.mean()
    line = LogisticRegression(C=0.3).fit(x[: n // 2], taken[: n // 2])
    linear = likelihood(logits, taken) - line.predict_log_proba(x)[np.arange(n), taken][n // 2 :].mean()
    assert excess < (0.25 * linear if curved else 1.5 * linear), (excess, linear)
