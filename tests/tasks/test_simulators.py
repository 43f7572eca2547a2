"""What every simulator promises: copies that know nothing of each other, of threads or of interruptions."""

import importlib.util
from dataclasses import replace
from importlib import metadata

import numpy as np
import pytest
from walks import walk

from deadreckon import tasks
from deadreckon.bench.tune import candidates, suite
from deadreckon.cli.main import main
from deadreckon.versions import installed

# Horizons so short that some copies' episodes end with every task; hopper and ant fall, and pens drop, before that, too.
HORIZONS = {"hopper": 25, "halfcheetah": 9, "ant": 12, "humanoid": 18, "maze2d-umaze-dense": 7, "pen": 22, "antmaze-umaze": 8,
            "ant-reach": 13, "relocate": 11, "carla-lane-state": 14, "carla-town-state": 14,
            "finger-turn-hard": 13, "manipulator-insert-peg": 10}  # fmt: skip
WORLDS = {name: replace(tasks.task(name), horizon=horizon) for name, horizon in HORIZONS.items()}
# Slow are those that differ from a fast one in nothing but the body and the reward.
SLOW = ("humanoid", "ant-reach", "relocate", "manipulator-insert-peg")
absent = pytest.mark.skipif(importlib.util.find_spec("dm_control") is None, reason="dm_control is not installed")


def marks(name):
    return [pytest.mark.slow] * (name in SLOW) + [absent] * (WORLDS[name].domain == "control")


every = pytest.mark.parametrize("task", [pytest.param(task, id=name, marks=marks(name)) for name, task in WORLDS.items()])
COPIES, STEPS = 40, 30  # enough copies for threads to be worth waking


def forces(task, seed=0, steps=STEPS, copies=COPIES):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, copies, task.action_space.size)).astype(np.float32)


def assert_same(ours, theirs):
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs):
        np.testing.assert_array_equal(a, b)


without_sumo = pytest.mark.skipif(not installed("libsumo"), reason="libsumo is not installed")


@pytest.mark.parametrize(
    ("name", "package"),
    [("hopper", "gymnasium"), ("antmaze-umaze", "gymnasium"), ("ant-reach", "gymnasium"), ("hopper:pixels", "gymnasium"),
     ("door", "gymnasium-robotics"), ("kitchen-mixed", "gymnasium-robotics"),
     pytest.param("flow-ring", "libsumo", marks=without_sumo)],
)  # fmt: skip
def test_versions_are_of_the_package_that_the_world_is_from(name, package):
    assert tasks.task(name).versions == {package: metadata.version(package)}


def test_tasks_that_the_thesis_does_not_split_belong_to_neither_part(capsys):
    none = [task for task in map(tasks.task, tasks.registry.names()) if not task.split]
    assert {task.domain for task in none} == {"kitchen", "flow", "carla", "battery", "antmaze"}
    assert [task.name for task in none if task.domain == "antmaze"] == ["ant-reach"]
    assert main(["tasks", "--domain", "antmaze"]) == 0
    shown = capsys.readouterr().out.partition("\n\n")[0].splitlines()[2:]  # of the first table
    splits = {words[0]: words[6] for words in map(str.split, shown)}
    assert (splits["antmaze-umaze"], splits["antmaze-eval-umaze"], splits["ant-reach"]) == ("training", "evaluation", "-")
    assert suite("td3_bc", ["kitchen-mixed-v0"], candidates("td3_bc"), by="simulator", steps=10).on == ("kitchen-mixed-v0",)


