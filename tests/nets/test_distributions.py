"""Densities against scipy and numerical integration."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy import integrate, stats

from deadreckon.nets import distributions as dist


def test_log_prob_is_that_of_a_squashed_gaussian():
    d = dist.Gaussian(jnp.array([[0.3, -1.0]]), jnp.array([[-0.5, 0.2]]))
    pre = np.array([[0.9, -2.0]])
    expected = (
        stats.norm.logpdf(pre, np.asarray(d.mean), np.exp(np.asarray(d.log_std))) - np.log(1 - np.tanh(pre) ** 2)
    ).sum()
    np.testing.assert_allclose(dist.log_prob(d, jnp.asarray(pre))[0], expected, rtol=1e-5)


def test_density_integrates_to_one():
    d = dist.Gaussian(jnp.array([[0.4]]), jnp.array([[-0.3]]))
    density = lambda a: float(jnp.exp(dist.log_prob(d, jnp.arctanh(jnp.array([[a]])))[0]))  # noqa: E731
    total, _ = integrate.quad(density, -0.9999, 0.9999, limit=60, epsabs=1e-4, epsrel=1e-4)
    assert abs(total - 1) < 2e-3


def test_saturated_actions_have_finite_density_and_gradient():
    value, grad = jax.value_and_grad(lambda x: dist.log_prob(dist.Gaussian(jnp.zeros(1), jnp.zeros(1)), x))(jnp.array([30.0]))
    assert np.isfinite(value)
    assert np.isfinite(grad).all()


def test_kl_equals_closed_form_and_vanishes_on_itself():
    p = dist.Gaussian(jnp.array([0.5, -0.2]), jnp.array([0.1, -0.4]))
    q = dist.Gaussian(jnp.array([0.0, 0.3]), jnp.array([-0.2, 0.5]))
    assert abs(float(dist.kl(p, p))) < 1e-6
    pm, ps, qm, qs = (np.asarray(v, float) for v in (p.mean, np.exp(p.log_std), q.mean, np.exp(q.log_std)))
    expected = (np.log(qs / ps) + (ps**2 + (pm - qm) ** 2) / (2 * qs**2) - 0.5).sum()
    np.testing.assert_allclose(dist.kl(p, q), expected, rtol=1e-5)


def test_sample_has_the_right_moments():
    d = dist.Gaussian(jnp.full((1, 1), 0.5), jnp.full((1, 1), np.log(0.3)))
    x = np.asarray(dist.sample(d, jax.random.key(0), (20_000,)))
    assert abs(x.mean() - 0.5) < 0.01
    assert abs(x.std() - 0.3) < 0.01
