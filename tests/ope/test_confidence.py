"""Bounds by betting: capital by hand, how often they hold, and how tight they are."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope import confidence, intervals

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
BOUNDS = {
    "mixture": lambda x, most: confidence.lower(x, ALPHA),
    "hedged": lambda x, most: confidence.lower(x, ALPHA, most=most, bets="hedged"),
    "bernstein": lambda x, most: confidence.bernstein_lower(x, most, ALPHA),
}


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("samples", SAMPLES)
def test_coverage(samples, bound):
    """At least as often as promised, less three standard errors of 400 logs."""
    rng = np.random.default_rng(0)
    for n in (20, 100, 1000):
        x, mean, most = SAMPLES[samples](rng, n)
        held = np.mean(BOUNDS[bound](x, most) <= mean)
        assert held >= 1 - ALPHA - 3 * np.sqrt(ALPHA * (1 - ALPHA) / LOGS), (n, held)


@pytest.mark.parametrize("n", [100, 1000])
@pytest.mark.parametrize("samples", SAMPLES)
def test_bets_are_tighter_than_what_they_replace(samples, n):
    """On average over logs, than one-sided empirical Bernstein (Maurer and Pontil) and Hoeffding bounds."""
    x, _, most = SAMPLES[samples](np.random.default_rng(1), n)
    x = x[:50]
    # A two-sided bound at 2 alpha is a one-sided one at alpha.
    others = [np.mean([bound(row, 0.0, most, 2 * ALPHA)[0] for row in x])
              for bound in (intervals.empirical_bernstein, intervals.hoeffding)]  # fmt: skip
    for name, bound in BOUNDS.items():
        # Where the range is a hundred times the mean, only mixed bets do not pay for it.
        nothing = samples == "heavy" and n == 100 and name != "mixture"
        assert bound(x, most).mean() > (max(others) if nothing else max(0.0, *others)), name


def test_capital_by_hand():
    """Three samples: hedged bets step by step, and the mixture of two fractions."""
    x = np.array([0.5, 1.0, 0.0])
    # Means before each: 1/2, (1/2 + 1/2) / 2, (1/2 + 3/2) / 3; variances: 1/4, (1/4 + 0) / 2, (1/4 + 1/9) / 3.
    mean, bet = confidence._predicted(x, 0.05)
    assert mean == pytest.approx([1 / 2, 1 / 2, 2 / 3])
    term = 2 * np.log(20) / 3
    assert bet == pytest.approx(np.sqrt(term / np.array([1 / 4, 1 / 8, (1 / 4 + 1 / 9) / 3])))
    # Against a mean of 0.25 a fraction of 0.5 gains 1 + 0.5 (x / 0.25 - 1): 1.5, 2.5, 0.5; of 0.1: 1.1, 1.3, 0.9.
    expected = np.log((1.5 * 2.5 * 0.5 + 1.1 * 1.3 * 0.9) / 2)
    assert confidence.log_capital(x, np.array(0.25), np.array([0.5, 0.1])) == pytest.approx(expected)
    # Hedged at a level of 0.6 against m: bets exceed their limit c / m, so the capital is 1 + 0.5 (x / m - 1): largest after
    # two samples, where (0.5 + 0.25 / m) (0.5 + 0.5 / m) = 1 / 0.6.
    m = 1 / ((-0.375 + np.sqrt(0.375**2 + 4 * 0.125 * (1 / 0.6 - 0.25))) / (2 * 0.125))
    found = confidence.lower(x, 0.6, most=1.0, bets="hedged")
    assert (confidence._predicted(x, 0.6)[1] > 0.5 / m).all()
    assert found == pytest.approx(m)


def test_bernstein_by_hand():
    x = np.array([0.9, 0.8])
    mean, bet = confidence._predicted(x, 0.5)
    bet = np.minimum(bet, 0.5)
    psi = (-np.log(1 - bet) - bet) / 4
    expected = ((bet * x).sum() - np.log(2) - (4 * (x - mean) ** 2 * psi).sum()) / bet.sum()
    assert confidence.bernstein_lower(x, 1.0, 0.5) == pytest.approx(max(expected, 0.0))
    assert confidence.bernstein_lower(np.full(50, 1.8), 2.0, 0.5) > 1.0


def test_mixtures_know_neither_order_nor_unit():
    rng = np.random.default_rng(0)
    x = rng.lognormal(0.0, 1.0, 200)
    bound = confidence.lower(x)
    assert confidence.lower(rng.permutation(x)) == pytest.approx(bound)
    assert confidence.lower(1e6 * x) == pytest.approx(1e6 * bound)
    assert 0.5 < bound < x.mean()
    assert confidence.lower(np.stack([x, 2 * x])) == pytest.approx([bound, 2 * bound])
    assert confidence.lower(np.zeros(10)) == 0.0
    assert confidence.lower(x, 0.01) < bound


def test_clipped_weights_still_bound():
    """The value is below no bound, whatever is clipped; a return from -2 to 1, and weights without end."""
    rng = np.random.default_rng(0)
    n, value = 300, []
    z = rng.standard_normal((LOGS, n))
    log_weights, returns = 1.0 * z - 0.5, np.where(rng.random((LOGS, n)) < 0.3, -2.0, 1.0)
    for clip in (1.0, 5.0, np.inf):
        low = confidence.weighted_lower(log_weights, returns, -2.0, clip=clip)
        assert np.mean(low <= 0.1) >= 0.92
        value.append(low.mean())
        low, high = confidence.weighted_interval(log_weights, returns, -2.0, 1.0, clip=clip)
        assert np.mean((low <= 0.1) & (high >= 0.1)) >= 0.92
        assert high.max() <= 1.0
        assert low.min() >= -2.0
    assert value[2] > value[0]  # without clipping nothing is lost but what is uncertain
    with pytest.raises(UserError, match="least return"):
        confidence.weighted_lower(log_weights, returns, -1.0)


def test_intervals_are_two_bounds():
    x = np.random.default_rng(0).beta(2, 5, 200) * 4 - 1
    for bets in ("mixture", "hedged"):
        low, high = confidence.interval(x, -1.0, 3.0, bets=bets)
        assert low == pytest.approx(-1 + confidence.lower(x + 1, 0.025, most=4.0, bets=bets))
        assert high == pytest.approx(3 - confidence.lower(3 - x, 0.025, most=4.0, bets=bets))
        assert low < 4 * 2 / 7 - 1 < high


def test_what_cannot_be_bounded():
    for x, options, match in (
        ([-1.0], {}, "negative"), ([2.0], {"most": 1.0}, "more than"), ([], {}, "no samples"), ([np.nan], {}, "finite"),
        ([1.0], {"bets": "hedged"}, "largest value"), ([1.0], {"alpha": 0.0}, "alpha"), ([1.0], {"bets": "x"}, "mixture"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=match):
            confidence.lower(np.array(x), **options)
    with pytest.raises(UserError, match="finite range"):
        confidence.interval(np.ones(3), 0.0, np.inf)
