"""The shape of tails: known ones are found, and what has none is told apart from what nobody can tell."""

import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.pareto import diagnosed, pareto_k
from deadreckon.ope.weights import Episodes, effective_of_logs


@pytest.mark.slow
@pytest.mark.parametrize("k", [0.0, 0.3, 0.7, 1.2])
def test_known_shapes_are_found(k):
    """On average over 60 samples within 0.08 of the truth, and no one far off."""
    rng = np.random.default_rng(0)
    found = [pareto_k(np.log(stats.genpareto.rvs(k, size=10_000, random_state=rng))) for _ in range(60)]
    assert np.mean(found) == pytest.approx(k, abs=0.08)
    assert np.std(found) < 0.15  # (1 + k) / sqrt(300) by theory


def test_unit_order_and_zeros_do_not_matter():
    logs = np.log(stats.genpareto.rvs(0.5, size=2000, random_state=0))
    k = pareto_k(logs)
    assert pareto_k(logs + 500.0) == pytest.approx(k)
    assert pareto_k(logs[::-1]) == k
    assert pareto_k(np.concatenate([np.full(700, -np.inf), logs])) == k


def test_it_is_that_of_psis_where_nothing_is_tied():
    from arviz_stats.base.array import array_stats

    for n in (30, 226, 1000, 5000):
        logs = np.random.default_rng(n).standard_normal(n) * 2
        assert pareto_k(logs) == pytest.approx(float(array_stats.psislw(-logs)[1]), abs=1e-9)


def test_what_has_no_tail():
    assert pareto_k(np.zeros(1000)) == -np.inf
    rng = np.random.default_rng(0)
    assert pareto_k(np.log(rng.choice([0.5, 1.5], 1000))) == -np.inf  # a policy that doubles one of two actions
    assert pareto_k(np.log(rng.choice([0.5, 1.5], 1000) * (1 + 1e-13 * rng.standard_normal(1000)))) == -np.inf
    assert np.isnan(pareto_k(np.full(1000, -np.inf)))
    assert np.isnan(pareto_k(np.zeros(24)))
    assert np.isnan(pareto_k(np.log([1.0] * 1000 + [50.0, 60.0, 70.0])))
    # Products of ties: few values, yet a tail.
    steps = rng.choice([0.5, 1.5], (2000, 30))
    assert 0.0 < pareto_k(np.log(steps).sum(1)) < 2.0
    for bad in (np.nan, np.inf):
        with pytest.raises(UserError, match="finite"):
            pareto_k(np.array([0.0, bad]))


def test_a_tail_beyond_floats_is_the_heaviest():
    """All but a few of its weights are zero beside the largest; a fit to zeros found a k of 0.1 to 0.3."""
    for n in (40, 400):
        found = diagnosed([1000 * np.random.default_rng(0).standard_normal(n)])
        assert found["pareto k"][0] == found["pareto k low"][0] == np.inf
    assert 1 < pareto_k(20 * np.random.default_rng(0).standard_normal(400)) < np.inf


def test_k_of_a_short_tail_is_not_certain():
    """Weights of k = 0.4: of sixty, k is found above 0.7 often, and hardly ever with confidence."""
    rng = np.random.default_rng(0)
    many = [np.log(stats.genpareto.rvs(0.4, size=60, random_state=rng)) for _ in range(200)]
    found = diagnosed(many)
    assert (found["pareto k"] > 0.7).mean() > 0.1
    assert (found["pareto k low"] > 0.7).mean() < 0.05
    heavy = diagnosed([np.log(stats.genpareto.rvs(1.5, size=2000, random_state=rng)) for _ in range(20)])
    assert (heavy["pareto k low"] > 0.7).all()
    assert diagnosed([np.zeros(100)])["pareto k low"][0] == -np.inf


def test_the_bound_rests_on_the_weights_that_the_tail_was_fitted_to():
    """Of 1,000 weights 100 equal the threshold, so that the tail has 20 weights, not 94."""
    tail = 2.0 + stats.genpareto.rvs(0.8, size=20, random_state=0)
    logs = np.log(np.concatenate([np.ones(880), np.full(100, 2.0), tail]))
    found = diagnosed([logs])
    k = float(found["pareto k"][0])
    assert k == pareto_k(logs)
    assert found["pareto k low"][0] == pytest.approx(k - 1.645 * (1.0 + k) / np.sqrt(20))


def test_two_weights_have_no_tail():
    """The largest of them is the largest there is, however few exceed the threshold."""
    assert pareto_k(np.log(np.repeat([0.9, 1.1], [800, 200]))) == -np.inf
    assert pareto_k(np.log(np.repeat([0.9, 1.1], [990, 10]))) == -np.inf


def test_an_episode_that_has_ended_keeps_its_last_weight_for_the_rest_of_the_time():
    """Two episodes of 1 and 4 steps, with weights of 3, and of 2 each: their sums are 4 * 3 and 4 * 2 without discounting."""
    log = Dataset.from_arrays(
        observations=np.zeros((5, 1)), actions=np.zeros((5, 1)), rewards=np.zeros(5), terminals=np.array([1, 0, 0, 0, 1], bool)
    )
    log_rho = np.log([3.0, 2.0, 2.0, 2.0, 2.0])
    np.testing.assert_allclose(np.exp(Episodes(log, 1.0, 0, np.arange(2)).typical(log_rho, whole=False)), [12.0, 8.0])
    half = 1 + 0.5 + 0.25 + 0.125
    np.testing.assert_allclose(np.exp(Episodes(log, 0.5, 0, np.arange(2)).typical(log_rho, whole=False)), [3 * half, 2 * half])
    np.testing.assert_allclose(np.exp(Episodes(log, 0.0, 0, np.arange(2)).typical(log_rho, whole=False)), [3.0, 2.0])
    # Of two that go on after the first step one is cut off there: it has no more, and the other counts twice from then on.
    cut = Dataset.from_arrays(
        observations=np.zeros((3, 1)), actions=np.zeros((3, 1)), rewards=np.zeros(3), terminals=np.array([0, 0, 1], bool),
        timeouts=np.array([1, 0, 0], bool),
    )  # fmt: skip
    weights = Episodes(cut, 1.0, 0, np.arange(2)).typical(np.log([3.0, 2.0, 2.0]), whole=False)
    np.testing.assert_allclose(np.exp(weights), [3.0, 2.0 + 2.0 * 2.0])


def test_effective_sizes_of_logarithms():
    found = effective_of_logs(np.array([[800.0, 0.0, -np.inf], [-900.0, -900.0, -np.inf], [-np.inf] * 3]))
    np.testing.assert_allclose(found, [1.0, 2.0, 0.0])
