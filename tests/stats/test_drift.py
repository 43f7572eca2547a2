"""Tests that exchange units: right about noise, right about change, whatever rows of a unit have to do with each other."""

import numpy as np
import pytest

from deadreckon.stats import drift


def p_value(old, new, rng, alpha=0.05):
    """The p-value of one column of (units, rows) numbers."""
    features = drift.number_features(old.ravel(), new.ravel())
    sums = [part.reshape(*side.shape, -1).sum(1) for part, side in zip(features, (old, new))]
    return drift.test([sums[0]], [sums[1]], tuple(np.full(len(side), side.shape[1]) for side in (old, new)), alpha, rng)[0]


def test_equal_units_are_accused_no_more_often_than_said():
    """Rows of a unit are nearly copies: tests that exchanged rows would accuse most of these pairs."""
    rng = np.random.default_rng(0)
    p = []
    for _ in range(150):
        old, new = (rng.normal(size=(n, 1)) + 0.1 * rng.normal(size=(n, 10)) for n in (60, 30))
        p.append(p_value(old, new, rng))
    assert np.mean(np.array(p) <= 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 150)
    assert np.mean(np.array(p) <= 0.5) >= 0.3  # and they are no less often small than they may be


@pytest.mark.slow
def test_many_columns_are_corrected_for():
    rng = np.random.default_rng(1)
    wrong = 0
    for _ in range(60):
        old, new = rng.normal(size=(60, 8)), rng.normal(size=(30, 8))
        pairs = [drift.number_features(old[:, i], new[:, i]) for i in range(8)]
        p = drift.test([a for a, _ in pairs], [b for _, b in pairs], (np.ones(60), np.ones(30)), 0.05, rng)
        wrong += p.min() <= 0.05
    assert wrong <= 60 * (0.05 + 3 * np.sqrt(0.05 * 0.95 / 60))


def test_a_change_is_found_in_its_column_alone():
    rng = np.random.default_rng(2)
    old, new = rng.normal(size=(200, 3)), rng.normal(size=(80, 3))
    new[:, 1] += 1.0
    pairs = [drift.number_features(old[:, i], new[:, i]) for i in range(3)]
    p = drift.test([a for a, _ in pairs], [b for _, b in pairs], (np.ones(200), np.ones(80)), 0.01, rng)
    assert p[1] <= 0.01
    assert min(p[0], p[2]) > 0.01


def test_an_atom_with_fewer_decimals_is_no_change():
    """Half of the actions saturate at a bound; one sample has it rounded, the other from 32-bit arithmetic."""
    rng = np.random.default_rng(3)
    old, new = (np.minimum(rng.normal(0.8, 0.4, (n, 1)), 0.8) for n in (200, 160))
    old[old == 0.8] = 0.79999995
    assert p_value(old, np.round(new, 4), rng) > 0.05
    both = np.full((200, 1), 0.123456), np.full((160, 1), 0.1234)  # an atom inside the range, written with four decimals
    for atom, sample in zip(both, (old, new)):
        sample[:50] = atom[:50]
    assert p_value(old, new, rng) > 0.05


@pytest.mark.parametrize("share", [0.01, 0.07])
def test_large_values_hide_no_change_of_the_others(share):
    rng = np.random.default_rng(4)
    old, new = rng.uniform(size=(400, 1)), rng.uniform(0.0, 0.3, size=(200, 1))
    for part in (old, new):
        part[: int(share * len(part))] = 1e6
    assert p_value(old, new, rng) <= 0.05


def test_a_change_of_small_values_beside_large_ones_is_seen():
    rng = np.random.default_rng(5)
    old, new = (np.exp(6.0 * rng.normal(size=(n, 1))) for n in (400, 200))
    new[new < 1] /= 1000.0
    assert p_value(old, new, rng) <= 0.05


def test_a_column_that_never_varies_says_nothing():
    old, new = np.zeros((30, 1)), np.zeros((20, 1))
    assert p_value(old, new, np.random.default_rng(0)) == 1.0


def test_all_tests_together_have_the_level():
    assert drift.epochs(19, 0.05) == []
    total = sum(epoch.alpha for epoch in drift.epochs(20 * 2**30, 0.05))
    assert 0.045 < total <= 0.05
    few, many = drift.epochs(100, 0.05), drift.epochs(1000, 0.05)
    assert many[: len(few)] == few  # what a later look tests begins with what an earlier one did
    assert [(epoch.start, epoch.stop) for epoch in few] == [(0, 20), (0, 40), (20, 40), (0, 80), (40, 80)]


def test_how_many_lie_beyond_is_counted_as_chance_has_it():
    """Against drawing: the share of permutations in which so many of the largest are new."""
    rng = np.random.default_rng(3)
    old, new = np.arange(6.0)[:, None], np.array([[2.5], [7.0], [8.0], [1.5]])
    everything = np.concatenate([old, new])[:, 0]
    more = []
    for _ in range(20_000):
        order = rng.permutation(everything)
        more.append((order[:4] > order[4:].max()).sum() >= 2)
    assert drift.beyond(old, new)[0] == pytest.approx(np.mean(more), abs=0.01)
    assert drift.beyond(old, np.array([[1.0]]))[0] == 1.0
