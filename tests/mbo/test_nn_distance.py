"""Distances to the scored designs."""

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.mbo.variables import Variable


def test_on_a_line_by_hand():
    """Evenly spaced designs: one step is the usual distance."""
    data = Designs.from_arrays(np.arange(20.0)[:, None], np.arange(20.0))
    np.testing.assert_allclose(nn_distance(data, np.array([[3.0], [3.5], [29.0]])), [0.0, 0.5, 10.0], atol=1e-5)


def test_designs_that_are_there_twice_do_not_shrink_the_unit():
    x = np.repeat(np.arange(10.0), 3)[:, None]
    data = Designs.from_arrays(np.concatenate([x, [[10.0]]]), np.arange(31.0))
    np.testing.assert_allclose(nn_distance(data, np.array([[12.0]])), [2.0], atol=1e-5)


def test_letters():
    """A design with one letter changed is as far as the data's nearest neighbours are from one another."""
    variables = [Variable(f"s{i}", "categorical", levels=("a", "b")) for i in range(4)]
    x = np.indices((2,) * 4).reshape(4, -1).T[:12]
    data = Designs.from_arrays(x, np.arange(12.0), variables)
    np.testing.assert_allclose(nn_distance(data, np.array([[1, 1, 0, 0], [1, 1, 1, 1]])), [1.0, 1.0], atol=1e-6)
