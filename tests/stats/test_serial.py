"""Dependence on the values before, and changes of level that are none."""

import numpy as np
import pytest

from deadreckon.stats.serial import ERRORS, depends, follows, together


def chain(n, rho, rng):
    x = np.empty(n)
    x[0] = rng.normal()
    for i in range(1, n):
        x[i] = rho * x[i - 1] + np.sqrt(1 - rho**2) * rng.normal()
    return x


def test_independent_values_depend_on_none():
    found = np.zeros(2)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        rare, few = rng.random(1000) < 0.03, rng.integers(0, 4, 500)
        for values in (rng.normal(size=300), 1.0 * rare, rng.standard_t(2, 150), 1.0 * few):
            found += depends(values), follows(values)
    assert (found <= [2, 12]).all()  # of 400


@pytest.mark.parametrize("rho", [0.5, 0.9, 0.99])
def test_a_chain_depends_on_its_past(rho):
    for seed in range(20):
        values = chain(1000, rho, np.random.default_rng(seed))
        assert depends(values)
        assert follows(values)
    assert not depends(values[:99])


def test_slow_dependence_that_noise_hides_is_found_by_parts():
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        found += depends(np.sqrt(0.2) * chain(1000, 0.98, rng) + np.sqrt(0.8) * rng.normal(size=1000))
    assert found >= 18


def test_a_change_of_level_is_no_dependence_on_the_value_before():
    found = np.zeros(2)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        late, noise = np.arange(400) >= 200, rng.normal(size=400)
        for values in (noise + 3 * late, noise * np.where(late, 0.1, 1), (rng.random(400) < 0.1 + 0.8 * late) * 1.0):
            found += follows(values), follows(values, ERRORS)
        assert depends(rng.normal(size=400) + 3 * late)
    assert (found <= [4, 0]).all()  # of 60


def test_as_many_values_are_taken_together_as_depend_on_each_other():
    for rho, low, high in ((0.5, 4, 16), (0.9, 32, 128), (0.99, 256, 1000)):
        found = [together(chain(20_000, rho, np.random.default_rng(seed))) for seed in range(5)]
        assert all(low <= each <= high for each in found), (rho, found)
    assert together(chain(200, 0.99, np.random.default_rng(0))) == 10  # a twentieth
    assert together(np.arange(1000.0)) == 50
    for seed in range(5):  # noise hides how far it reaches
        rng = np.random.default_rng(seed)
        assert together(np.sqrt(0.05) * chain(1000, 0.99, rng) + np.sqrt(0.95) * rng.normal(size=1000)) == 50
    assert follows(np.arange(50.0))
