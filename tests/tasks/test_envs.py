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

ANT = tasks.task("ant")


def test_every_task_has_its_environment():
    for task in TASKS:
        spec = gymnasium.spec(task.gym_id)
        assert spec.max_episode_steps == task.horizon
        env = gymnasium.make(task.gym_id)
        assert env.observation_space.shape == task.observation_shape
        np.testing.assert_array_equal(env.action_space.low, task.action_space.low)
        np.testing.assert_array_equal(env.action_space.high, task.action_space.high)
        env.close()


@pytest.mark.parametrize("scale", [0.3, 1.5])
def test_ant_equals_the_simulator_to_the_bit(scale):
    """Small actions to the time limit, large ones (beyond the bounds too) over several falls."""
    env, simulator = gymnasium.make(ANT.gym_id), ANT.simulate([5])
    rng = np.random.default_rng(0)
    seen, first = env.reset(seed=5)[0], simulator.reset()
    np.testing.assert_array_equal(seen, first[0])
    ends = []
    for _ in range(1500):
        action = rng.uniform(-scale, scale, ANT.action_space.size).astype(np.float32)
        seen, reward, terminated, truncated, _ = env.step(action)
        following, rewards, terminals, timeouts = simulator.step(action[None])
        assert seen.dtype == following.dtype
        np.testing.assert_array_equal(seen, following[0])
        assert reward == rewards[0]
        assert (terminated, truncated) == (terminals[0], timeouts[0])
        assert not seen[27:].any()
        if terminated or truncated:
            ends.append((terminated, truncated))
            np.testing.assert_array_equal(env.reset()[0], simulator.reset()[0])
    assert (False, True) in ends if scale < 1 else (True, False) in ends


def test_ant_passes_gymnasiums_checks():
    env = gymnasium.make(ANT.gym_id).unwrapped
    with warnings.catch_warnings():
        # The checker would have us pass through `gymnasium.make`, and Gymnasium's own Ant has infinite bounds too.
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)


def test_ant_survives_pickling_and_keeps_its_options():
    env = gymnasium.make(ANT.gym_id, reset_noise_scale=0.0).unwrapped
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(again.reset(seed=0)[0], again.reset(seed=1)[0])
    np.testing.assert_array_equal(again.reset(seed=0)[0], env.reset(seed=0)[0])


def test_gymnasium_finds_the_ant_through_the_module_that_registers_it():
    code = "import gymnasium; gymnasium.make('deadreckon.tasks.envs:deadreckon/Ant-v5')"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
