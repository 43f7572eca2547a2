import numpy as np
import pytest

from deadreckon import collect, tasks
from deadreckon.collect.maze2d import Pursuit
from deadreckon.collect.planner import next_cells
from deadreckon.collect.references import measure
from deadreckon.data.formats.hdf5 import read_hdf5
from deadreckon.errors import UserError
from deadreckon.tasks.maze2d import LAYOUTS, TASKS


def columns(log):
    return (log.observations, log.actions, log.rewards, log.timeouts, log.final_observations, log.extras["goal"])


@pytest.fixture(scope="module")
def umaze():
    return collect.generate("maze2d-umaze-v1", steps=30_000)


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_plans_are_shortest_ways(name):
    task = tasks.task(f"maze2d-{name}")
    following = next_cells(task.grid)
    count = len(task.cells)
    distance = np.full((count, count), 99)
    steps = np.abs(task.cells[:, None] - task.cells).sum(-1)
    distance[steps <= 1] = steps[steps <= 1]
    for k in range(count):  # Floyd and Warshall
        distance = np.minimum(distance, distance[:, k, None] + distance[None, k])
    goals, cells = np.indices((count, count))
    moved = distance[following, goals]
    np.testing.assert_array_equal(moved, np.maximum(distance[cells, goals] - 1, 0))
    np.testing.assert_array_equal(steps[following, cells], goals != cells)


def test_unreachable_cells_stay():
    following = next_cells(np.array([[True, False, True]]))
    np.testing.assert_array_equal(following, [[0, 1], [0, 1]])


def test_ways_may_be_long():
    following = next_cells(np.ones((1, 120), bool))
    np.testing.assert_array_equal(following[0], np.maximum(np.arange(120) - 1, 0))
    np.testing.assert_array_equal(following[-1], np.minimum(np.arange(120) + 1, 119))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(LAYOUTS))
def test_pursuits_succeed_and_every_cell_is_visited(name):
    task = tasks.task(f"maze2d-{name}")
    simulator = task.simulate(range(100))
    controller = Pursuit(task, 100, np.random.default_rng(0), patience=task.horizon)
    seen = simulator.reset()
    controller.start(seen)
    visits, age, pursuits, failures = np.zeros(len(task.cells), int), np.zeros(100, int), 0, 0
    for _ in range(1000):
        seen = simulator.advance(controller.act(seen))
        ended, age = controller.observe(seen), age + 1
        pursuits, failures = pursuits + ended.sum(), failures + (ended & (age >= task.horizon)).sum()
        age[ended] = 0
        visits += np.bincount(task.cell_of(seen[:, :2]), minlength=len(visits))
    assert pursuits > 300
    assert failures < 0.01 * pursuits
    assert visits.min() > 0


RECIPES = [name for name in collect.recipe_names() if name.startswith("maze2d-")]


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_short_log_of_every_recipe(name):
    log = collect.generate(name, steps=2_500)
    task = tasks.task(collect.recipe(name).task)
    assert len(log) == 2_500
    assert log.name == f"{name}@dr1-2500-steps"
    assert log.action_space == task.action_space
    assert not log.warnings
    assert not log.terminals.any()
    assert log.dropped == 0
    # To the bit: what the task says of the observation after each step.
    np.testing.assert_array_equal(log.rewards, task.rewards(log.next_observations))
    assert np.abs(log.actions).max() <= 1
    assert log.lengths.max() <= task.horizon
    assert (task.cell_of(log.extras["goal"]) >= 0).all()


def test_recipes_are_the_thesis_sizes():
    assert len(RECIPES) == len(TASKS)
    for size, rows in (("umaze", 1_000_000), ("medium", 2_000_000), ("large", 4_000_000)):
        for name in (f"maze2d-{size}-v1", f"maze2d-{size}-dense-v1", f"maze2d-eval-{size}-v1"):
            assert collect.recipe(name).steps == rows
    assert collect.recipe("maze2d-umaze-v1@dr1") is collect.recipe("maze2d-umaze-v1")


def test_episodes_are_pursuits(umaze):
    goal, starts, ends = umaze.extras["goal"], umaze.starts, umaze.ends
    # One target an episode, another in the next.
    np.testing.assert_array_equal(goal, goal[starts][umaze.episode_of])
    assert (goal[starts[1:]] != goal[ends[:-1]]).any(1).all()
    # Streams are 2,000 rows long; within one, the next episode begins where the last one ended.
    inside = (ends[:-1] + 1) % 2_000 != 0
    assert 0 < (~inside).sum() == 30_000 // 2_000 - 1
    np.testing.assert_array_equal(umaze.final_observations[:-1][inside], umaze.observations[starts[1:]][inside])
    # Pursuits that the recording did not cut off ended at their target.
    away = np.linalg.norm(umaze.final_observations[:-1, :2] - goal[ends[:-1]], axis=1)
    assert (away[inside] < 0.1 + 1e-6).all()


