"""Ends that hold at all looks, and what happens where a sample breaks the range that they rest on."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.stats.betting import lower
from deadreckon.stats.confidence_sequence import confidence_sequence, refuted_at


def test_ends_hold_at_all_samples_at_once():
    """Of 400 sequences at 10 %, looked at after every sample: by Ville's inequality no more than a tenth is ever wrong."""
    rng = np.random.default_rng(0)
    x = rng.beta(0.5, 1.5, (400, 300))  # skewed, of mean 1/4
    wrong = [refuted_at(row, (0.0, 1.0), 0.25, 0.05) is not None for row in x]
    other = [refuted_at(-row, (-1.0, 0.0), -0.25, 0.05) is not None for row in x]
    assert np.mean(np.logical_or(wrong, other)) <= 0.10
    assert np.mean(wrong) <= 0.05
    assert np.mean(other) <= 0.05


def test_the_last_end_is_that_of_betting_unless_an_earlier_one_is_higher():
    x = np.random.default_rng(1).uniform(0, 1, 200)
    found = confidence_sequence(x, (0.0, 1.0), 0.1)
    assert found.counts[-1] == 200
    assert found.means[-1] == pytest.approx(x.mean())
    assert found.low[-1] >= lower(x, 0.05) - 1e-5
    assert found.high[-1] <= 1 - lower(1 - x, 0.05) + 1e-5
    assert (np.diff(found.low) >= 0).all()
    assert (np.diff(found.high) <= 0).all()


def test_a_mean_that_falls_is_found_and_stays_found():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(0, 1, 100), rng.uniform(0, 0.2, 400)])
    at = refuted_at(x, (0.0, 1.0), 0.5, 0.05)
    assert at is not None
    assert 100 < at < 500
    again = np.concatenate([x[:at], np.ones(1000)])  # whatever follows
    assert refuted_at(again, (0.0, 1.0), 0.5, 0.05) == at
    assert refuted_at(x[: at - 1], (0.0, 1.0), 0.5, 0.05) is None


def test_a_sample_beyond_the_range_opens_the_end_that_rests_on_it_and_no_other():
    x = np.random.default_rng(3).uniform(0, 1, 300)
    x[150] = 1.5
    found = confidence_sequence(x, (0.0, 1.0), 0.1)
    assert np.isposinf(found.high[found.counts > 150]).all()
    assert np.isfinite(found.high[found.counts <= 150]).all()
    assert np.isfinite(found.low).all()
    assert refuted_at(x, (0.0, 1.0), 0.9, 0.05) == refuted_at(x[:150], (0.0, 1.0), 0.9, 0.05)  # what was found before holds
    assert refuted_at(np.append(1.5, np.zeros(100)), (0.0, 1.0), 0.9, 0.05) is None
    below = confidence_sequence(-x, (-1.0, 0.0), 0.1)
    assert np.isneginf(below.low[-1])
    assert np.isfinite(below.high[-1])


def test_a_mean_beyond_the_range_is_refuted_by_any_sample_within_it():
    assert refuted_at(np.array([1.0, 0.5]), (0.0, 1.0), 2.0, 0.05) == 1
    assert refuted_at(np.array([1.0, 1.0, 0.5]), (0.0, 1.0), 1.0, 0.05) == 3
    assert refuted_at(np.ones(50), (0.0, 1.0), 1.0 + 1e-15, 0.05) is None
    assert refuted_at(np.array([1.5, 0.5]), (0.0, 1.0), 2.0, 0.05) is None  # the range does not hold


@pytest.mark.parametrize(("x", "bounds"), [([], (0, 1)), ([0.5, np.nan], (0, 1)), ([0.5], (1, 1)), ([0.5], (0, np.inf))])
def test_what_it_needs_is_said(x, bounds):
    with pytest.raises(UserError, match="confidence sequence needs"):
        confidence_sequence(np.array(x), bounds)
