"""Adroit beside gymnasium-robotics, step by step, and the rewards and ends that D4RL gives it."""

import pickle
import warnings

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon import tasks
from deadreckon.data.formats.pickles import read_pickle
from deadreckon.policies import load_dapg
from deadreckon.policies.deployed import first_actions
from deadreckon.tasks.adroit import TASKS, _angles
from deadreckon.unpickle import load_pickle

every = pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
# From where to where gymnasium-robotics 1.4 pays for distance where D4RL charges for it, in `Scene`.
PALM_TO = {"hammer": lambda scene: scene.thing, "door": lambda scene: scene.sites[:, 1], "relocate": lambda scene: scene.thing}


@pytest.fixture(scope="module")
def theirs():
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    made = {task.name: gymnasium.make(f"AdroitHand{task.name.title()}-v1").unwrapped for task in TASKS}
    yield made
    for env in made.values():
        env.close()


@pytest.mark.slow
@every
def test_observations_are_gymnasium_robotics_and_rewards_d4rls(task, theirs):
    env, simulator = theirs[task.name], task.simulate([7])
    rng = np.random.default_rng(0)
    np.testing.assert_allclose(simulator.reset()[0], env.reset(seed=7)[0], atol=1e-6)
    ended = 0
    for _ in range(130):
        action = rng.uniform(-1.3, 1.3, task.action_space.size).astype(np.float32)  # beyond the bounds, too
        seen, reward, _, _, info = env.step(action)
        following, rewards, terminals, timeouts = simulator.step(action[None])
        np.testing.assert_allclose(following[0], seen, atol=1e-6)
        assert simulator.achieved[0] == info["success"]
        if task.name in PALM_TO:
            scene = simulator._scene(slice(None))
            reward -= 0.2 * np.linalg.norm(scene.sites[:, 0] - PALM_TO[task.name](scene))
        np.testing.assert_allclose(rewards[0], reward, atol=2e-5, rtol=1e-5)
        if terminals[0] or timeouts[0]:
            ended += 1
            np.testing.assert_allclose(simulator.reset()[0], env.reset()[0], atol=1e-6)
    assert ended > 1 if task.name == "pen" else ended == 0  # it is dropped


@pytest.mark.slow
def test_a_dropped_pen_ends_the_episode():
    task = tasks.task("pen")
    simulator = task.simulate(range(4))
    simulator.reset()
    for _ in range(task.horizon):
        seen, rewards, terminals, timeouts = simulator.step(np.ones((4, 24)))
        going = simulator._alive | terminals | timeouts
        np.testing.assert_array_equal(terminals[going], seen[going, 26] < 0.075)
        assert (rewards[terminals] < -3).all()
        if not simulator._alive.any():
            break
    assert not simulator._alive.any()


def test_the_demonstrations_rewards_are_ours(real_data):
    """The last word on the sign of the reach term: rewards that people's door demonstrations carry, from what is observed."""
    log = read_pickle(real_data / "adroit" / "door-v0_demos.pickle")
    seen, inside = log.next_observations, log.usable
    reach, hinge = np.linalg.norm(seen[:, 35:38], axis=1), seen[:, 28]
    others = -0.1 * (hinge - 1.57) ** 2 + 2.0 * (hinge > 0.2) + 8.0 * (hinge > 1.0) + 10.0 * (hinge > 1.35)
    left = (log.rewards - others)[inside]
    # What is left over is the cost of velocities, 1e-5 times their squares, which are not observed.
    assert 0 < np.mean(-0.1 * reach[inside] - left) < 0.001
    assert np.mean(0.1 * reach[inside] - left) > 0.01


def test_a_demonstration_can_be_begun_where_it_began(real_data, theirs):
    state = load_pickle(real_data / "adroit" / "door-v0_demos.pickle")[3]["init_state_dict"]
    simulator = tasks.task("door").simulate([0])
    simulator._start(range(1), np.concatenate([state[key] for key in ("door_body_pos", "qpos", "qvel")])[None])
    env = theirs["door"]
    env.reset(options={"initial_state_dict": state})
    for _ in range(20):
        following, *_ = env.step(np.full(28, 0.5, np.float32))
        seen, *_ = simulator.step(np.full((1, 28), 0.5))
    np.testing.assert_allclose(seen[0], following, atol=1e-6)


@pytest.mark.parametrize("task", [pytest.param(task, marks=[] if task.name == "door" else pytest.mark.slow) for task in TASKS],
                         ids=lambda task: task.name)  # fmt: skip
def test_dapgs_policies_succeed_here(task, real_data):
    """Order of observations, scale of actions and physics at once: the experts of the old simulator are experts in this one."""
    policy = load_dapg(real_data / "adroit" / f"{task.name}-v0_dapg_policy.pickle")
    simulator = task.simulate(range(8 if task.name == "door" else 40))
    seen, reached, alive = simulator.reset(), 0, True
    for _ in range(task.horizon):
        actions = np.asarray(first_actions(policy, seen, jax.random.key(0), True))
        seen, _, terminals, timeouts = simulator.step(actions)
        reached, alive = reached + (simulator.achieved & alive), alive & ~(terminals | timeouts)
    # Of 1,000 episodes with drawn actions, 0.72 .. 0.97 succeed (docs/tasks/adroit.md); means do better.
    assert (reached > task.enough).mean() >= (0.5 if task.name == "pen" else 0.9)


@every
def test_gymnasiums_checks(task):
    env = gymnasium.make(task.gym_id).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about infinite bounds, which gymnasium-robotics' own have too
        check_env(env, skip_render_check=True)
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(again.reset(seed=3)[0], task.simulate([3]).reset()[0])
    env.reset(seed=3)
    np.testing.assert_array_equal(again.reset()[0], env.reset()[0])  # the second episode of the seed


def test_euler_angles_undo_the_rotations_they_name():
    x, y, z = np.random.default_rng(0).uniform(-1.4, 1.4, (3, 20))
    one, none = np.ones(20), np.zeros(20)

    def turn(rows):
        return np.moveaxis(np.array(rows), 2, 0)

    about_x = turn([[one, none, none], [none, np.cos(x), -np.sin(x)], [none, np.sin(x), np.cos(x)]])
    about_y = turn([[np.cos(y), none, np.sin(y)], [none, one, none], [-np.sin(y), none, np.cos(y)]])
    about_z = turn([[np.cos(z), -np.sin(z), none], [np.sin(z), np.cos(z), none], [none, none, one]])
    np.testing.assert_allclose(_angles(about_x @ about_y @ about_z), np.column_stack([x, y, z]), atol=1e-12)
    up = turn([[none, none, one], [np.sin(x), np.cos(x), none], [-np.cos(x), np.sin(x), none]])  # y = 90°: x counts as 0
    np.testing.assert_allclose(_angles(up), np.column_stack([none, none + np.pi / 2, x]), atol=1e-7)


def test_splits_and_references_are_the_benchmarks():
    split = {task.name: task.split for task in TASKS}
    assert split == {"pen": "training", "door": "training", "hammer": "evaluation", "relocate": "evaluation"}  # Table D.3
    assert {task.name: task.horizon for task in TASKS} == {"pen": 100, "hammer": 200, "door": 200, "relocate": 200}
    assert tasks.task("door").reference.normalise(2880.5693087298737) == pytest.approx(100.0)
    assert all("sparse rewards" in task.properties for task in TASKS)
