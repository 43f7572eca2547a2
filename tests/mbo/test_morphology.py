"""The two robots as problems: a gait by hand, and stored scores that the judge gives again."""

import numpy as np
import pytest

from deadreckon.mbo import problem
from deadreckon.mbo.problems.morphology import Gait, designs_of, gait_of, returns, stored
from deadreckon.tasks.morphology import ANT, KITTY

NAMES = {"ant-morphology": (ANT, 60), "dkitty-morphology": (KITTY, 56)}


def gait(middle=0.0, swing=0.0, phase=0.0, frequency=1.0, stiffness=1.0):
    swings = [np.full(12, number) for number in (middle, swing, phase)]
    return Gait.of(np.concatenate([*swings, np.log([frequency, stiffness])]))


def test_a_gait_swings():
    seen = np.zeros((1, KITTY.observation_shape[0]))
    made = gait(middle=0.2, swing=0.5, phase=0.5, frequency=2.0)
    x = KITTY.usual[None]
    np.testing.assert_allclose(made.actions(KITTY, x, seen, 0.0), np.full((1, 12), 0.7))  # half a turn of pi: the crest
    np.testing.assert_allclose(made.actions(KITTY, x, seen, 0.25), np.full((1, 12), -0.3), atol=1e-12)
    assert gait(swing=9.0, phase=0.5).actions(KITTY, x, seen, 0.0).max() == 1.0


def test_an_ant_follows_through_springs():
    seen = np.zeros((1, ANT.observation_shape[0]))
    seen[0, 5:17], seen[0, 23:35] = 0.1, 0.5
    hip, thigh, ankle = gait(middle=1.0, stiffness=0.8).actions(ANT, ANT.usual[None], seen, 0.0)[0, :3]
    # Upper ends of the default ranges: 5, 30 and 70 degrees.
    for torque, degrees in ((hip, 5), (thigh, 30), (ankle, 70)):
        assert torque == pytest.approx(0.8 * (np.deg2rad(degrees) - 0.1 - 0.1 * 0.5))


@pytest.mark.parametrize("name", NAMES)
def test_scores_that_are_stored_are_the_judges(name):
    task, size = NAMES[name]
    made = problem(name)
    assert made.visible.x.shape == (round(0.4 * 25_009), size)
    with np.load(stored(task)) as file:
        worst_first = np.sort(file["scores"])
    np.testing.assert_array_equal(np.sort(made.visible.y), worst_first[: len(made.visible)])
    assert made.high == worst_first[-1]
    rows = np.random.default_rng(0).choice(len(made.visible), 12, replace=False)
    found = made.oracle(made.visible.x[rows])
    # To the last digits with the MuJoCo that measured them; another build may part from it after some steps.
    assert np.median(np.abs(found - made.visible.y[rows])) < 0.02 * (made.high - made.low)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_default_body_moves(name):
    task, _ = NAMES[name]
    moving = returns(task, task.usual[None], gait_of(task))[0]
    resting = returns(task, task.usual[None], gait())[0]
    assert moving > resting + 30


@pytest.mark.slow
def test_one_gait_each_and_designs_of_whole_steps():
    low, high = KITTY.bounds
    x = designs_of(KITTY, np.array([[0] * 56, [255] * 56]))
    np.testing.assert_allclose(x, np.stack([low, high]).astype(np.float32))
    two = Gait(*(np.concatenate(pair) for pair in zip(gait(), gait(middle=0.1))))
    usual = np.stack([KITTY.usual] * 2)
    together = returns(KITTY, usual, two, threads=1)
    assert together[0] == returns(KITTY, usual[:1], gait())[0]
    assert together[0] != together[1]
