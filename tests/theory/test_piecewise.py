"""The class of curves against trying every one of them."""

import itertools

import numpy as np
import pytest

from deadreckon.theory import cnml
from deadreckon.theory.piecewise import Curves, sine


def test_a_small_class_by_enumeration():
    curves = Curves(np.array([0.0, 1.0, 3.0, 4.0]), levels=4, slope=2, spread=0.8)
    rng = np.random.default_rng(0)
    x, label = np.sort(rng.uniform(0.0, 4.0, 5)), rng.integers(0, 4, 5)
    paths = [p for p in itertools.product(range(4), repeat=4) if np.abs(np.diff(p)).max() <= 2]
    assert curves.count == len(paths)
    at = lambda where: np.exp(curves.log_probs(np.array([np.interp(where, curves.knots, p) for p in paths])))  # noqa: E731
    evidence = sum(np.log(at(one)[:, y]) for one, y in zip(x, label))
    scores = curves.scores(x, label)
    assert tuple(curves.best(scores)) == paths[evidence.argmax()]
    for query in (0.0, 0.4, 2.9, 4.0):
        np.testing.assert_allclose(curves.experts(scores, query), cnml.experts(at(query), evidence), atol=1e-12)
        share = np.exp(evidence - evidence.max())
        np.testing.assert_allclose(curves.posterior(scores, query), share @ at(query) / share.sum(), atol=1e-12)
    # Weights count rows.
    twice = curves.scores(np.repeat(x, 2), np.repeat(label, 2))
    np.testing.assert_allclose(curves.scores(x, label, np.full(5, 2.0)), twice)


@pytest.fixture(scope="module")
def found():
    return sine(queries=33, members=8)


def test_nml_is_unsure_where_there_is_no_data(found):
    """Figure 6.3's claim; and the curves are too many to try."""
    assert found.curves.count > 1e20
    entropy = lambda p: -(p * np.log(np.maximum(p, 1e-12))).sum(1)  # noqa: E731
    inside = np.any([(found.queries >= a) & (found.queries <= b) for a, b in ((-4, -1), (1.5, 3))], 0)
    outside = np.abs(found.queries) > 6
    assert entropy(found.nml)[inside].max() < entropy(found.nml)[outside].min()
    assert entropy(found.bootstrap)[outside].mean() < entropy(found.nml)[outside].mean() - 0.5
    for beliefs in (found.nml, found.bayes, found.bootstrap):
        np.testing.assert_allclose(beliefs.sum(1), 1.0)
    truth = np.rint(found.truth).astype(int)
    assert found.nml[np.arange(33), truth].min() > 0.003
    assert found.bootstrap[np.arange(33), truth].min() < 1e-9  # sure, and wrong


def test_the_bounds_at_every_query(found):
    g = np.arange(found.curves.levels) / (found.curves.levels - 1)
    regret = cnml.functional_regret(found.nml, found.known, g).max(1)
    assert (regret <= cnml.sharp_bound(found.known, g) + 1e-12).all()
    assert (cnml.sharp_bound(found.known, g) <= cnml.bound(found.known, g) + 1e-12).all()