@pytest.mark.slow
@every
def test_threads_change_nothing(task):
    logs = []
    for threads in (1, 2, 5):
        simulator = task.simulate(range(COPIES), threads=threads)
        if task.domain != "carla":  # whose copies are arrays, stepped without threads
            assert len(simulator._data) == (min(threads, COPIES // 16) if task.domain == "maze2d" else threads)
        logs.append([simulator.reset(), *walk(simulator, forces(task))])
    assert_same(logs[0], logs[1])
    assert_same(logs[0], logs[2])
    assert len(logs[0]) > 1 + 4 * STEPS  # episodes ended and began anew


@pytest.mark.slow
@every
def test_a_copy_depends_on_its_own_seed_and_actions_alone(task):
    actions = forces(task)
    many, few = task.simulate(range(COPIES)), task.simulate([31, 7])
    start = many.reset()
    assert len(np.unique(start, axis=0)) == COPIES
    np.testing.assert_array_equal(few.reset(), start[[31, 7]])
    for t in range(STEPS):
        ours, theirs = many.step(actions[t]), few.step(actions[t][[31, 7]])
        assert_same([part[[31, 7]] for part in ours], theirs)
        ended = ours[2] | ours[3]
        if ended.any():
            again = np.zeros_like(start)
            again[ended] = many.reset(np.flatnonzero(ended))
            if ended[[31, 7]].any():
                np.testing.assert_array_equal(few.reset(np.flatnonzero(ended[[31, 7]])), again[[31, 7]][ended[[31, 7]]])


@every
def test_resetting_some_copies_leaves_the_others_alone(task):
    actions = forces(task, steps=6, copies=4)
    touched, left = task.simulate(range(4)), task.simulate(range(4))
    touched.reset(), left.reset()
    assert_same(walk(touched, actions[:3]), walk(left, actions[:3]))
    observations = touched.reset(np.array([2, 0]))
    assert observations.shape == (2, *task.observation_shape)
    fresh = task.simulate([2, 0])
    fresh.reset()
    np.testing.assert_array_equal(observations, fresh.reset())  # the second episode of each, in the order asked for
    for action in actions[3:]:
        ours, theirs = touched.step(action), left.step(action)
        assert_same([part[[1, 3]] for part in ours], [part[[1, 3]] for part in theirs])
        assert (ours[0][[0, 2]] != theirs[0][[0, 2]]).any(1).all()


@pytest.mark.slow
@every
def test_new_seeds_begin_as_a_fresh_simulator_does(task):
    actions = forces(task, copies=3)
    used, fresh = task.simulate([0, 1, 2]), task.simulate([2**64 - 1, 1, 8])
    used.reset()
    walk(used, actions[:9])
    rest = used.reset(np.array([1]), [1])
    np.testing.assert_array_equal(rest, fresh.reset(np.array([1])))
    np.testing.assert_array_equal(used.reset(np.array([2, 0]), [8, 2**64 - 1]), fresh.reset(np.array([2, 0])))
    state = used.state()
    expected = walk(fresh, actions)
    assert_same(walk(used, actions), expected)
    other = task.simulate([5, 6, 7])
    other.restore(state)  # the new seeds are part of the state
    assert_same(walk(other, actions), expected)


@pytest.mark.slow
@every
@pytest.mark.parametrize("steps", [4, 17])
def test_restored_elsewhere_it_goes_on_to_the_bit(task, steps):
    actions = forces(task, copies=5)
    whole = task.simulate(range(5))
    whole.reset()
    walk(whole, actions[:steps])
    whole.reset(np.array([1, 3]))  # so that copies are of different ages
    state = whole.state()
    kept = {key: value.copy() for key, value in state.items()}
    unbroken = walk(whole, actions[steps:])
    assert any(len(part) < 5 for part in unbroken)  # episodes ended, and their copies' next starts were drawn
    assert all(np.array_equal(state[key], kept[key]) for key in state)  # a snapshot, not a window

    other = task.simulate([90 + i for i in range(5)], threads=1)
    other.reset()
    walk(other, actions[:11])
    for _ in range(2):  # and again from the same snapshot
        other.restore(state)
        assert_same(unbroken, walk(other, actions[steps:]))
    assert set(state) == set(other.state())
    assert all(value.shape == other.state()[key].shape for key, value in state.items())
