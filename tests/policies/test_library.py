"""The policies of DAPG and of clones that come with the package: whole, evenly spaced, and better at the end than at first."""

import dataclasses

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.policies import library, store
from deadreckon.tasks import task

OURS = [name for name in library.library_tasks() if task(name).domain != "gym" and name not in library.SHARED]


def test_some_are_shipped():
    mazes = {f"maze2d-{size}-dense" for size in ("umaze", "medium", "large")}
    ants = {"antmaze-umaze", "antmaze-medium-play", "antmaze-large-play"}
    assert set(OURS) == mazes | ants | {"door", "pen", "hammer", "relocate"}


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
    assert row[2:] == ["22,000", "0", *worth, "80.0", f"{last.sampled.discounted:.2f}", f"{last.greedy.mean:.2f}", "93.0"]


def test_the_command_shows_them(capsys):
    assert main(["tasks", "--domain", "maze2d"]) == 0
    out = capsys.readouterr().out
    assert "maze2d-umaze-dense snapshot-10" in out
    assert "with mean actions" in out
