import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon import tasks
from deadreckon.errors import UserError
from deadreckon.tasks.maze2d import LAYOUTS, RADIUS, TASKS, Maze2D, model
from deadreckon.tasks.task import Task

UMAZE = tasks.task("maze2d-umaze")
NAMES = [task.name for task in TASKS]


def forces(seed: int, *shape: int) -> np.ndarray:
    """Forces beyond the limits too, held for a while so that the ball gets fast."""
    return np.random.default_rng(seed).uniform(-1.5, 1.5, shape).repeat(20, 0).astype(np.float32)


def test_the_twelve_tasks():
    assert [f"maze2d-{maze}{dense}" for dense in ("", "-dense") for maze in LAYOUTS] == NAMES
    for name in NAMES:
        task = tasks.task(name)
        assert isinstance(task, Maze2D)
        assert task.horizon == {"umaze": 300, "medium": 600, "large": 800}[next(s for s in LAYOUTS if s in name)]
        assert task.split == ("evaluation" if "eval" in name else "training")
        assert 0 < task.reference.random < task.reference.expert <= task.horizon
        assert (task.published is None) == (name == "maze2d-eval-large-dense")
        assert task.grid[tuple(task.goal.astype(int))]
        assert {task: 1}[task] == 1
    np.testing.assert_array_equal(UMAZE.goal, [1, 1])
    np.testing.assert_array_equal(tasks.task("maze2d-medium").goal, [6, 6])
    np.testing.assert_array_equal(tasks.task("maze2d-large").goal, [7, 9])


def test_evaluation_mazes_have_the_references_of_d4rls_registry():
    found = {
        name: tasks.task(f"maze2d-eval-{name}").published
        for name in ("umaze", "medium", "large", "umaze-dense", "medium-dense")
    }
    assert {name: (each.random, each.expert) for name, each in found.items()} == {
        "umaze": (36.63, 141.4), "medium": (13.07, 204.93), "large": (16.4, 302.22),
        "umaze-dense": (56.95455, 178.21373133248397), "medium-dense": (42.28578, 235.5658957482388),
    }  # fmt: skip


def test_unknown_task_has_a_hint_and_names_are_unique():
    with pytest.raises(UserError, match="unknown task 'maze2d-umase': did you mean maze2d-umaze"):
        tasks.task("maze2d-umase")
    with pytest.raises(UserError, match="registered already"):
        tasks.register(UMAZE)


def test_bad_input_is_told():
    with pytest.raises(UserError, match="closed by"):
        Maze2D("leaky", "maze2d", 1, (4,), UMAZE.action_space, "x", UMAZE.reference, layout="###/#GO/###")
    with pytest.raises(UserError, match="one seed per copy"):
        UMAZE.simulate([])
    with pytest.raises(UserError, match="threads"):
        UMAZE.simulate([0], threads=0)
    simulator = UMAZE.simulate([0, 1])
    simulator.reset()
    with pytest.raises(UserError, match=r"shape \(2,\)"):
        simulator.step(np.zeros(2))
    with pytest.raises(UserError, match="copy 1"):
        simulator.step(np.array([[0, 0], [np.nan, 0]]))


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_checks(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The checker would have us pass through `gymnasium.make`, which is the next test's.
        env = gymnasium.make(tasks.task(name).gym_id, render_mode="rgb_array").unwrapped
        check_env(env)
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (*(24 * np.array(env.task.grid.shape)), 3)
    assert picture.dtype == np.uint8


def test_made_by_gymnasium_the_horizon_is_kept():
    env = gymnasium.make("deadreckon/Maze2D-UMaze-v1")
    observation, _ = env.reset(seed=3)
    assert observation.dtype == np.float32
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(300)]
    assert not any(terminated for terminated, _ in ends)
    assert [truncated for _, truncated in ends] == [False] * 299 + [True]


