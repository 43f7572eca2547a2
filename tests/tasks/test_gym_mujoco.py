"""The Gym-MuJoCo suite step by step beside Gymnasium's environments, which it must equal to the last bit."""

from dataclasses import replace

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon import tasks
from deadreckon.errors import UserError
from deadreckon.tasks.gym_mujoco import TASKS

NAMES = [task.name for task in TASKS]
HOPPER = tasks.task("hopper")
SEEDS = (5, 2**63 + 11)  # 64 bits, as collections draw them
HORIZON = 90  # short, so that episodes of every body reach it


# v2 saw 84 contact forces, all zero, that cost nothing.
OPTIONS = {name: {"include_cfrc_ext_in_observation": False, "contact_cost_weight": 0.0} for name in ("ant", "humanoid")}


def twin(task, seed):
    """Gymnasium's own environment of a task, reset with `seed`, and its first observation in v2's layout."""
    name = task.gym_id.removeprefix("deadreckon/")
    env = gymnasium.make(name, max_episode_steps=task.horizon, **OPTIONS.get(task.name, {}))
    return env, seen(task, env.reset(seed=seed)[0])


def seen(task, observation):
    """An observation of v5 in v2's layout: zeros at the end, and the humanoid's world among its bodies, which are 13."""
    if task.name == "humanoid":
        moving, inertia, velocity, forces = np.split(observation, np.cumsum([45, 130, 78]))
        observation = np.concatenate([moving, np.zeros(10), inertia, np.zeros(6), velocity, np.zeros(6), forces])
    out = np.zeros(task.observation_shape, np.float32)
    out[: len(observation)] = observation
    return out


