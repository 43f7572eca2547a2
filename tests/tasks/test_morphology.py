"""Robots of a design: what is built, what is earned, by hand; nothing random but the design."""

import dataclasses

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.tasks.gym_mujoco import load_model
from deadreckon.tasks.morphology import ANT, KITTY, LEGS

BOTH = pytest.mark.parametrize("task", [ANT, KITTY], ids=lambda t: t.name)


def legs(task, **changes):
    """The default design with some of every leg's numbers changed."""
    design = task.usual.reshape(LEGS, -1).copy()
    for name, value in changes.items():
        design[:, task.numbers.index(name)] = value
    return design.ravel()


def run(task, designs, actions):
    """(copies,) returns of an action sequence, and the simulator."""
    simulator = task.simulate([0] * len(designs), 1, designs)
    simulator.reset()
    total = np.zeros(len(designs))
    for action in actions:
        total += simulator.step(np.tile(action, (len(designs), 1)))[1]
    return total, simulator


@BOTH
def test_default_is_within_bounds_and_seen(task):
    low, high = task.bounds
    assert ((low <= task.usual) & (task.usual <= high)).all()
    simulator = task.simulate([3], 1, task.usual[None])
    seen = simulator.reset()
    assert seen.shape == (1, *task.observation_shape)
    np.testing.assert_allclose(seen[0, -len(low) :], task.unit(task.usual), rtol=1e-6)
    assert np.abs(seen[0, -len(low) :]).max() <= 1


def test_ant_weighs_what_gymnasiums_weighs_where_the_legs_are_the_same():
    import mujoco

    ours, theirs = ANT.build(ANT.usual), load_model("ant.xml")
    # Torso, thigh and ankle are Gymnasium's, which has the hip's capsule in a body of its own, too.
    np.testing.assert_allclose(ours.body_mass.sum(), theirs.body_mass.sum(), rtol=1e-6)
    np.testing.assert_allclose(np.unique(ours.body_mass.round(8)), np.unique(theirs.body_mass.round(8)))
    data = mujoco.MjData(ours)
    mujoco.mj_kinematics(ours, data)
    reach = data.xpos[2 + 2 :: 3, :2]  # ankles: hip and thigh of 0.2 each along the diagonal
    np.testing.assert_allclose(np.abs(reach), 0.4, atol=1e-9)


@BOTH
def test_sizes_and_ranges_are_those_of_the_design(task):
    model = task.build(legs(task, thigh_size=0.11, ankle_range=task.low[task.numbers.index("ankle_range")]))
    half = np.ptp(model.jnt_range[1:], axis=1).reshape(LEGS, 3)[:, 2] / 2
    np.testing.assert_allclose(half, np.deg2rad(5) if task is ANT else np.pi / 35, rtol=1e-6)
    where = model.body_pos[2:].reshape(LEGS, 3, 3)  # a leg's three bodies, each from the one before
    np.testing.assert_allclose(np.abs(where[:, 2 if task is ANT else 1]).max(-1), 0.11, rtol=1e-6)


@BOTH
def test_nothing_begins_below_the_floor(task):
    import mujoco

    rng = np.random.default_rng(0)
    low, high = task.bounds
    for _ in range(5):
        simulator = task.simulate([0], 1, rng.uniform(low, high)[None])
        simulator.reset()
        model, data = simulator._models[0], simulator._data[0]
        for geom in range(1, model.ngeom):
            assert mujoco.mj_geomDistance(model, data, 0, geom, 10.0, None) > -1e-6


def test_an_ant_that_rests_earns_one_a_step():
    total, simulator = run(ANT, ANT.usual[None], np.zeros((ANT.horizon, 12)))
    contact = 100 - total[0]
    assert 0 < contact < 4  # it stands still, and what touches the floor costs a little
    assert not simulator._alive.any()  # the horizon


