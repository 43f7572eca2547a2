"""Models of the policy that made a log: likelihoods against numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from deadreckon.data.spec import Box, Spec
from deadreckon.data.step import Step
from deadreckon.policies import behavior
from deadreckon.policies.deployed import EnvPolicy

SPEC = Spec.empty((3,), Box([-1.0, -1.0], [1.0, 1.0]), "none")


def _rows(n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    observation = rng.standard_normal((n, 3)).astype(np.float32)
    return observation, np.clip(observation[:, :2] + 0.5 * rng.standard_normal((n, 2)), -1, 1).astype(np.float32)


@pytest.mark.slow
def test_a_clipped_gaussian_has_one_deviation_an_action():
    """Its likelihood is numpy's, and its deviations are best where they are those of its errors."""
    model = behavior.Clipped.create(SPEC, (8,), jax.random.key(0))
    observation, action = _rows()
    errors = action - np.asarray(model.means(observation))
    best = np.sqrt(np.square(errors).mean(0))
    for log_std in (np.zeros(2), np.log(best), np.log(best) + 0.3):
        std = np.exp(log_std)
        wanted = (np.square(errors / std) / 2 + np.log(std) + np.log(2 * np.pi) / 2).sum(1).mean()
        found, told = behavior.loss(behavior.Clipped(model.means, jnp.asarray(log_std)), observation, action, jax.random.key(1))
        np.testing.assert_allclose(found, wanted, rtol=1e-5)
        np.testing.assert_allclose(told["behavior_error"], np.square(errors).mean(), rtol=1e-5)

    def nll(log_std):
        return behavior.loss(behavior.Clipped(model.means, log_std), observation, action, jax.random.key(1))[0]

    np.testing.assert_allclose(jax.grad(nll)(jnp.log(jnp.asarray(best))), 0.0, atol=1e-5)


@pytest.mark.slow
def test_draws_are_cut_to_the_bounds_which_have_what_lies_beyond():
    """Between the bounds densities integrate to what the bounds leave, and both are what the draws say."""
    model = behavior.Clipped.create(SPEC, (8,), jax.random.key(0))
    policy = behavior.policy(behavior.Clipped(model.means, jnp.log(jnp.asarray([0.8, 0.1]))))
    seen = jnp.zeros((20_000, 3))
    drawn = policy.act(_step(seen), (), jax.random.key(2), greedy=False)[0]
    assert float(jnp.abs(drawn).max()) == 1.0
    mean, other = np.asarray(model.means(seen[0]))
    shares = [float((drawn[:, 0] == edge).mean()) for edge in (-1.0, 1.0)]
    assert min(shares) > 0.02
    grid = np.concatenate([[-1.0], np.linspace(-0.9999, 0.9999, 401), [1.0]])
    actions = jnp.asarray(np.stack([grid, np.full(403, 0.05)], 1))
    first = np.exp(policy.log_prob(seen[:403], actions) - stats.norm.logpdf(0.05, other, 0.1))
    at = first[[0, -1]]
    np.testing.assert_allclose(at, stats.norm.cdf([(-1.0 - mean) / 0.8, (mean - 1.0) / 0.8]), rtol=1e-4)
    np.testing.assert_allclose(at, shares, atol=0.01)
    np.testing.assert_allclose(np.trapezoid(first[1:-1], grid[1:-1]) + at.sum(), 1.0, atol=1e-3)


@pytest.mark.slow
def test_a_change_of_bounds_scales_densities_alone():
    """With bounds of two the density is half as large, and what the bounds have is the same."""
    inner = behavior.policy(behavior.Clipped.create(SPEC, (8,), jax.random.key(0)))
    one, two = (EnvPolicy(inner, None, None, -bound * jnp.ones(2), bound * jnp.ones(2)) for bound in (1.0, 2.0))
    seen, actions = jnp.zeros((3, 3)), jnp.asarray([[0.5, 0.1], [1.0, 0.1], [-1.0, 1.0]])
    apart = one.log_prob(seen, actions) - two.log_prob(seen, 2.0 * actions)
    np.testing.assert_allclose(apart, np.log(2.0) * np.array([2, 1, 0]), atol=1e-5)


@pytest.mark.slow
def test_deviations_have_a_least():
    """Of an action that is always the same they would fall without end."""
    model = behavior.Clipped.create(SPEC, (8,), jax.random.key(0))
    policy = behavior.policy(behavior.Clipped(model.means, jnp.full(2, -100.0)))
    assert np.isfinite(policy.log_prob(jnp.zeros((1, 3)), model.means(jnp.zeros((1, 3))))).all()


def _step(observation: np.ndarray):
    n = len(observation)
    return Step(jnp.asarray(observation), jnp.zeros(n), jnp.zeros(n, bool))
