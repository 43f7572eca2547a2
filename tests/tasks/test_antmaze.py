"""AntMaze: bodies and mazes are D4RL's, and the ground on which the walker learns is the same in all directions."""

from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon import tasks
from deadreckon.errors import UserError
from deadreckon.tasks.antmaze import LAYOUTS, PICKED, REACH_TASK, TASKS, AntMaze, ahead, model

UMAZE = tasks.task("antmaze-umaze")


def started(task, copies=1):
    simulator = task.simulate(range(copies), threads=1)
    return simulator, simulator.reset()


def turned(states, angle):
    """States of an ant (n, 29) after the world has been turned about z; quaternions multiplied by MuJoCo."""
    out, half = states.copy(), np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for row in out:
        row[:2], row[15:17] = rotation @ row[:2], rotation @ row[15:17]
        quaternion = np.zeros(4)
        mujoco.mju_mulQuat(quaternion, half, row[3:7])
        row[3:7] = quaternion
    return out


def test_tasks_are_those_of_the_original():
    names = {f"antmaze-{split}{maze}" for split in ("", "eval-") for maze in
             ("umaze", "umaze-diverse", "medium-play", "medium-diverse", "large-play", "large-diverse")}  # fmt: skip
    assert {task.name for task in TASKS} == names
    for task in TASKS:
        assert task.horizon == (700 if "umaze" in task.name else 1000)
        assert task.split == ("evaluation" if "eval" in task.name else "training")
        assert ("undirected data" in task.properties) == task.name.endswith(("play", "diverse"))
        assert all(task.grid[cell] for cell in task.picked)
    # Where the goals' squares begin: D4RL's cell of the goal, seen from that of the start.
    goals = {name: (tasks.task(name).goal_place() - 0.75).tolist() for name in names if not name.endswith("diverse")}
    assert goals == {
        "antmaze-umaze": [0, 8], "antmaze-medium-play": [20, 20], "antmaze-large-play": [32, 24],
        "antmaze-eval-umaze": [0, 8], "antmaze-eval-medium-play": [20, 0], "antmaze-eval-large-play": [32, 0],
    }  # fmt: skip


def test_the_body_is_the_originals():
    ours = model("")
    assert (ours.opt.timestep, ours.opt.integrator) == (0.02, mujoco.mjtIntegrator.mjINT_RK4)
    np.testing.assert_array_equal(ours.actuator_gear[:, 0], np.full(8, 30.0))
    assert [ours.joint(int(j)).name for j in ours.actuator_trnid[:, 0]] == [
        "hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"]  # fmt: skip
    maze = model(LAYOUTS["umaze"])
    for each in (ours, maze):
        np.testing.assert_allclose(each.geom_solimp[:, :3], np.tile([0.8, 0.8, 0.01], (each.ngeom, 1)))
    assert maze.ngeom - ours.ngeom == LAYOUTS["umaze"].count("#")
    assert maze.nq == ours.nq == 15


def test_walls_stand_where_the_task_says():
    maze = model(LAYOUTS["medium"])
    walls = tasks.task("antmaze-medium-play").walls()
    boxes = maze.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    found = np.hstack([(maze.geom_pos - maze.geom_size)[boxes, :2], (maze.geom_pos + maze.geom_size)[boxes, :2]])
    np.testing.assert_allclose(found, walls)
    task = tasks.task("antmaze-medium-play")
    np.testing.assert_array_equal(task.cell_of(task.middles(task.cells) + np.array([1.9, -1.9])), np.arange(len(task.cells)))
    assert (task.cell_of((walls[:, :2] + walls[:, 2:]) / 2) == -1).all()


def test_a_wall_stops_the_ant():
    furthest = {}
    for task in (UMAZE, REACH_TASK):
        simulator, _ = started(task)
        simulator._moving[0, 16] = 15.0  # m/s along y, where the umaze's wall begins at 2
        places = []
        for _ in range(30):
            simulator.step(np.zeros((1, 8)))
            places.append(simulator._moving[0, 1])
        furthest[task.name] = max(places)
    assert furthest["ant-reach"] > 4.0
    assert 0.5 < furthest["antmaze-umaze"] < 2.0


def test_the_goal_pays_once_and_ends_the_episode_and_a_fall_does_not():
    simulator, seen = started(UMAZE, 3)
    assert seen.shape == (3, 29)
    assert (np.abs(seen[:, :2]) <= 0.1).all()
    low, high = np.array([0.0, 8.0]), np.array([1.5, 9.5])
    assert ((low <= simulator.goals) & (simulator.goals <= high)).all()
    assert len(np.unique(simulator.goals)) == 6
    simulator._moving[0, :2] = simulator.goals[0] + [0.0, 0.45]
    simulator._moving[1, :2] = simulator.goals[1] + [0.55, 0.0]
    simulator._moving[2, 2:7] = 0.3, 0.0, 1.0, 0.0, 0.0  # on its back
    simulator._moving[:, 15:] = 0.0
    _, rewards, terminals, timeouts = simulator.step(np.zeros((3, 8)))
    assert rewards.tolist() == [1.0, 0.0, 0.0]
    assert terminals.tolist() == [True, False, False]
    assert not timeouts.any()
    assert simulator.achieved.tolist() == [True, False, False]
    assert simulator.step(np.zeros((3, 8)))[1].tolist() == [0.0, 0.0, 0.0]  # over
    first = simulator.goals[0].copy()
    simulator.reset(np.array([0]))
    assert not simulator.achieved[0]
    assert (simulator.goals[0] != first).all()


