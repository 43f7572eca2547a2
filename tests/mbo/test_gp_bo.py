"""The Gaussian process and its acquisition against scipy and scikit-learn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import log_ndtr

from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.gp_bo import GPBO, log_improvement
from deadreckon.mbo.variables import Variable


@pytest.mark.slow
def test_log_improvement_is_the_logarithm_of_the_integral():
    u = np.linspace(-12.0, 4.0, 200)
    # u Phi(u) + phi(u) is the integral of Phi up to u; by quadrature of exp(log Phi), which keeps its digits far out.
    grid = np.linspace(-15.0, 0.0, 200_001)
    exact = np.log([np.trapezoid(np.exp(log_ndtr(grid + v)), grid) for v in u])
    np.testing.assert_allclose(log_improvement(jnp.asarray(u, jnp.float32)), exact, atol=4e-3)


@pytest.mark.slow
def test_log_improvement_has_a_slope_everywhere():
    slope = jax.vmap(jax.grad(log_improvement))(jnp.array([-30.0, -5.001, -4.999, 0.0, 8.0]))
    assert np.isfinite(slope).all()
    assert (np.asarray(slope) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["rbf", "inner"])
def test_posterior_is_that_of_scikit_learn(kernel):
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (60, 2))
    y = np.sin(3 * x[:, 0]) + x[:, 1] + 0.05 * rng.normal(size=60)
    data = Designs.from_arrays(x, y, [Variable("a", low=-1, high=1), Variable("b", low=-1, high=1)])
    view = data.coordinates
    process = GPBO(kernel=kernel).fit(DesignInput(data, 8, [0], None, lambda what, step, steps: None))
    kernels = gaussian_process.kernels
    near = kernels.RBF(float(view.size) ** 0.5, (1e-2, 1e3)) if kernel == "rbf" else kernels.DotProduct(1.0, (1e-3, 1e3))
    whole = kernels.ConstantKernel(1.0, (1e-6, 1e3)) * near + kernels.WhiteKernel(0.1, (1e-3, 1e1))
    z, score = view.encode(data.x).astype(np.float64), (data.y - view.y_mean) / view.y_std
    model = gaussian_process.GaussianProcessRegressor(whole, random_state=0).fit(z, score)
    asked = view.encode(rng.uniform(-1, 1, (20, 2))).astype(np.float64)
    mean, std = model.predict(asked, return_std=True)
    std = np.sqrt(np.square(std) - model.kernel_.k2.noise_level)  # ours is that of the score without noise
    ours = process.posterior(jnp.asarray(asked, jnp.float32))
    np.testing.assert_allclose(ours[0], mean, atol=5e-3)
    np.testing.assert_allclose(ours[1], std, atol=5e-3)
