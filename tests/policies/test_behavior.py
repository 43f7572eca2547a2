"""Models of the policy that made a log: likelihoods against numpy."""

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.spec import Box, Spec
from deadreckon.policies import behavior
from deadreckon.policies.policy import Step

SPEC = Spec.empty((3,), Box([-1.0, -1.0], [1.0, 1.0]), "none")


def _rows(n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    observation = rng.standard_normal((n, 3)).astype(np.float32)
    return observation, np.clip(observation[:, :2] + 0.5 * rng.standard_normal((n, 2)), -1, 1).astype(np.float32)


def test_a_clipped_gaussian_has_one_deviation_an_action():
    """Its likelihood is numpy's, its deviations are best where they are those of its errors, and its draws are not squashed."""
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
    policy = behavior.policy(behavior.Clipped(model.means, jnp.log(jnp.asarray([2.0, 0.1]))))
    drawn = policy.pre_actions(jnp.zeros((1, 3)), jax.random.key(2), greedy=False, count=(4000,))[:, 0]
    np.testing.assert_allclose(drawn.std(0), [2.0, 0.1], rtol=0.05)
    assert float(jnp.abs(policy.act(_step(observation), (), jax.random.key(3), greedy=False)[0]).max()) > 1.5


def _step(observation: np.ndarray):
    n = len(observation)
    return Step(jnp.asarray(observation), jnp.zeros(n), jnp.zeros(n, bool))
