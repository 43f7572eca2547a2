"""Intervals from influence functions, by hand."""

import numpy as np
import pytest

from deadreckon.stats import inference


def test_standard_errors_and_students_interval():
    """Squares of (1, -1, 3, -3) sum to 20: a variance of 20/3, and an error of its root over two."""
    influence = np.array([[1.0, 0.0], [-1.0, 0.0], [3.0, 0.0], [-3.0, 0.0]])
    error = np.sqrt(20 / 3) / 2
    np.testing.assert_allclose(inference.errors(influence), [error, 0.0])
    low, high = inference.student(np.array([5.0, 7.0]), influence)
    reach = 3.182446 * error  # Student's t of three degrees of freedom at 97.5 %
    np.testing.assert_allclose(low, [5.0 - reach, 7.0], rtol=1e-6)
    np.testing.assert_allclose(high, [5.0 + reach, 7.0], rtol=1e-6)
    assert np.isinf(inference.errors(influence[:1])).all()


def test_gains_are_paired_and_endless_where_nothing_is_known():
    """Two estimates that vary together have a difference that is certain."""
    influence = np.random.default_rng(0).standard_normal((30, 1)) * np.array([[1.0, 1.0, -1.0]])
    gain, low, high = inference.gains(np.array([1.0, 4.0, 2.0]), influence, 0, known=np.array([True, True, False]))
    np.testing.assert_allclose(gain, [0.0, 3.0, 1.0])
    np.testing.assert_allclose((low[:2], high[:2]), ([0.0, 3.0], [0.0, 3.0]), atol=1e-12)
    assert (low[2], high[2]) == (-np.inf, np.inf)
    _, low, high = inference.gains(np.array([1.0, 4.0, 2.0]), influence, 0)
    assert high[2] - 1.0 == pytest.approx(1.0 - low[2])
    assert high[2] - 1.0 > 2.045 * inference.errors(2 * influence)[0]  # Student's t of 29 degrees of freedom, at least


def test_a_second_error_widens_by_its_own_students_quantile():
    """Deviations of (3, -3, 0) have a variance of 18 and two degrees of freedom; half-widths add in squares."""
    deviations = np.array([[3.0, 0.0], [-3.0, 0.0], [0.0, 0.0]])
    half = inference.beside(np.array([5.0, 7.0]), deviations)
    np.testing.assert_allclose(half, [np.hypot(5.0, 4.302653 * np.sqrt(18)), 7.0], rtol=1e-6)
    np.testing.assert_allclose(inference.beside(np.zeros(2), deviations, 0.01)[0], 9.924843 * np.sqrt(18), rtol=1e-6)
    np.testing.assert_array_equal(inference.beside(np.ones(2), np.array([[np.nan, 0.0]])), [np.nan, 1.0])


@pytest.mark.filterwarnings("error")
def test_what_is_too_large_to_square_has_no_interval_and_no_warning():
    """As products of weights over hundreds of steps are; the other estimate keeps its interval."""
    influence = np.random.default_rng(0).standard_normal((40, 3))
    own = inference.gains(np.zeros(2), influence[:, :2], 0)
    influence[:, 2] *= 1e200
    difference, low, high = inference.gains(np.zeros(3), influence, 0)
    assert np.isinf(inference.errors(influence)[2])
    assert (low[2], high[2]) == (-np.inf, np.inf)
    assert np.isfinite([low[1], high[1]]).all()
    assert high[1] - low[1] >= own[2][1] - own[1][1]  # two are compared at once