def test_starts_anywhere_are_where_nobody_is_sent():
    task = replace(tasks.task("antmaze-medium-diverse"), anywhere=True)
    seen = task.simulate(range(150), threads=1).reset()
    cells = {tuple(task.cells[i]) for i in task.cell_of(seen[:, :2])}
    assert cells == {tuple(cell) for cell in task.cells} - {*PICKED["medium"], (6, 6)}  # nor the goal's cell
    off = seen[:, :2] - task.middles(task.cells[task.cell_of(seen[:, :2])])
    assert off.min() >= -0.1 - 1e-6
    assert 0.9 < off.max() <= 1.1 + 1e-6


def test_a_layout_needs_a_start():
    with pytest.raises(UserError, match="one 'R' and one 'G'"):
        AntMaze("x", "antmaze", 1, (29,), UMAZE.action_space, "", UMAZE.reference, layout="####/#OG#/####")


@pytest.mark.parametrize("angle", [0.3, 2.0, -2.9])
def test_what_the_walker_sees_does_not_depend_on_where_ahead_is(angle):
    rng = np.random.default_rng(0)
    states = rng.standard_normal((20, 29))
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    straight = ahead(states, np.zeros(20))
    np.testing.assert_allclose(ahead(turned(states, angle), np.full(20, angle)), straight, atol=1e-12)
    assert (straight[:, 1] >= 0).all()
    same = np.where(states[:, 3:4] < 0, -states[:, 3:7], states[:, 3:7])
    np.testing.assert_allclose(straight, np.hstack([states[:, 2:3], same, states[:, 7:]]))
    # Negated quaternions are the same rotations.
    states[:, 3:7] *= -1
    np.testing.assert_allclose(ahead(states, np.zeros(20)), straight)


def test_the_open_ground_is_the_same_in_all_directions():
    simulator, _ = started(REACH_TASK, 2)
    first = simulator._moving[:1].copy()
    simulator._moving[1] = turned(first, 1.1)[0]
    simulator._orders[0, 1:], simulator._orders[1, 1:] = 0.4, 1.5
    rng = np.random.default_rng(1)
    earned = []
    for _ in range(15):
        seen, rewards, *_ = simulator.step(np.tile(rng.uniform(-1, 1, 8), (2, 1)))
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-4)
        earned.append(rewards)
    np.testing.assert_allclose(*np.transpose(earned), atol=1e-3)


def test_the_walker_is_paid_for_speed_ahead_and_a_fall_ends_its_episode():
    simulator, _ = started(REACH_TASK, 3)
    simulator._moving[:, 15:17] = 2.0 * np.array([[np.cos(0.7), np.sin(0.7)]])
    simulator._orders[:, 1:] = 0.7, 0.7, 0.7, 0.7, 0.7, 0.7
    simulator._orders[1, 1:] = 0.7 + np.pi  # told to go the other way
    simulator._moving[2, 3:7] = 0.0, 1.0, 0.0, 0.0  # on its back
    before = simulator._moving[:, :2].copy()
    _, rewards, terminals, timeouts = simulator.step(np.full((3, 8), 0.5))
    speed = (simulator._moving[:, :2] - before) @ [np.cos(0.7), np.sin(0.7)] / 0.1
    assert speed[0] > 1.0
    np.testing.assert_allclose(rewards, [speed[0] + 0.5 - 0.1, -speed[1] + 0.5 - 0.1, speed[2] - 0.1], rtol=1e-5)
    assert terminals.tolist() == [False, False, True]
    assert not timeouts.any()


def test_returns_on_open_ground_have_no_scale():
    assert REACH_TASK.scores(530.0) is None


def test_orders_change_every_sixty_steps():
    simulator, _ = started(REACH_TASK)
    simulator._orders[0] = [7, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    told = []
    for age in range(REACH_TASK.horizon + 1):
        simulator._age[0] = age
        told.append(simulator._direction()[0])
    assert np.flatnonzero(np.diff(told)).tolist() == [6, 66, 126, 186, 246]
    assert told[-1] == 0.5


@pytest.mark.parametrize("task", [UMAZE, REACH_TASK], ids=lambda task: task.name)
def test_gymnasiums_checks(task):
    env = gymnasium.make(task.gym_id).unwrapped
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=3)
    simulator = task.simulate([3])
    np.testing.assert_array_equal(seen, simulator.reset()[0])
    action = np.linspace(-1, 1, 8, dtype=np.float32)
    np.testing.assert_array_equal(env.step(action)[0], simulator.step(action[None])[0][0])


def test_every_task_has_its_environment():
    for task in (*TASKS, REACH_TASK):
        assert gymnasium.spec(task.gym_id).kwargs == {"task": task.name}
