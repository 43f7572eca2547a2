"""The kitchen beside gymnasium-robotics, step by step, and what D4RL pays for."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon import tasks
from deadreckon.data.dataset import Dataset
from deadreckon.runs.diagnostics import logged_value
from deadreckon.tasks.kitchen import _FIRST, ELEMENTS, TASKS

COMPLETE = tasks.task("kitchen-complete")
SEEN = np.r_[0:9, 18:39]  # of gymnasium-robotics' 59 observations: positions without velocities


def test_observations_are_gymnasium_robotics():
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    # Its errors of the kitchen's joints stand one place off, so they are compared without.
    env = gymnasium.make("FrankaKitchen-v1", tasks_to_complete=list(COMPLETE.elements), robot_noise_ratio=0.1,
                         object_noise_ratio=0.0).unwrapped  # fmt: skip
    simulator = replace(COMPLETE, object_noise=0.0).simulate([7])
    rng = np.random.default_rng(0)
    np.testing.assert_allclose(simulator.reset()[0, :30], env.reset(seed=7)[0]["observation"][SEEN], atol=1e-6)
    for _ in range(25):
        action = rng.uniform(-1.3, 1.3, 9).astype(np.float32)
        theirs, reward, *_ = env.step(action)
        seen, rewards, *_ = simulator.step(action[None])
        np.testing.assert_allclose(seen[0, :30], theirs["observation"][SEEN], atol=1e-6)
        assert rewards[0] == reward == 0.0
    goal = np.zeros(30)
    for name, wanted in theirs["desired_goal"].items():
        goal[ELEMENTS[name][0]] = wanted
    np.testing.assert_allclose(seen[0, 30:], goal, atol=1e-6)
    env.close()


def test_each_subtask_pays_once_and_all_end_the_episode():
    simulator = COMPLETE.simulate([0, 1])
    simulator.reset()
    joints = 1 + np.arange(30)  # of MuJoCo's state, behind the time
    still = np.zeros((2, 9))
    assert simulator.step(still)[1].tolist() == [0.0, 0.0]
    earned = []
    for name in ("microwave", "kettle", "light switch", "slide cabinet"):
        where, wanted = ELEMENTS[name]
        simulator._state[0, joints[where]] = wanted
        _, rewards, terminals, _ = simulator.step(still)
        earned.append((rewards.tolist(), terminals.tolist()))
    assert [reward for reward, _ in earned] == [[1.0, 0.0]] * 4
    assert [terminal for _, terminal in earned] == [[False, False]] * 3 + [[True, False]]
    assert simulator.achieved.tolist() == [True, False]
    assert simulator.step(still)[1].tolist() == [0.0, 0.0]  # over


def test_what_counts_as_done():
    postures = np.tile(_FIRST, (3, 1))
    postures[1, 22], postures[2, 22] = -0.46, -0.44  # 0.29 and 0.31 from the microwave's goal
    np.testing.assert_array_equal(COMPLETE.done(postures, ["microwave"])[:, 0], [False, True, False])
    assert not COMPLETE.done(_FIRST[None]).any()


def test_the_errors_are_within_what_the_robot_admits():
    simulator = COMPLETE.simulate(range(30))
    away = simulator.reset()[:, :30] - _FIRST
    assert 0.009 < np.abs(away[:, :9]).max() <= 0.01 + 1e-6
    assert np.abs(away[:, 11:17]).max() <= 0.00005 + 1e-6
    exact = replace(COMPLETE, noise=0.0, object_noise=0.0).simulate([0]).reset()[0, :30]
    np.testing.assert_allclose(exact, _FIRST, atol=1e-6)


def test_an_episode_of_280_steps_times_out():
    task = replace(COMPLETE, horizon=3)
    simulator = task.simulate([0])
    simulator.reset()
    ends = [simulator.step(np.zeros((1, 9)))[2:] for _ in range(3)]
    assert [bool(timeouts[0]) for _, timeouts in ends] == [False, False, True]
    assert not any(terminals[0] for terminals, _ in ends)
    assert all(each.horizon == 280 for each in TASKS)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_gymnasiums_checks(task):
    env = gymnasium.make(task.gym_id).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about infinite bounds, which gymnasium-robotics' own have too
        check_env(env, skip_render_check=True)
    np.testing.assert_array_equal(env.reset(seed=3)[0], task.simulate([3]).reset()[0])
    assert env.step(env.action_space.sample())[4] == {"success": False}


class Drawn:
    """A renderer that notes the camera."""

    def update_scene(self, data, camera):
        self.camera = camera

    def render(self):
        return np.zeros((4, 4, 3), np.uint8)


def test_pictures_are_seen_from_inside_the_kitchen():
    simulator = tasks.task("kitchen-complete").simulate([0])
    simulator.reset()
    simulator.picture(0, (4, 4), drawn := Drawn())
    assert (drawn.camera.distance, drawn.camera.azimuth, drawn.camera.elevation) == (2.2, 70.0, -35.0)
    assert drawn.camera.lookat.tolist() == [-0.2, 0.5, 2.0]


def test_a_logs_episodes_are_worth_the_subtasks_that_are_done_in_them():
    """Whatever the log pays: here nothing, 7, and 1 for each of two rows."""
    postures = np.zeros((6, 60), np.float32)
    where, wanted = ELEMENTS["slide cabinet"]
    postures[:, 19] = 9.0  # far from done
    postures[[3, 4], where] = wanted
    postures[4, ELEMENTS["microwave"][0]] = ELEMENTS["microwave"][1]
    final = postures[[1, 2, 5]].copy()
    final[0, where] = wanted  # done with the last step
    log = Dataset.from_arrays(
        observations=postures, actions=np.zeros((6, 9)), rewards=[0, 0, 7, 1, 1, 1], terminals=[0, 1, 1, 0, 0, 1],
        final_observations=final, action_space=COMPLETE.action_space,
    )  # fmt: skip
    assert COMPLETE.logged_returns(log).tolist() == [1.0, 0.0, 2.0]
    assert logged_value(log, COMPLETE)["mean"] == pytest.approx(1.0)
    assert not COMPLETE.logs_pay_alike
    assert tasks.task("hopper").logs_pay_alike
