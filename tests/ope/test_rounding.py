"""Probabilities that sum to nearly one, gains that are rounding errors, and densities at the ends of the data."""

import dataclasses

import jax
import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.errors import UserError
from deadreckon.ope import OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import decide
from deadreckon.ope.importance import log_ratios
from deadreckon.policies import BlackBoxPolicy
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import TanhMeanGaussian

MODEL = BehaviorModel(hidden=(8,), steps=50, lr=1e-2)


def a_log(rewards, rows=300):
    rng = np.random.default_rng(0)
    return Dataset.from_arrays(
        observations=rng.integers(0, 3, (rows, 1)), actions=rng.integers(0, 3, rows), rewards=rewards(rng, rows),
        terminals=np.ones(rows, bool), behavior_log_probs=np.full(rows, -np.log(3.0)),
    )  # fmt: skip


def with_chances(chances):
    return BlackBoxPolicy(lambda x, rng: rng.integers(0, 3, len(x)), action_probs=lambda x: np.tile(chances, (len(x), 1)))


def test_probabilities_that_sum_to_nearly_one_are_normalised():
    """A sum of 1.0009 made the behaviour policy itself 0.09 better than itself, and deployed it."""
    log = a_log(lambda rng, rows: 100.0 + 5.0 * rng.normal(size=rows))
    case = OPEInput(log, [with_chances(np.full(3, 1.0009 / 3))], names=["same"], logged=True)
    np.testing.assert_allclose(np.exp(case.log_probs), 1 / 3, rtol=1e-6)
    found = decide(case, ["dr-linear"], model=MODEL)
    assert not found.choice.deploy
    assert found.choice.low < 0 < found.choice.high


def test_a_gain_that_is_a_rounding_error_is_none():
    """All rewards are equal: what differs are sums of 32-bit probabilities."""
    log = a_log(lambda rng, rows: np.full(rows, 7.3))
    case = OPEInput(log, [with_chances(np.array([0.1, 0.2, 0.7]))], names=["b"], logged=True)
    found = decide(case, ["dr-linear"], model=MODEL)
    assert not found.choice.deploy
    assert found.choice.low < 0 < found.choice.high


def test_log_probabilities_of_discrete_actions_are_used():
    """They were ignored, and probabilities were frequencies of a hundred draws."""
    log, chances = a_log(lambda rng, rows: rng.normal(size=rows)), np.array([0.001, 0.3, 0.699])
    told = BlackBoxPolicy(lambda x, rng: np.full(len(x), 2), log_prob=lambda x, a: np.log(chances)[a])
    np.testing.assert_allclose(OPEInput(log, [told]).log_probs[0], np.log(chances)[log.actions], rtol=1e-5)
    wrong = BlackBoxPolicy(lambda x, rng: np.full(len(x), 2), log_prob=lambda x, a: np.zeros(len(x)))
    with pytest.raises(UserError, match="log_prob must give .* probabilities that sum to 1 in each row"):
        _ = OPEInput(log, [wrong]).log_probs


def test_weights_do_not_depend_on_the_unit_of_actions():
    """A clipped Gaussian has a probability at the bounds, which by default are the least and greatest logged action: divided by
    their logged densities it grew with the unit, and one row had all of the weight."""
    rng = np.random.default_rng(0)
    actions, seen, found = rng.uniform(-1, 1, (300, 1)), rng.normal(size=(300, 2)), []
    for scale in (1.0, 5000.0):
        log = Dataset.from_arrays(
            observations=seen, actions=scale * actions, rewards=rng.normal(size=300), terminals=np.ones(300, bool),
            behavior_log_probs=np.full(300, -np.log(2.0 * scale)),
        )  # fmt: skip
        inner = TanhMeanGaussian.create(log.spec, (8,), jax.random.key(0), std=0.5)
        case = OPEInput(log, [EnvPolicy.of(inner, Normalizer.of(log.spec))], logged=True)
        found.append(log_ratios(case, "auto", MODEL, None)[0])
    np.testing.assert_allclose(found[1], found[0], atol=2e-3)
    assert found[0].max() < 1.0


def test_other_numbers_of_an_action_at_the_end_of_the_data_keep_their_probabilities():
    """The second is clipped, at bounds that 32-bit arithmetic does not give back exactly, where the first is largest."""
    rng = np.random.default_rng(0)
    actions = np.stack([rng.uniform(-1, 1, 300), rng.normal(size=300).clip(-0.4, 0.4)], 1)
    actions[np.argmax(actions[:, 0]), 1] = -0.4
    log = Dataset.from_arrays(observations=rng.normal(size=(300, 2)), actions=actions, rewards=rng.normal(size=300),
                              terminals=np.ones(300, bool), behavior_log_probs=np.zeros(300))  # fmt: skip
    inner = TanhMeanGaussian.create(log.spec, (8,), jax.random.key(0), std=0.5)
    case = OPEInput(log, [EnvPolicy.of(inner, Normalizer.of(log.spec))])
    row, other = int(np.argmax(actions[:, 0])), actions.copy()
    other[row, 0] -= 1e-3 * np.ptp(actions[:, 0])
    near = OPEInput(dataclasses.replace(log, actions=other.astype(np.float32), part_of=None), [case.policies[0]])
    assert case.log_densities[0, row] == pytest.approx(near.log_probs[0, row], abs=0.02)


def test_where_many_actions_are_clipped_a_bound_keeps_its_probability():
    rng = np.random.default_rng(0)
    actions = rng.normal(size=(300, 1)).clip(-1.0, 1.0)
    log = Dataset.from_arrays(observations=rng.normal(size=(300, 2)), actions=actions, rewards=rng.normal(size=300),
                              terminals=np.ones(300, bool), behavior_log_probs=np.zeros(300))  # fmt: skip
    inner = TanhMeanGaussian.create(log.spec, (8,), jax.random.key(0), std=0.5)
    case = OPEInput(log, [EnvPolicy.of(inner, Normalizer.of(log.spec))])
    np.testing.assert_array_equal(case.log_densities, case.log_probs)
