"""Numbers of a log that are far from 1 in size, and what is said of them."""

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.data.sizes import about_observations, about_rewards, reward_units, unusual, usual_observations
from deadreckon.data.spec import Statistics

ROWS = 20_000
NOISE = np.random.default_rng(0).normal(size=ROWS)
RARE = (np.arange(ROWS) % 5_000 == 0).astype(float)  # 1 in four rows of 20,000


def log(observations, rewards=NOISE):
    columns = {"observations": observations, "actions": np.zeros((len(observations), 1)), "rewards": rewards}
    return dr.Dataset.from_arrays(**columns, timeouts=np.arange(len(observations)) % 10 == 9, name="own")


@pytest.mark.parametrize(
    ("column", "odd"),
    [
        (NOISE, False), (9.0 * NOISE, False), (11.0 * NOISE, True), (20.0 + NOISE, True), (0.05 * NOISE, False),
        (0.01 * NOISE, True), (RARE, False), (0.05 * RARE, True), (np.zeros(ROWS), False), (np.full(ROWS, 0.01), False),
        (np.full(ROWS, -40.0), True),
    ],
)  # fmt: skip
def test_large_offsets_and_small_changes_are_unusual(column, odd):
    assert bool(unusual(Statistics.of(column))) is odd


@pytest.mark.parametrize(
    ("rewards", "scale"),
    [
        (NOISE, 1.0), (RARE, 1.0), (np.zeros(ROWS), 1.0), (500.0 * NOISE, 1e-3), (-200.0 + NOISE, 1e-2), (2e4 * NOISE, 1e-4),
        (0.002 * RARE, 1e3), (1e-5 * np.sign(NOISE), 1e5),
    ],
)  # fmt: skip
def test_rewards_are_brought_to_about_one_by_a_power_of_ten(rewards, scale):
    own = log(NOISE[:, None], rewards)
    assert reward_units(own) == (pytest.approx(scale, rel=1e-12), 0.0)
    assert bool(about_rewards(own.spec)) is (scale != 1.0)
    if scale != 1.0:
        assert np.abs(scale * rewards).max() > 0.1
        assert np.sqrt(np.mean((scale * rewards) ** 2)) < 10.0


def test_the_dimension_that_is_farthest_is_named():
    usual, one = log(np.stack([NOISE, RARE], 1)), log(np.stack([NOISE, 25.0 + NOISE], 1))
    assert about_observations(usual) == ""
    assert about_observations(one) == "observation 1 is 25 in size (root mean square)"
    more = log(np.stack([25.0 + NOISE, 0.0001 * np.sign(NOISE), NOISE], 1))
    assert about_observations(more) == "observation 1 is 0.0001 in size (root mean square), and 1 more is far from 1"


def test_pixels_are_as_they_are():
    pictures = log(np.full((20, 4, 4, 3), 200, np.uint8), np.zeros(20))
    assert usual_observations(pictures.spec)
    assert about_observations(pictures) == ""