@pytest.mark.parametrize("name", ["maze2d-umaze-dense", "maze2d-eval-large"])
def test_copies_threads_and_gymnasium_agree_to_the_bit(name):
    task = tasks.task(name)
    seeds, steps = list(range(40)), forces(0, 15, 40, 2)
    logs = []
    for threads in (1, 3):
        simulator = task.simulate(seeds, threads=threads)
        logs.append([simulator.reset(), *(simulator.step(action) for action in steps)])
    for one, other in zip(logs[0], logs[1]):
        for a, b in zip(one, other):
            np.testing.assert_array_equal(a, b)

    few = task.simulate(seeds[7:9])
    np.testing.assert_array_equal(few.reset(), logs[0][0][7:9])
    env = gymnasium.make(task.gym_id)
    np.testing.assert_array_equal(env.reset(seed=7)[0], logs[0][0][7])
    for action, (observations, rewards, _, _) in zip(steps, logs[0][1:]):
        np.testing.assert_array_equal(few.step(action[7:9])[0], observations[7:9])
        observation, reward, *_ = env.step(action[7])
        np.testing.assert_array_equal(observation, observations[7])
        assert reward == rewards[7]
    # The second episode goes on with each copy's own generator.
    np.testing.assert_array_equal(few.reset()[0], env.reset()[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["maze2d-umaze", "maze2d-eval-medium", "maze2d-large"])
def test_the_ball_stays_in_the_maze(name):
    task = tasks.task(name)
    simulator = task.simulate(range(64))
    simulator.reset()
    visited = np.zeros(len(task.cells), bool)
    walls = task.walls()
    for action in forces(1, 100, 64, 2):
        seen = simulator.advance(action)
        cells = task.cell_of(seen[:, :2])
        visited[cells] = True
        assert (cells >= 0).all()
        # The distance of the ball to the nearest wall: contacts are soft, so it may sink in a little.
        middle, half = (walls[:, :2] + walls[:, 2:]) / 2, 0.5
        gap = np.maximum(np.abs(seen[:, None, :2] - middle) - half, 0)
        assert np.sqrt(np.square(gap).sum(-1)).min() > RADIUS - 0.09
        # Beyond the clip by what one step's force adds, and more where a soft wall throws the ball back.
        assert np.abs(seen[:, 2:]).max() < 8
    assert visited.mean() > 0.8


def set_moving(simulator, moving):
    """Begins episodes in (copies, 4) positions and velocities."""
    state = simulator.state()
    state["physics"][:], state["age"][:] = np.concatenate([np.zeros((len(moving), 1)), moving], 1), 0
    simulator.restore(state)


def test_free_motion_follows_the_equation():
    """m v' = 100 a - v, integrated with the damping taken implicitly; velocities are clipped before the step."""
    mass = 1000 * 4 / 3 * np.pi * RADIUS**3
    assert model(UMAZE.layout).body_mass[1] == pytest.approx(mass)
    simulator = UMAZE.simulate([0])
    set_moving(simulator, np.array([[2.8, 2.0, 7.0, 0.5]]))
    observations = simulator.step(np.array([[-0.3, 9.0]]))[0][0]
    velocity = (np.array([5.0, 0.5]) + 0.01 * np.array([-30.0, 100.0]) / mass) / (1 + 0.01 / mass)
    np.testing.assert_allclose(observations[2:], velocity, rtol=1e-6)
    np.testing.assert_allclose(observations[:2], np.array([2.8, 2.0]) + 0.01 * velocity, rtol=1e-6)


def test_walls_stand_where_the_physics_has_them():
    simulator = UMAZE.simulate([0])
    set_moving(simulator, np.array([[1.0, 1.0, 0.0, 0.0]]))
    for _ in range(200):
        seen = simulator.advance(np.array([[-1.0, -1.0]], np.float32))
    # Pressed into the corner of cell (1, 1), whose free space starts at 0.3: the ball's middle is a radius further.
    np.testing.assert_allclose(seen[0, :2], 0.3 + RADIUS, atol=0.01)
    walls = UMAZE.walls()
    assert walls.shape == (25 - 7, 4)
    np.testing.assert_allclose(walls[0], [-0.7, -0.7, 0.3, 0.3])


def test_starts():
    for name in ("maze2d-umaze", "maze2d-large"):
        task = tasks.task(name)
        starts = task.simulate(range(5_000)).reset()
        cells = np.rint(starts[:, :2]).astype(int)
        assert np.abs(starts[:, :2] - cells).max() <= 0.1 + 1e-6
        found, counts = np.unique(cells, axis=0, return_counts=True)
        np.testing.assert_array_equal(found, task.cells)  # the goal's cell is one of them
        expected = 5_000 / len(task.cells)
        # Chi-squared: mean n - 1, variance 2 (n - 1).
        freedom = len(task.cells) - 1
        assert np.square(counts - expected).sum() / expected < freedom + 5 * np.sqrt(2 * freedom)
        assert np.abs(starts[:, 2:].mean(0)).max() < 0.01
        np.testing.assert_allclose(starts[:, 2:].std(0), 0.1, rtol=0.05)
        # Uniform within the cell: standard deviation 0.1 / sqrt(3).
        np.testing.assert_allclose((starts[:, :2] - cells).std(0), 0.1 / np.sqrt(3), rtol=0.05)


def test_rewards_are_of_the_observation_after_the_step():
    for name in ("maze2d-umaze", "maze2d-umaze-dense"):
        task = tasks.task(name)
        simulator = task.simulate(range(50))
        simulator.reset()
        set_moving(simulator, np.concatenate([np.linspace([1, 1], [1, 2], 50), np.ones((50, 2))], 1))
        observations, rewards, terminals, timeouts = simulator.step(np.ones((50, 2)))
        distance = np.linalg.norm(observations[:, :2].astype(float) - [1, 1], axis=1)
        expected = np.exp(-distance) if task.dense else (distance <= 0.5).astype(float)
        np.testing.assert_allclose(rewards, expected, rtol=1e-6)
        assert rewards.dtype == np.float32
        assert not terminals.any()
        assert not timeouts.any()
        assert task.dense or 0 < rewards.mean() < 1


def test_timeouts_at_the_horizon_and_again_after_reset():
    simulator = UMAZE.simulate([0, 1])
    for _ in range(2):
        simulator.reset()
        ends = [simulator.step(np.zeros((2, 2)))[3] for _ in range(300)]
        np.testing.assert_array_equal(np.array(ends), np.arange(300)[:, None].repeat(2, 1) == 299)


def test_gymnasium_finds_the_ids_through_the_module_that_registers_them():
    code = "import gymnasium; gymnasium.make('deadreckon.tasks.envs:deadreckon/Maze2D-EvalLargeDense-v1')"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_importing_tasks_is_light():
    code = "import sys, deadreckon.tasks; sys.exit(bool({'mujoco', 'gymnasium', 'jax'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_task_of_ones_own():
    own = Task("own-task", "own", 5, (1,), UMAZE.action_space, "x", UMAZE.reference)
    tasks.register(own)
    try:
        assert tasks.task("own-task") is own
        assert "own-task" in tasks.names()
        with pytest.raises(NotImplementedError):
            own.simulate([0])
    finally:
        tasks.registry._TASKS.pop("own-task")


def test_reference_scale():
    np.testing.assert_allclose(UMAZE.reference.normalise([UMAZE.reference.random, UMAZE.reference.expert]), [0, 100])
