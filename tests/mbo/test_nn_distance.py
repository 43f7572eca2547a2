"""Distances to the scored designs."""

import numpy as np
import pytest

from deadreckon.mbo.batch import Chosen, least_distance
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.local_search import spaced
from deadreckon.mbo.nn_distance import distance_to_others, nn_distance, usual_distance
from deadreckon.mbo.variables import Variable


def test_on_a_line_by_hand():
    """Evenly spaced designs: one step is the typical distance."""
    data = Designs.from_arrays(np.arange(20.0)[:, None], np.arange(20.0))
    np.testing.assert_allclose(nn_distance(data, np.array([[3.0], [3.5], [29.0]])), [0.0, 0.5, 10.0], atol=1e-5)


def test_designs_that_are_there_twice_do_not_shrink_the_unit():
    x = np.repeat(np.arange(10.0), 3)[:, None]
    data = Designs.from_arrays(np.concatenate([x, [[10.0]]]), np.arange(31.0))
    np.testing.assert_allclose(nn_distance(data, np.array([[12.0]])), [2.0], atol=1e-5)


def test_runs_of_a_recipe_whose_settings_are_logged_do_not_shrink_the_unit():
    rng = np.random.default_rng(0)
    recipes = rng.uniform(size=(15, 2))
    logged = np.repeat(recipes, 4, 0) + 1e-3 * rng.standard_normal((60, 2))
    once, several = (Designs.from_arrays(x, np.arange(len(x))) for x in (recipes, logged))
    assert usual_distance(several) == pytest.approx(usual_distance(once), rel=0.05)
    assert least_distance(several) == pytest.approx(least_distance(once), rel=0.05)
    assert nn_distance(several, np.array([[2.0, 2.0]])) == pytest.approx(nn_distance(once, np.array([[2.0, 2.0]])), rel=0.05)
    spread = Designs.from_arrays(np.random.default_rng(1).uniform(size=(60, 2)), np.arange(60))
    z = spread.coordinates.place(spread.x)
    apart = np.linalg.norm(z[:, None] - z, axis=2) + np.diag(np.full(60, np.inf))
    assert usual_distance(spread) == pytest.approx(np.median(apart.min(1)))  # without recipes of several runs, as ever


def test_letters():
    """A design with one letter changed is as far as the data's nearest neighbours are from one another."""
    variables = [Variable(f"s{i}", "categorical", levels=("a", "b")) for i in range(4)]
    x = np.indices((2,) * 4).reshape(4, -1).T[:12]
    data = Designs.from_arrays(x, np.arange(12.0), variables)
    np.testing.assert_allclose(nn_distance(data, np.array([[1, 1, 0, 0], [1, 1, 1, 1]])), [1.0, 1.0], atol=1e-6)


def test_the_order_of_the_levels_is_none_of_the_distance():
    """Any two levels are as far apart, also from the first; batches and searches keep designs apart by the same distances."""
    rng, x = np.random.default_rng(0), np.array([[0.0, i] for i in range(4)], np.float32)
    variables = [Variable("a"), Variable("c", "categorical", levels=tuple("wxyz"))]
    a = rng.normal(size=24)
    data = Designs.from_arrays(np.stack([a, rng.integers(0, 4, 24)], 1), a, variables)
    assert np.ptp(distance_to_others(data, x)) == 0
    alone = Designs.from_arrays(np.stack([a, np.ones(24)], 1), a, variables)
    far = nn_distance(alone, np.array([[alone.x[0, 0], i] for i in range(4)]))
    np.testing.assert_allclose(far / far[0], [1, 0, 1, 1])
    apart, chosen = 2**0.5 + 1e-6, Chosen(data)
    assert len(spaced(data, x, np.arange(4.0), apart, 4)) == 1
    chosen.add(x, 4, apart)
    assert len(chosen.x) == 1
