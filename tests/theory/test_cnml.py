"""Normalised maximum likelihood over small classes: what it minimises, a counter-example to the printed theorem, the bound."""

import numpy as np
import pytest
from scipy.special import comb, xlogy

from deadreckon.theory import cnml


def random_class(rng):
    """Likelihoods of a class of models at a query point, and their evidence on some data."""
    models, labels = rng.integers(1, 8), rng.integers(2, 7)
    likelihoods = rng.dirichlet(np.full(labels, rng.choice([0.2, 1.0, 5.0])), models)
    return likelihoods, rng.normal(0, rng.choice([0.1, 1.0, 5.0]), models), rng.normal(0, 2, labels)


def test_by_hand():
    """Two models, equally good on the data: each label believes the model that likes it."""
    likelihoods = np.array([[0.9, 0.1], [0.2, 0.8]])
    known = cnml.experts(likelihoods, np.zeros(2))
    np.testing.assert_allclose(known, likelihoods)
    np.testing.assert_allclose(cnml.p_nml(known), [0.9 / 1.7, 0.8 / 1.7])
    assert cnml.minimax_regret(known) == pytest.approx(np.log(1.7))
    # Where the data decides, it is that model, and there is nothing to regret.
    sure = cnml.experts(likelihoods, np.array([0.0, -50.0]))
    np.testing.assert_allclose(cnml.p_nml(sure), [0.9, 0.1])
    assert cnml.minimax_regret(sure) == pytest.approx(0.0)


@pytest.mark.slow
def test_it_is_the_minimax_distribution():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        likelihoods, evidence, _ = random_class(rng)
        known = cnml.experts(likelihoods, evidence)
        p, gamma = cnml.p_nml(known), cnml.minimax_regret(known)
        np.testing.assert_allclose(cnml.individual_regret(p, known), gamma, atol=1e-9)
        other = rng.dirichlet(np.ones(len(p)))
        assert cnml.individual_regret(other, known).max() >= gamma - 1e-12


def test_the_theorem_as_printed_has_counter_examples():
    """An expert of another label may like a label better than its own expert does; and g may be negative."""
    likelihoods = np.array([[0.01, 0.98, 0.01], [0.001, 0.5, 0.499]])
    known = cnml.experts(likelihoods, np.log([0.5, 1.0]))
    g = np.array([0.0, 0.0, 1.0])
    regret = cnml.functional_regret(cnml.p_nml(known), known, g).max()
    assert regret == pytest.approx(0.484, abs=1e-3)
    assert cnml.printed_bound(known, g) == pytest.approx(0.134, abs=1e-3)
    assert regret <= cnml.sharp_bound(known, g)
    two = cnml.experts(np.array([[0.9, 0.1], [0.2, 0.8]]), np.zeros(2))
    below = np.array([-1.0, 0.0])
    assert cnml.printed_bound(two, below) == 0.0 < cnml.functional_regret(cnml.p_nml(two), two, below).max()


@pytest.mark.slow
def test_the_corrected_bounds_hold_and_are_never_below_what_gamma_gives():
    rng = np.random.default_rng(1)
    broken = 0
    for _ in range(3000):
        likelihoods, evidence, g = random_class(rng)
        known = cnml.experts(likelihoods, evidence)
        p = cnml.p_nml(known)
        regret = cnml.functional_regret(p, known, g).max()
        assert regret <= cnml.sharp_bound(known, g) + 1e-9
        assert cnml.sharp_bound(known, g) <= cnml.bound(known, g) + 1e-9
        gamma = max(cnml.minimax_regret(known), 0.0)
        assert cnml.bound(known, g) >= np.ptp(g) * np.sqrt(gamma / 2.0) - 1e-9
        positive = g - g.min()
        broken += cnml.functional_regret(p, known, positive).max() > cnml.printed_bound(known, positive)
    assert broken > 0  # the printed one fails by itself now and then


def test_the_sharp_bound_is_met_by_experts_that_are_certain():
    known = np.eye(4)
    g = np.array([0.0, 0.0, 0.0, 1.0])
    regret = cnml.functional_regret(cnml.p_nml(known), known, g).max()
    assert regret == pytest.approx(0.75) == pytest.approx(cnml.sharp_bound(known, g))
    assert regret > 0.89 * cnml.bound(known, g)


@pytest.mark.parametrize("n", [1, 5, 40])
def test_coins(n):
    """(6.2) over a grid of coins that holds the most likely ones is Laplace's rule, not Jeffreys'."""
    coins = np.arange(n + 2) / (n + 1)
    likelihoods = np.stack([1 - coins, coins], 1)
    for ones in range(n + 1):
        with np.errstate(divide="ignore"):
            evidence = xlogy(ones, coins) + xlogy(n - ones, 1 - coins)
        found = cnml.p_nml(cnml.experts(likelihoods, evidence))[1]
        rules = cnml.next_label(np.array(ones), n)
        assert found == pytest.approx(rules["cnml"])
        assert abs(rules["cnml"] - rules["jeffreys"]) <= 1 / (2 * n + 2)


def test_whole_sequences_come_near_jeffreys():
    assert cnml.sequence_regret(1) == pytest.approx(np.log(2))
    assert cnml.sequence_regret(2) == pytest.approx(np.log(1 + 2 / 4 + 1))
    # Bayes' mixture sums to one over all sequences.
    k = np.arange(6)
    best = np.exp(xlogy(k, k / 5) + xlogy(5 - k, 1 - k / 5))
    assert (comb(5, k) * best * np.exp(-cnml.jeffreys_regret(5))).sum() == pytest.approx(1.0)
    for n in (10, 100, 1000, 10_000):
        nml, bayes = cnml.sequence_regret(n), cnml.jeffreys_regret(n)
        assert nml == pytest.approx(0.5 * np.log(np.pi * n / 2), abs=1 / np.sqrt(n))
        assert bayes.max() >= nml - 1e-12  # nothing is better in the worst case
        assert abs(bayes[n // 2] - nml) < 1 / np.sqrt(n)
        assert bayes[0] - nml == pytest.approx(0.5 * np.log(2), abs=1 / np.sqrt(n))
