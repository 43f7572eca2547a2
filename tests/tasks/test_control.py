"""Nine tasks beside dm_control's own environments, step by step, to the last bit."""

import importlib.util
from importlib import metadata

import numpy as np
import pytest

from deadreckon import tasks
from deadreckon.collect.references import uniform_return
from deadreckon.errors import UserError
from deadreckon.tasks import control
from deadreckon.tasks.control import TASKS, Control

installed = pytest.mark.skipif(importlib.util.find_spec("dm_control") is None, reason="dm_control is not installed")
SLOW = ("humanoid-run", "manipulator-insert-ball", "manipulator-insert-peg", "walker-stand", "fish-swim")
every = pytest.mark.parametrize(
    "task", [pytest.param(t, id=t.name, marks=[pytest.mark.slow] * (t.name in SLOW)) for t in TASKS]
)


def flat(timestep):
    return np.concatenate([np.ravel(part) for part in timestep.observation.values()]).astype(np.float32)


@installed
@every
def test_it_is_dm_controls_environment(task):
    seeds = 3, 7, 11, 5
    simulator, theirs = task.simulate(seeds, threads=1), [control._suite().load(*task.suite, {"random": s}) for s in seeds]
    rng, paid = np.random.default_rng(0), 0.0
    for _ in range(2):  # the second episode goes on with the same random numbers
        np.testing.assert_array_equal(simulator.reset(), [flat(env.reset()) for env in theirs])
        for _ in range(25):
            actions = rng.uniform(-1.3, 1.3, (4, task.action_space.size)).astype(np.float32)  # beyond the bounds, too
            seen, rewards, terminals, timeouts = simulator.step(actions)
            steps = [env.step(action) for env, action in zip(theirs, actions)]
            np.testing.assert_array_equal(seen, [flat(step) for step in steps])
            np.testing.assert_array_equal(rewards, np.array([step.reward for step in steps], np.float32))
            assert not (terminals | timeouts).any()
            paid += float(rewards.sum())
    assert paid > 0.0 or task.name in ("finger-turn-hard", "manipulator-insert-ball")  # which pay at the target alone


@installed
@pytest.mark.slow
def test_episodes_time_out_with_dm_controls():
    task = tasks.task("cartpole-swingup")
    simulator, theirs = task.simulate([0]), control._suite().load(*task.suite, {"random": 0})
    simulator.reset(), theirs.reset()
    for step in range(1, task.horizon + 1):
        action = np.full((1, 1), np.sin(step / 9), np.float32)
        seen, reward, terminals, timeouts = simulator.step(action)
        timestep = theirs.step(action[0])
        assert not terminals[0]
        assert timeouts[0] == timestep.last() == (step == task.horizon)
        np.testing.assert_array_equal(seen[0], flat(timestep))
    assert timestep.discount == 1.0  # what is not a terminal


@installed
def test_what_an_episode_moves_is_its_own_copys():
    """The peg's slot stands elsewhere in every copy, and shows in what is observed and paid after other copies' steps."""
    task = tasks.task("manipulator-insert-peg")
    pair, alone = task.simulate([0, 1], threads=1), task.simulate([1])
    pair.reset(), alone.reset()
    assert (pair._layout[0] != pair._layout[1]).any()
    still = np.zeros((2, 5), np.float32)
    for _ in range(3):
        np.testing.assert_array_equal(pair.step(still)[0][1], alone.step(still[:1])[0][0])


@installed
def test_a_score_of_zero_is_what_uniform_actions_earn():
    task = tasks.task("cartpole-swingup")
    found = uniform_return(task, range(5), np.random.default_rng(0))
    assert abs(found - task.reference.random) < 20.0
    assert all(0.0 < each.reference.random < 350.0 for each in TASKS)
    assert task.scores(float(task.horizon)) == 100.0


def test_without_the_package_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(control.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"fish-swim needs dm_control.*install the extra control.*, with Python 3.11"):
        tasks.task("fish-swim").simulate([0])


def test_runs_note_the_packages_version_where_it_is_there(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    seen = tasks.task("fish-swim:pixels")
    assert seen.versions == tasks.task("fish-swim").versions
    monkeypatch.setattr(metadata, "version", absent)
    assert tasks.task("fish-swim").versions == {}


def test_names_are_the_suites():
    assert all(isinstance(task, Control) and task.name == "-".join(task.suite).replace("_", "-") for task in TASKS)
    assert [len(task.properties) for task in TASKS] == [0, 2, 2, 2, 2, 3, 3, 2, 2]  # Table 8.1
