"""Bounds of chapter 5: held against exact branched rollouts of random worlds, and against each other."""

import math

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.theory import MDP, garnet
from deadreckon.theory.branching import (
    averaged_bound,
    best_length,
    branched_bound,
    branched_occupancy,
    full_bound,
    generalising_bound,
    model_error,
    policy_divergence,
)

BOUNDS = [branched_bound, generalising_bound, averaged_bound, lambda *a, **k: averaged_bound(*a, shifted=False, **k)]


def instance(rng):
    """A random world, a model of it that errs a little, and two policies that differ a little."""
    true = garnet(states=5, actions=2, branches=3, seed=int(rng.integers(2**31)))
    wrong = garnet(states=5, actions=2, branches=3, seed=int(rng.integers(2**31)))
    mix = rng.uniform(0.0, 0.5)
    model = MDP((1 - mix) * true.transitions + mix * wrong.transitions, true.rewards, true.initial)
    old, other = rng.dirichlet(np.ones(2), 5), rng.dirichlet(np.ones(2), 5)
    share = rng.uniform(0.0, 1.0)
    return true, model, old, (1 - share) * old + share * other


def test_bounds_hold_on_random_worlds():
    rng = np.random.default_rng(0)
    for _ in range(500):
        true, model, old, new = instance(rng)
        discount, k = rng.uniform(0.3, 0.98), int(rng.integers(0, 12))
        r_max, policy = np.abs(true.rewards).max(), policy_divergence(old, new)
        value = true.value(new, discount)
        worst, under_old = model_error(true, model), model_error(true, model, old)
        returns = {
            averaged: (branched_occupancy(true, old, model, new, k, discount, averaged=averaged) * true.rewards).sum()
            / (1 - discount)
            for averaged in (False, True)
        }
        assert value >= MDP(model.transitions, true.rewards, true.initial).value(new, discount) - full_bound(
            under_old, policy, discount, r_max
        )
        # The worst error of all is one that the rollouts' own states cannot exceed.
        assert value >= returns[False] - generalising_bound(k, worst, policy, discount, r_max) - 1e-9
        assert value >= returns[True] - averaged_bound(k, worst, policy, discount, r_max) - 1e-9
        assert value >= returns[False] - branched_bound(k, under_old, policy, discount, r_max) - 1e-9
        assert value >= returns[True] - averaged_bound(k, under_old, policy, discount, r_max, shifted=False) - 1e-9


def test_occupancies_of_branched_rollouts():
    rng = np.random.default_rng(1)
    true, model, old, new = instance(rng)
    np.testing.assert_allclose(branched_occupancy(true, old, model, new, 0, 0.9), true.occupancy(old, 0.9))
    # With the true world and one policy a branch changes nothing; a long branch is a rollout in the model.
    np.testing.assert_allclose(branched_occupancy(true, old, true, old, 7, 0.9), true.occupancy(old, 0.9))
    np.testing.assert_allclose(branched_occupancy(true, old, model, new, 400, 0.9), model.occupancy(new, 0.9), atol=1e-12)
    lengths = [branched_occupancy(true, old, model, new, i, 0.9) for i in range(4)]
    np.testing.assert_allclose(branched_occupancy(true, old, model, new, 3, 0.9, averaged=True), np.mean(lengths, 0))
    assert all(each.sum() == pytest.approx(1.0) for each in lengths)
    # Length 1 by hand: at time t the old policy's state and action of t - 1, then a step of the model and a new action.
    now = true.initial[:, None] * old
    wanted = 0.1 * true.initial[:, None] * new
    for t in range(1, 400):
        wanted = wanted + 0.1 * 0.9**t * np.einsum("sa,sau->u", now, model.transitions)[:, None] * new
        now = np.einsum("sa,sau->u", now, true.transitions)[:, None] * old
    np.testing.assert_allclose(lengths[1], wanted, atol=1e-12)


@pytest.mark.parametrize("bound", BOUNDS)
def test_bounds_grow_with_errors_and_scale_with_rewards(bound):
    rng = np.random.default_rng(0)
    for _ in range(200):
        k, discount = int(rng.integers(0, 20)), rng.uniform(0.1, 0.99)
        model, policy, more = rng.uniform(0.0, 0.5, 3)
        own = bound(k, model, policy, discount)
        assert bound(k, model, policy, discount, 3.0) == pytest.approx(3.0 * own)
        assert bound(k, model + more, policy, discount) >= own
        assert bound(k, model, policy + more, discount) >= own
        assert bound(k, model, policy, min(discount + 0.005, 0.995)) >= own
        assert bound(k, 0.0, 0.0, discount) == 0.0


def test_best_length():
    rng = np.random.default_rng(0)
    for _ in range(500):
        discount, (model, policy) = rng.uniform(0.1, 0.99), rng.uniform(0.001, 0.9, 2)
        found = best_length(model, policy, discount)
        assert (found > 0) == (model < policy)
        values = [generalising_bound(k, model, policy, discount) for k in range(int(found) + 50)]
        assert values[int(found)] == pytest.approx(min(values))
    assert best_length(0.25, 0.5, 0.5) == 1
    assert best_length(0.5 * (1 - 1e-12), 0.5, 0.99) == 1  # however little better
    assert best_length(0.0, 0.5, 0.9) == math.inf
    assert best_length(0.0, 0.0, 0.9) == 0
    assert best_length(0.1, 0.2, 0.0) == 1
    # Taken under the old policy, as in 5.2.2, no length is better than none.
    assert all(branched_bound(k, 0.0, 0.3, 0.9) >= branched_bound(0, 0.0, 0.3, 0.9) for k in range(100))


def test_errors_of_policies_and_models():
    true = MDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), np.zeros((2, 1)), np.array([1.0, 0.0]))
    model = MDP(np.array([[[0.2, 0.5]], [[0.0, 1.0]]]), np.zeros((2, 1)), np.array([1.0, 0.0]))  # ends with 0.3
    assert model_error(true, model) == pytest.approx(0.3)
    assert model_error(true, model, np.ones((2, 1))) == pytest.approx(0.3)  # at the first step
    assert model_error(true, MDP(true.transitions, true.rewards, true.initial), np.ones((2, 1))) == 0.0
    assert policy_divergence(np.array([[1.0, 0.0], [0.5, 0.5]]), np.array([[0.75, 0.25], [0.5, 0.5]])) == 0.25


def test_refusals():
    with pytest.raises(UserError, match=r"discount must be 0 \.\. 1 without 1, got 1.0"):
        full_bound(0.1, 0.1, 1.0)
    with pytest.raises(UserError, match=r"errors are total variations, 0 \.\. 1, got 1.5 and 0.1"):
        branched_bound(1, 1.5, 0.1, 0.9)
