"""Bounds by betting: capital by hand, how often they hold, and how tight they are."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.stats import betting, means

ALPHA, LOGS = 0.05, 400


def bernoulli(rng, n):
    return (rng.random((LOGS, n)) < 0.1).astype(float), 0.1, 1.0


def beta(rng, n):
    return rng.beta(2.0, 5.0, (LOGS, n)), 2 / 7, 1.0


def heavy(rng, n):
    """Weights of a normal moved by one, up to 60, times a return of 0 or 1."""
    x = rng.standard_normal((LOGS, n))
    w = np.minimum(np.exp(x - 0.5), 60.0)
    return w * (rng.random((LOGS, n)) < 0.5), 0.5, 60.0  # clipping takes less than 1e-3 off that mean


SAMPLES = {"bernoulli": bernoulli, "beta": beta, "heavy": heavy}


@pytest.mark.parametrize("n", [20, 100, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("samples", SAMPLES)
def test_coverage(samples, n):
    """At least as often as promised, less three standard errors of 400 logs."""
    x, mean, _ = SAMPLES[samples](np.random.default_rng(0), n)
    held = np.mean(betting.lower(x, ALPHA) <= mean)
    assert held >= 1 - ALPHA - 3 * np.sqrt(ALPHA * (1 - ALPHA) / LOGS), held


@pytest.mark.slow
@pytest.mark.parametrize("n", [100, 1000])
@pytest.mark.parametrize("samples", SAMPLES)
def test_bets_are_tighter_than_what_they_replace(samples, n):
    """On average over logs, than one-sided empirical Bernstein (Maurer and Pontil) and Hoeffding bounds."""
    x, _, most = SAMPLES[samples](np.random.default_rng(1), n)
    x = x[:50]
    # A two-sided bound at 2 alpha is a one-sided one at alpha.
    others = [np.mean([bound(row, 0.0, most, 2 * ALPHA)[0] for row in x])
              for bound in (means.empirical_bernstein, means.hoeffding)]  # fmt: skip
    assert betting.lower(x, ALPHA).mean() > max(0.0, *others)


def test_capital_by_hand():
    """Three samples, and the mixture of two fractions."""
    x = np.array([0.5, 1.0, 0.0])
    # Against a mean of 0.25 a fraction of 0.5 gains 1 + 0.5 (x / 0.25 - 1): 1.5, 2.5, 0.5; of 0.1: 1.1, 1.3, 0.9.
    expected = np.log((1.5 * 2.5 * 0.5 + 1.1 * 1.3 * 0.9) / 2)
    assert betting.log_capital(x, np.array(0.25), np.array([0.5, 0.1])) == pytest.approx(expected)


def test_the_bound_is_where_the_capital_reaches_one_over_alpha():
    x = np.random.default_rng(0).exponential(size=40)
    for alpha in (0.01, 0.05, 0.3):
        assert float(np.exp(betting.log_capital(x, betting.lower(x, alpha)))) == pytest.approx(1 / alpha, rel=1e-6)


def test_mixtures_know_neither_order_nor_unit():
    rng = np.random.default_rng(0)
    x = rng.lognormal(0.0, 1.0, 200)
    bound = betting.lower(x)
    assert betting.lower(rng.permutation(x)) == pytest.approx(bound)
    assert betting.lower(1e6 * x) == pytest.approx(1e6 * bound)
    assert 0.5 < bound < x.mean()
    assert betting.lower(np.stack([x, 2 * x])) == pytest.approx([bound, 2 * bound])
    assert betting.lower(np.zeros(10)) == 0.0
    assert betting.lower(x, 0.01) < bound


def test_what_cannot_be_bounded():
    refused = ([-1.0], 0.05, "negative"), ([], 0.05, "no samples"), ([np.nan], 0.05, "finite"), ([1.0], 0.0, "alpha")
    for x, alpha, match in refused:
        with pytest.raises(UserError, match=match):
            betting.lower(np.array(x), alpha)