def test_the_log_replays(umaze):
    """Actions and physics fit: repeating the logged actions from the first row gives the logged observations."""
    simulator = tasks.task("maze2d-umaze").simulate([0])
    state = simulator.state()
    state["physics"][0, 1:] = umaze.observations[0]
    simulator.restore(state)
    for row in range(50):
        seen = simulator.step(umaze.actions[row : row + 1])[0]
        np.testing.assert_allclose(seen[0], umaze.next_observations_at(np.array([row]))[0], atol=1e-3)


@pytest.mark.slow
def test_the_log_depends_on_the_seed_alone(umaze):
    again = collect.generate("maze2d-umaze-v1", steps=30_000, threads=1)
    more = collect.generate("maze2d-umaze-v1", steps=30_000, threads=3)
    dense = collect.generate("maze2d-umaze-dense-v1", steps=30_000)
    for ours, *others in zip(columns(umaze), columns(again), columns(more)):
        for other in others:
            np.testing.assert_array_equal(ours, other)
    np.testing.assert_array_equal(umaze.observations, dense.observations)
    assert not np.array_equal(umaze.observations, collect.generate("maze2d-umaze-v1", steps=30_000, seed=1).observations)
    assert umaze.provenance.seed == 0
    assert umaze.provenance.recipe == "maze2d-umaze-v1"
    assert set(umaze.provenance.versions) == {"mujoco", "numpy", "deadreckon"}


@pytest.mark.parametrize("steps", [1, 7, 4_001, 6_005])
def test_any_number_of_rows(steps):
    done = []
    log = collect.generate("maze2d-umaze-v1", steps=steps, progress=lambda now, total: done.append((now, total)))
    assert len(log) == steps
    assert log.dropped == 0
    assert log.timeouts[-1]
    assert done[-1] == (steps, steps)
    assert done == sorted(done)
    np.testing.assert_array_equal(log.rewards, tasks.task("maze2d-umaze").rewards(log.next_observations))
    # No step of the ball is longer than its speed allows, so no row's successor is another stream's.
    assert np.abs(log.next_observations[:, :2] - log.observations[:, :2]).max() < 0.06


@pytest.mark.slow
def test_files(tmp_path, home):
    path = collect.collect("maze2d-umaze-v1", steps=3_000, out=tmp_path / "log.hdf5")
    log, memory = read_hdf5(path), collect.generate("maze2d-umaze-v1", steps=3_000)
    for a, b in zip(columns(log), columns(memory)):
        np.testing.assert_array_equal(a, b)
    assert log.name == "maze2d-umaze-v1@dr1-3000-steps"
    assert log.provenance.recipe == "maze2d-umaze-v1"
    part = collect.collect("maze2d-umaze-v1", steps=2_000, seed=3)
    assert home in part.parents
    assert part.name == "maze2d-umaze-v1@dr1-2000-steps-seed-3.hdf5"
    assert read_hdf5(part).name == "maze2d-umaze-v1@dr1-2000-steps-seed-3"
    # What is there already is kept: by default as it is the same log, elsewhere unless one asks for it.
    written = part.stat().st_mtime_ns
    assert collect.collect("maze2d-umaze-v1", steps=2_000, seed=3) == part
    assert part.stat().st_mtime_ns == written
    with pytest.raises(UserError, match=r"log.hdf5 exists already; --force \(force=True\) replaces it"):
        collect.collect("maze2d-umaze-v1", steps=10, out=tmp_path / "log.hdf5")
    assert len(read_hdf5(tmp_path / "log.hdf5")) == 3_000
    assert len(read_hdf5(collect.collect("maze2d-umaze-v1", steps=10, out=tmp_path / "log.hdf5", force=True))) == 10


def test_bad_input_is_told():
    with pytest.raises(UserError, match="did you mean maze2d-umaze-v1"):
        collect.collect("maze2d-umaze-v2")
    with pytest.raises(UserError, match="steps must be 1 or more"):
        collect.generate("maze2d-umaze-v1", steps=0)
    with pytest.raises(UserError, match=r"seed must be 0 \.\. 2\^32 - 1, got -1"):
        collect.generate("maze2d-umaze-v1", steps=10, seed=-1)
    with pytest.raises(UserError, match="threads must be 1 or more"):
        collect.generate("maze2d-umaze-v1", steps=10, threads=0)
    with pytest.raises(UserError, match="registered already"):
        collect.register(collect.recipe("maze2d-umaze-v1"))


def test_reference_scores_are_reproduced():
    task = tasks.task("maze2d-umaze")
    random, expert = measure(task)
    # Equal on the machine where they were measured; elsewhere rounding may send single episodes another way.
    assert random == pytest.approx(task.reference.random, abs=6)
    assert expert == pytest.approx(task.reference.expert, abs=3)
    # Uniform actions know no controller: the simulator itself must give what D4RL's gave (standard error 4).
    assert task.published is not None
    assert random == pytest.approx(task.published.random, abs=12)