def wild(task, seed, steps, copies=1):
    """Actions over the whole range and beyond it, which the actuators clip and the cost does not."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (steps, copies, task.action_space.size)).astype(np.float32)


def test_the_tasks():
    shapes = {task.name: (*task.observation_shape, task.action_space.size) for task in TASKS}
    assert shapes == {"inverted-pendulum": (4, 1), "hopper": (11, 3), "halfcheetah": (17, 6), "walker2d": (17, 6),
                      "ant": (111, 8), "humanoid": (376, 17)}  # fmt: skip
    for task in TASKS:
        assert tasks.task(task.name) is task
        assert task.horizon == 1000
        # Scores stand beside D4RL's, where it has some.
        assert task.reference == task.published or task.name in ("humanoid", "inverted-pendulum")
        training = task.name in ("halfcheetah", "walker2d", "inverted-pendulum")  # thesis Table D.3, which has no pendulum
        assert task.split == ("training" if training else "evaluation")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_bit_is_gymnasiums(name):
    task = replace(tasks.task(name), horizon=HORIZON)
    simulator = task.simulate(SEEDS, threads=1)
    first = simulator.reset()
    assert first.dtype == np.float32
    assert first.shape == (2, *task.observation_shape)
    actions = wild(task, 0, 4 * HORIZON, 2)
    following, rewards, terminals, timeouts, moving = [], [], [], [], []
    for action in actions:
        o, r, terminal, timeout = simulator.step(action)
        following.append(o), rewards.append(r), terminals.append(terminal), timeouts.append(timeout)
        moving.append(simulator.state()["physics"])
        over = np.flatnonzero(terminal | timeout)
        if len(over):
            following.append(simulator.reset(over))
    following = iter(following)

    envs, starts = zip(*(twin(task, seed) for seed in SEEDS))
    np.testing.assert_array_equal(first, starts)
    for t, action in enumerate(actions):
        mine = next(following)
        steps = [env.step(a) for env, a in zip(envs, action)]
        np.testing.assert_array_equal(mine, [seen(task, step[0]) for step in steps])
        np.testing.assert_allclose(rewards[t], [step[1] for step in steps], rtol=1e-6, atol=1e-5)
        np.testing.assert_array_equal(terminals[t], [step[2] for step in steps])
        np.testing.assert_array_equal(timeouts[t], [step[3] and not step[2] for step in steps])
        for env, state in zip(envs, moving[t]):  # float64, so that no difference hides behind the rounding
            data = env.unwrapped.data
            np.testing.assert_array_equal(state[1 : 1 + len(data.qpos) + len(data.qvel)], [*data.qpos, *data.qvel])
        over = [env for env, step in zip(envs, steps) if step[2] or step[3]]
        if over:
            np.testing.assert_array_equal(next(following), [seen(task, env.reset()[0]) for env in over])
    # Both kinds of end were met, where there are both.
    assert np.any(terminals) == (name != "halfcheetah")
    assert np.any(timeouts) == (name in ("halfcheetah", "ant"))
    assert np.sum(np.array(terminals) | np.array(timeouts)) >= 8


def test_the_horizon_ends_an_episode_that_does_not_end_by_itself():
    task = replace(tasks.task("halfcheetah"), horizon=20)
    simulator = task.simulate([0, 1])
    for _ in range(2):
        simulator.reset()
        ends = [simulator.step(action)[2:] for action in wild(task, 0, 20, 2)]
        np.testing.assert_array_equal([e[1] for e in ends], np.arange(20)[:, None].repeat(2, 1) == 19)
        assert not np.any([e[0] for e in ends])


def test_a_fall_at_the_horizon_is_a_terminal():
    free = HOPPER.simulate([3])
    free.reset()
    actions = wild(HOPPER, 3, 100)
    fall = next(t for t, action in enumerate(actions) if free.step(action)[2][0])
    simulator = replace(HOPPER, horizon=fall + 1).simulate([3])
    simulator.reset()
    ends = [simulator.step(action)[2:] for action in actions[: fall + 1]]
    assert (ends[-1][0][0], ends[-1][1][0]) == (True, False)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_observations_and_health_of_any_state(name):
    """Speeds that clip, and both sides of every limit of health, put into both simulators."""
    task = tasks.task(name)
    env, _ = twin(task, 0)
    body = env.unwrapped
    size = 45 if name == "humanoid" else None  # what is behind comes from the physics step, not from the state
    rng = np.random.default_rng(0)
    nq, nv = len(body.data.qpos), len(body.data.qvel)
    states = np.concatenate([body.init_qpos + rng.normal(0, 0.5, (200, nq)), rng.normal(0, 20, (200, nv))], 1)
    for column, limits in {"inverted-pendulum": {1: (-0.2, 0.2)}, "hopper": {1: (0.7,), 2: (-0.2, 0.2), 5: (-100.0, 100.0)},
                           "walker2d": {1: (0.8, 2.0), 2: (-1.0, 1.0)},
                           "ant": {2: (0.2, 1.0)}, "humanoid": {2: (1.0, 2.0)}}.get(name, {}).items():  # fmt: skip
        for limit in limits:
            near = np.tile(np.concatenate([body.init_qpos, np.zeros(nv)]), (3, 1))
            near[:, column] = [np.nextafter(limit, -np.inf), limit, np.nextafter(limit, np.inf)]
            states = np.concatenate([states, near])

    simulator = task.simulate(range(len(states)))
    simulator.reset()
    state = simulator.state()
    state["physics"][:, 1 : 1 + nq + nv] = states
    state["alive"][:] = False  # resting copies show their state as it is
    simulator.restore(state)
    mine = simulator.step(np.zeros((len(states), task.action_space.size)))[0]
    healthy = None if task.healthy is None else task.healthy(states)
    for i, each in enumerate(states):
        body.data.qpos[:], body.data.qvel[:] = each[:nq], each[nq:]
        np.testing.assert_array_equal(mine[i][:size], seen(task, body._get_obs())[:size])
        if healthy is not None:
            # Gymnasium's pendulum has the test in its step alone.
            wanted = body.is_healthy if hasattr(body, "is_healthy") else abs(each[1]) <= 0.2
            assert healthy[i] == wanted, each
    # From observations alone, which are rounded: not at the limits themselves.
    for array in (mine[:200], jnp.asarray(mine[:200])):
        wanted = np.zeros(200, bool) if healthy is None else ~healthy[:200]
        np.testing.assert_array_equal(task.ends(array), wanted)
    if healthy is not None:
        assert healthy.any()
        assert not healthy.all()


@pytest.mark.parametrize("name", ["hopper", "humanoid"])
def test_a_copy_whose_episode_is_over_rests_until_its_reset(name):
    task = replace(tasks.task(name), horizon=60)
    simulator = task.simulate(range(8))
    last = simulator.reset()
    actions, over, halfway, after = wild(task, 2, 59, 8), np.zeros(8, bool), None, []
    for action in actions:
        action[over] = np.nan  # nobody looks at a resting copy's action
        observations, rewards, terminals, timeouts = simulator.step(action)
        after.append((observations, rewards, terminals, timeouts))
        assert not rewards[over].any()
        assert not (terminals | timeouts)[over].any()
        np.testing.assert_array_equal(observations[over], last[over])
        assert (rewards[~over] != 0).all()
        over |= terminals | timeouts
        last = observations
        if halfway is None and over.sum() > 1:
            assert not over.all()
            halfway, after = simulator.state(), []
    assert over.all()

    restored = task.simulate(range(8))
    restored.reset()
    restored.restore(halfway)  # those that rested when the state was taken rest again
    for action, expected in zip(actions[-len(after) :], after):
        for ours, theirs in zip(restored.step(action), expected):
            np.testing.assert_array_equal(ours, theirs)
    simulator.reset(np.array([6]))
    rewards = simulator.step(np.nan_to_num(actions[0]))[1]
    np.testing.assert_array_equal(rewards != 0, np.arange(8) == 6)


def test_bad_input_is_told():
    simulator = HOPPER.simulate([0, 1, 2])
    simulator.reset()
    before = simulator.state()
    with pytest.raises(UserError, match=r"hopper: actions have shape \(3,\), \(3, 3\) is needed"):
        simulator.step(np.zeros(3))
    with pytest.raises(UserError, match=r"the action of copy 1 is \[0.0, nan, 0.0\]"):
        simulator.step(np.array([[0, 0, 0], [0, np.nan, 0], [0, 0, np.inf]]))
    after = simulator.state()
    assert all(np.array_equal(before[key], after[key]) for key in before)
    for seeds in ([], [0, -1]):
        with pytest.raises(UserError, match="one seed per copy is needed, each 0 or more"):
            HOPPER.simulate(seeds)
    with pytest.raises(UserError, match=r"got \[7\] for 2 copies"):
        simulator.reset(np.array([0, 2]), [7])
    with pytest.raises(UserError, match="hopper: threads must be 1 or more, got 0"):
        HOPPER.simulate([0], threads=0)
