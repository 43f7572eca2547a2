"""Intervals of means: constants by hand."""

import numpy as np
import pytest
from scipy import stats

from deadreckon.stats import bootstrap, crossed, means
from deadreckon.stats.interval import Interval


def test_constants_by_hand():
    x = np.array([0.0, 1.0, 1.0, 0.0, 1.0])
    assert means.student(x) == pytest.approx((0.6 - 2.776445 * 0.5477226 / 5**0.5, 0.6 + 2.776445 * 0.5477226 / 5**0.5))
    half = np.sqrt(np.log(40) / 10)
    assert means.hoeffding(x, 0.0, 1.0) == pytest.approx((0.6 - half, 0.6 + half))
    half = np.sqrt(2 * 0.3 * np.log(80) / 5) + 7 * np.log(80) / (3 * 4)
    assert means.empirical_bernstein(x, 0.0, 1.0) == pytest.approx((0.6 - half, 0.6 + half))
    # A range of 2 is twice as wide a Hoeffding interval.
    low, high = means.hoeffding(2 * x, 0.0, 2.0)
    assert high - low == pytest.approx(2 * 2 * np.sqrt(np.log(40) / 10))
    assert means.student(x[:1]) == (-np.inf, np.inf)


def test_an_ensembles_interval_is_the_interval_of_one_more_draw():
    """A truth that is one more draw of what the members are drawn from lies inside in 95 % of cases."""
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((4, 20_000))
    low, high = bootstrap.ensemble_interval(draws[:3])
    assert abs(((low < draws[3]) & (draws[3] < high)).mean() - 0.95) < 0.01
    assert np.isnan(bootstrap.ensemble_interval(draws[:1])[0]).all()


def test_percentiles_and_what_lies_beyond_them():
    """Exactly percentiles where there are samples enough, a normal's continuation where not, wider for few episodes."""
    draws = np.arange(1000) / 999.0
    assert bootstrap.percentile_interval(draws, np.inf) == pytest.approx((0.025, 0.975))
    normal = stats.norm.ppf((np.arange(1000) + 0.5) / 1000)
    for alpha in (0.05, 0.05 / 11, 0.05 / 200):
        end = stats.norm.ppf(1 - alpha / 2)
        assert bootstrap.percentile_interval(normal, np.inf, alpha) == pytest.approx((-end, end), rel=0.01)
    few = np.sqrt(5 / 4) * stats.t.ppf(1 - 0.05 / 22, 4)
    assert bootstrap.percentile_interval(normal, 5.0, 0.05 / 11) == pytest.approx((-few, few), rel=0.01)
    # Skewed samples give a skewed interval, also beyond.
    low, high = bootstrap.percentile_interval(np.exp(normal), np.inf, 0.05 / 200)
    assert 3.0 * (1.0 - low) < high - 1.0


def test_the_jackknife_knows_the_error_of_a_mean():
    """Of one that leaves out each row it is s / sqrt(n)."""
    x = np.random.default_rng(0).standard_normal((400, 20))
    found = bootstrap.jackknife((x.sum(0) - x) / 399, 1 / 400)
    np.testing.assert_allclose(np.sqrt(np.square(found).sum(0)), x.std(0, ddof=1) / 20, rtol=1e-9)
    assert np.isnan(bootstrap.jackknife(x[:1], 0.5)).all()


@pytest.mark.parametrize(("groups", "size", "rest"), [(5, 80, 0), (5, 20, 300), (2, 50, 900), (2, 150, 300)])
def test_the_jackknife_is_right_on_average_also_where_groups_do_not_make_up_the_data(groups, size, rest):
    """Its expectation for a mean is exact: rows that each have a variance of one stand for all draws, by linearity."""
    total = groups * size + rest
    # The variance is a quadratic form of the rows: its expectation is the sum of what unit vectors give.
    of_group = [np.where(np.arange(groups) == g, 0.0, 1.0) / (total - size) for g in range(groups)]  # a row of group g alone
    expected = sum(size * np.square(bootstrap.jackknife(values, size / total)).sum() for values in of_group)
    assert expected == pytest.approx(1 / total, rel=1e-12)


def test_one_value_does_not_say_how_it_varies():
    """One seed in one episode, against what has an interval of its own."""
    one, many = np.array([[3.0]]), np.array([[1.0], [2.0], [0.0]])
    for found in (crossed.against(one, Interval(1.0, 0.9, 1.1)), crossed.paired(one, many), crossed.paired(many, one)):
        assert np.isnan([found.low, found.high]).all()
    assert np.isfinite(crossed.paired(many, many + 1.0).low)
    assert np.isfinite(crossed.against(many, Interval(1.0, 0.9, 1.1)).low)
