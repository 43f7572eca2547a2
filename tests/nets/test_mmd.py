"""MMD and kernels against numpy, written from the thesis's formulas, one state and one pair at a time."""

import jax
import numpy as np
import pytest

from deadreckon.nets.mmd import FLOOR, estimated, kernel_values, mmd, squared_mmd

SCALES = (1.0, 10.0, 50.0)


def reference_kernel(kind, x, y, width):
    d = np.asarray(x, np.float64) - np.asarray(y, np.float64)
    if kind == "laplacian":  # A.4: exp(-||x - y|| / sigma)
        return np.exp(-np.sqrt((d**2).sum()) / width)
    if kind == "laplacian_l1":  # official code
        return np.exp(-np.abs(d).sum() / (2 * width))
    if kind == "gaussian":  # A.4 with "the variance sigma^2" = width (ERRATA 4)
        return np.exp(-(d**2).sum() / (2 * width))
    return np.mean([np.exp(-np.sqrt((d**2).sum()) / s) for s in SCALES])


def reference_mmd(kind, x, y, width):
    n, m = len(x), len(y)
    total = sum(reference_kernel(kind, a, b, width) for a in x for b in x) / n**2
    total -= 2 * sum(reference_kernel(kind, a, b, width) for a in x for b in y) / (n * m)
    total += sum(reference_kernel(kind, a, b, width) for a in y for b in y) / m**2
    return np.sqrt(max(total, 0.0) + FLOOR)


@pytest.mark.parametrize("kind", ["laplacian", "laplacian_l1", "gaussian", "mixture"])
def test_kernels_and_mmd_equal_numpy(kind):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(4, 3, 2)).astype("f4"), (0.7 + rng.normal(size=(5, 3, 2))).astype("f4")
    of_both = jax.jit(lambda x, y: (kernel_values(x, y, kind, 20.0, SCALES), mmd(x, y, kind, 20.0, SCALES)))
    values, got = map(np.asarray, of_both(x, y))
    assert values.shape == (4, 5, 3)
    assert got.shape == (3,)
    for state in range(3):
        np.testing.assert_allclose(values[1, 2, state], reference_kernel(kind, x[1, state], y[2, state], 20.0), rtol=1e-5)
        np.testing.assert_allclose(got[state], reference_mmd(kind, x[:, state], y[:, state], 20.0), rtol=2e-3)


def test_the_unbiased_square_has_no_pairs_of_a_draw_with_itself_and_is_zero_in_the_mean_for_one_distribution():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(3, 2, 2)).astype("f4"), (0.7 + rng.normal(size=(4, 2, 2))).astype("f4")
    squared = jax.jit(squared_mmd, static_argnames=("kernel", "unbiased"))
    got = np.asarray(squared(x, y, "gaussian", 2.0, unbiased=True))
    for state in range(2):
        a, b = x[:, state], y[:, state]
        k = lambda u, v: reference_kernel("gaussian", u, v, 2.0)  # noqa: E731
        expected = sum(k(a[i], a[j]) for i in range(3) for j in range(3) if i != j) / 6
        expected += sum(k(b[i], b[j]) for i in range(4) for j in range(4) if i != j) / 12
        expected -= 2 * np.mean([k(u, v) for u in a for v in b])
        np.testing.assert_allclose(got[state], expected, rtol=1e-4, atol=1e-6)
    same = rng.normal(size=(2, 4, 20_000, 3)).astype("f4")
    squares = {flag: float(np.mean(squared(*same, "gaussian", 20.0, unbiased=flag))) for flag in (True, False)}
    assert abs(squares[True]) < 1e-3 < 0.05 < squares[False]  # 2 (1 - E k) / 4 of four draws each


def test_gaussian_bandwidth_is_a_variance():
    """ERRATA 4: at variance 20 a mean shift of 0.5 binds against 0.05, at a standard deviation of 20 it sleeps."""
    x = np.zeros((4, 1, 1), "f4")
    shifted = x + 0.5
    narrow, wide = (float(jax.jit(mmd, static_argnums=2)(x, shifted, "gaussian", width)[0]) for width in (20.0, 400.0))
    assert narrow == pytest.approx(np.sqrt(2 - 2 * np.exp(-0.25 / 40) + FLOOR), rel=1e-3)
    assert narrow > 0.05 > wide


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["laplacian", "laplacian_l1", "gaussian", "mixture"])
def test_gradient_is_finite_where_samples_agree_and_points_home_where_not(kind):
    same = np.ones((3, 2, 2), "f4")
    grad = jax.jit(jax.grad(lambda x: mmd(x, same, kind).sum()))
    assert np.isfinite(grad(same)).all()
    assert (np.asarray(grad(same + 1.0)) > 0).all()  # descending it moves every sample back towards the others


def test_the_relative_mmd_is_zero_for_draws_of_the_model_and_below_for_narrower_ones():
    rng = np.random.default_rng(0)
    x, y, copies = rng.normal(size=(3, 4, 20_000, 3)).astype("f4")
    of = jax.jit(lambda x: estimated("relative", x, y, copies, "gaussian", 20.0, SCALES))
    floor = float(np.mean(mmd(x, y, "gaussian", 20.0)))
    assert floor > 0.2  # what the biased one cannot get below
    own, narrower, moved = (float(np.mean(of(z))) for z in (x, 0.7 * x, x + 0.3))
    assert abs(own) < 2e-3
    assert narrower < -0.02 < 0.005 < moved
    # One action may be about half a deviation from the mean in each dimension, with four draws and a wide kernel: here 0.43.
    near, far = (float(np.mean(of(0.0 * x + place))) for place in (0.35, 0.6))
    assert near < -0.005 < 0.005 < far
    expected = [reference_mmd("gaussian", each[:, 5], y[:, 5], 20.0) for each in (x, copies)]
    np.testing.assert_allclose(of(x)[5], expected[0] - expected[1], atol=1e-4)
