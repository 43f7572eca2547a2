"""Resamples of units, from which intervals are made."""

import numpy as np
import pytest

from deadreckon.stats.bootstrap import resample_counts


@pytest.mark.parametrize("units", [1, 5, 70_000])
def test_each_resample_has_as_many_units(units):
    counts = resample_counts(np.random.default_rng(0), units, 7)
    assert counts.shape == (7, units)
    np.testing.assert_array_equal(counts.sum(1), units)


def test_counts_are_those_of_a_multinomial():
    """Mean 1, variance 1 - 1/n, covariance -1/n between two units."""
    counts = resample_counts(np.random.default_rng(0), 4, 40_000)
    np.testing.assert_allclose(counts.mean(0), 1.0, atol=0.02)
    np.testing.assert_allclose(np.cov(counts.T), np.eye(4) - 1 / 4, atol=0.02)
    together = np.corrcoef(counts[:-1, 0], counts[1:, 0])[0, 1]
    assert abs(together) < 0.02  # one resample says nothing about the next
