"""The policies of DAPG and of clones that come with the package: whole, evenly spaced, and better at the end than at first."""

import dataclasses

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.policies import library, store
from deadreckon.tasks import task

ALL = [name for name in library.library_tasks() if name not in library.SHARED]
OURS = [name for name in ALL if task(name).domain not in ("gym", "control")]
OF_SEVERAL_RUNS = [name for name in ALL if task(name).domain == "control"]


def test_some_are_shipped():
    mazes = {f"maze2d-{size}-dense" for size in ("umaze", "medium", "large")}
    ants = {"antmaze-umaze", "antmaze-medium-play", "antmaze-large-play"}
    assert set(OURS) == mazes | ants | {"door", "pen", "hammer", "relocate"}
    assert set(OF_SEVERAL_RUNS) == {"cartpole-swingup", "cheetah-run", "fish-swim", "walker-stand", "walker-walk"}


@pytest.mark.slow
@pytest.mark.parametrize("name", OURS)
def test_snapshots(name):
    policies, found, world = dr.load_policies(name), library.library(name), task(name)
    assert [s.name for s in found] == [f"snapshot-{i:02d}" for i in range(11)]
    updates = [s.updates for s in found]
    about, cloned = library.about(name), world.domain == "antmaze"
    step = updates[1] - updates[0]
    # What learns from a log keeps no policy of before.
    assert updates == [step * (i + cloned) for i in range(11)]
    assert about["agent"] == ("bc" if cloned else "dapg")
    assert "directed" in about["run"]["data"]["name"] if cloned else about["run"]["demonstrations"]["episodes"] >= 25
    for each, policy in zip(found, policies):
        meta = store.meta(library.ROOT / name / f"{each.name}.npz")
        assert (meta["task"], meta["name"], meta["updates"], meta["agent"]) == (name, each.name, each.updates, about["agent"])
        assert policy.has_log_prob
        assert policy(np.zeros((3, *world.observation_shape), np.float32)).shape == (3, world.action_space.size)
        for returns in (each.sampled, each.greedy):
            assert returns.discount == 0.995
            assert returns.episodes >= 100
            assert returns.error > 0 or returns.mean == 0.0
    best, first = max(found, key=lambda s: s.sampled.mean).sampled, found[0].sampled
    assert best.mean - first.mean > 4 * np.hypot(best.error, first.error)


@pytest.mark.parametrize("name", OF_SEVERAL_RUNS)
def test_policies_of_dm_control_are_of_four_agents_and_know_what_they_have_learned_from(name):
    found, about, world = library.evaluated(name), library.about(name), task(name)
    made = about["run"]["runs"]
    assert set(made) == {"d4pg", "abm", "bc", "crr_d"}
    assert len(found) >= 24
    assert {s.name for s in found} == {f"{agent}-{seed}-{s.updates}" for s in found for agent in made for seed in range(3)}
    taught = {store.load_all(s.file).taught.tobytes() for s in found}
    assert len(taught) == 1  # so that one fifth of the episodes is new to all
    for each in (found[0], found[-1]):
        meta, policy = store.meta(each.file), each.policy()
        assert (meta["task"], meta["name"], meta["updates"]) == (name, each.name, each.updates)
        assert policy(np.zeros((3, *world.observation_shape), np.float32)).shape == (3, world.action_space.size)
    for each in found:
        assert each.greedy is None
        assert each.sampled.discount == 0.995
        assert each.sampled.episodes >= 30
        assert each.sampled.length == world.horizon
    assert np.ptp([s.sampled.mean for s in found]) > 0.5 * max(s.sampled.mean for s in found)


def test_tasks_with_the_same_episodes_share_them(capsys):
    first, same = (dr.load_policies(name)[5] for name in ("antmaze-umaze", "antmaze-umaze-diverse"))
    seen = np.random.default_rng(0).standard_normal((4, 29)).astype(np.float32)
    np.testing.assert_array_equal(first(seen), same(seen))
    for name, own in library.SHARED.items():
        called = {key: getattr(task(name), key) for key in ("name", "gym_id", "properties")}
        assert task(name) == dataclasses.replace(task(own), **called)
    assert main(["tasks", "--domain", "antmaze"]) == 0
    out = capsys.readouterr().out
    assert "antmaze-umaze-diverse has those of antmaze-umaze" in out
    row = next(line for line in out.splitlines() if line.startswith("antmaze-umaze snapshot-10")).split()
    last = library.library("antmaze-umaze")[-1]
    worth = [f"{x:.2f}" for x in (last.sampled.mean, last.sampled.error)]
    assert row[2:] == ["22,000", *worth, "80.0", f"{last.sampled.discounted:.2f}", f"{last.greedy.mean:.2f}", "93.0"]


def test_the_command_shows_them(capsys):
    assert main(["tasks", "--domain", "maze2d"]) == 0
    out = capsys.readouterr().out
    assert "maze2d-umaze-dense snapshot-10" in out
    assert "with mean actions" in out