def test_an_ants_actions_cost():
    still, pushed = (run(ANT, ANT.usual[None], np.full((1, 12), a))[0][0] for a in (0.0, 0.5))
    assert pushed < still - 0.5 * 12 * 0.25 + 0.5  # what is left is the speed along x, which the symmetric push has little of


def test_a_kittys_reward_by_hand():
    rest = np.zeros((1, 12))
    _, simulator = run(KITTY, KITTY.usual[None], rest)
    upright, heading, way = KITTY._stance(simulator._data[0])
    distance = np.hypot(*way)
    assert upright > 0.99
    assert heading > 0.99
    assert distance == pytest.approx(2.0, abs=0.05)
    by_hand = (upright - 0.9) / 0.1 - 4 * distance + 2 * (heading - 0.9) / 0.1 + 5
    assert run(KITTY, KITTY.usual[None], rest)[0][0] == pytest.approx(by_hand, rel=1e-5)


def test_a_kitty_that_falls_pays_and_ends():
    simulator = KITTY.simulate([0], 1, legs(KITTY, y=0.122)[None])  # all legs at the front
    simulator.reset()
    for _ in range(KITTY.horizon):
        _, reward, terminal, _ = simulator.step(np.zeros((1, 12)))
        if terminal[0]:
            break
    assert terminal[0]
    assert reward[0] < -490
    assert simulator.step(np.ones((1, 12)))[1][0] == 0  # it rests until its reset


@BOTH
def test_copies_do_not_depend_on_each_other_or_on_threads(task):
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (5, 12))
    designs = np.stack([task.usual, legs(task, thigh_size=0.12), task.usual])
    together, _ = run(task, designs, actions)
    alone = [run(task, design[None], actions)[0][0] for design in designs]
    np.testing.assert_array_equal(together, alone)
    simulator = task.simulate([0] * 3, 3, designs)
    simulator.reset()
    total = sum(simulator.step(np.tile(action, (3, 1)))[1] for action in actions)
    np.testing.assert_allclose(total, together, rtol=1e-6)


@BOTH
def test_training_designs_are_drawn_from_the_seed(task):
    first, second = (task.simulate([5, 6], 1) for _ in range(2))
    first.reset(), second.reset()
    np.testing.assert_array_equal(first.designs, second.designs)
    assert not np.array_equal(first.designs[0], first.designs[1])
    before = first.designs[0].copy()
    first.reset(np.array([0]))
    assert not np.array_equal(first.designs[0], before)


@BOTH
def test_goes_on_from_a_state(task):
    rng = np.random.default_rng(1)
    actions = rng.uniform(-0.5, 0.5, (6, 2, 12))
    whole = task.simulate([1, 2], 1)
    whole.reset()
    for action in actions[:3]:
        whole.step(action)
    kept = whole.state()
    after = [whole.step(action) for action in actions[3:]]
    fresh = task.simulate([8, 9], 1)
    fresh.restore(kept)
    for action, wanted in zip(actions[3:], after):
        for got, one in zip(fresh.step(action), wanted):
            np.testing.assert_array_equal(got, one)
    whole.reset(), fresh.reset()  # the next designs, too
    np.testing.assert_array_equal(fresh.designs, whole.designs)


@BOTH
def test_goes_on_from_a_state_before_the_first_reset(task):
    state, other = task.simulate([5]).state(), task.simulate([6])
    np.testing.assert_array_equal(state["designs"], [task.usual])
    other.restore(state)
    np.testing.assert_array_equal(other.reset(), task.simulate([5]).reset())


@BOTH
def test_returns_have_no_scale_where_no_reference_is_known(task):
    assert task.scores(np.array([530.0])) is None


def test_refuses_designs_of_another_shape():
    with pytest.raises(UserError, match=r"ant-morphology: designs must have shape \(1, 60\)"):
        ANT.simulate([0], 1, np.zeros((1, 56)))


def test_nothing_else_is_random():
    still = dataclasses.replace(KITTY, spread=0.0)
    seen = still.simulate([0, 1], 1).reset()
    np.testing.assert_array_equal(seen[0], seen[1])
