"""The Gym-MuJoCo tasks as Gymnasium environments; those of Maze2D are tested beside their simulator."""

import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon import tasks
from deadreckon.tasks.gym_mujoco import TASKS

OURS = [task for task in TASKS if task.gym_id.startswith("deadreckon/")]
ours = pytest.mark.parametrize("task", OURS, ids=lambda task: task.name)


def test_every_task_has_its_environment():
    assert [task.name for task in OURS] == ["ant", "humanoid"]
    for task in TASKS:
        assert gymnasium.spec(task.gym_id).max_episode_steps == task.horizon
        env = gymnasium.make(task.gym_id)
        assert env.observation_space.shape == task.observation_shape
        np.testing.assert_allclose(env.action_space.low, task.action_space.low)
        np.testing.assert_allclose(env.action_space.high, task.action_space.high)
        env.close()


def walk(task, scale, steps, seed=7):
    """Steps environment and simulator side by side over all their episodes; gives how these ended."""
    env, simulator = gymnasium.make(task.gym_id), task.simulate([seed])
    rng = np.random.default_rng(0)
    bounds = np.array(task.action_space.high)
    np.testing.assert_array_equal(env.reset(seed=seed)[0], simulator.reset()[0])
    ends = []
    for _ in range(steps):
        action = (scale * rng.uniform(-bounds, bounds)).astype(np.float32)
        seen, reward, terminated, truncated, _ = env.step(action)
        following, rewards, terminals, timeouts = simulator.step(action[None])
        assert seen.dtype == following.dtype
        np.testing.assert_array_equal(seen, following[0])
        # The simulator sums the humanoid's masses in another order.
        np.testing.assert_allclose(reward, rewards[0], rtol=0 if task.name == "ant" else 1e-6)
        assert (terminated, truncated) == (terminals[0], timeouts[0])
        assert not seen[-task.padding :].any()
        if terminated or truncated:
            ends.append("fall" if terminated else "timeout")
            np.testing.assert_array_equal(env.reset()[0], simulator.reset()[0])
    return ends


@pytest.mark.slow
@ours
def test_equal_to_the_simulator_over_falls(task):
    assert walk(task, 1.5, 200).count("fall") >= 2  # with actions beyond the bounds too


@pytest.mark.slow
def test_ant_equals_the_simulator_up_to_the_time_limit():
    assert walk(tasks.task("ant"), 0.3, 1010) == ["timeout"]


@ours
def test_gymnasiums_checks(task):
    env = gymnasium.make(task.gym_id).unwrapped
    with warnings.catch_warnings():
        # The checker would have us pass through `gymnasium.make`; Gymnasium's own robots have infinite bounds too.
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)


@ours
def test_pickled_it_keeps_its_options(task):
    env = gymnasium.make(task.gym_id, reset_noise_scale=0.0).unwrapped
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(again.reset(seed=0)[0], again.reset(seed=1)[0])
    np.testing.assert_array_equal(again.reset(seed=0)[0], env.reset(seed=0)[0])


@pytest.mark.slow
def test_gymnasium_finds_the_ids_through_the_module_that_registers_them():
    code = "import gymnasium; gymnasium.make('deadreckon.tasks.envs:deadreckon/Ant-v5')"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
