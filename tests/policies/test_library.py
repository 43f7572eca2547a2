"""The policies of DAPG that come with the package: whole, evenly spaced, and better at the end than at the beginning."""

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.policies import library, store
from deadreckon.tasks import task

OURS = [name for name in library.library_tasks() if task(name).domain != "gym"]


def test_some_are_shipped():
    assert {"maze2d-umaze-dense", "door"} <= set(OURS)


@pytest.mark.parametrize("name", OURS)
def test_snapshots(name):
    policies, found, world = dr.load_policies(name), library.library(name), task(name)
    assert [s.name for s in found] == [f"snapshot-{i:02d}" for i in range(11)]
    updates = [s.updates for s in found]
    assert updates[0] == 0
    assert len(set(np.diff(updates))) == 1
    assert library.about(name)["agent"] == "dapg"
    assert library.about(name)["run"]["demonstrations"]["episodes"] >= 25
    for each, policy in zip(found, policies):
        meta = store.meta(library.ROOT / name / f"{each.name}.npz")
        assert (meta["task"], meta["name"], meta["updates"], meta["agent"]) == (name, each.name, each.updates, "dapg")
        assert policy.has_log_prob
        assert policy(np.zeros((3, *world.observation_shape), np.float32)).shape == (3, world.action_space.size)
        for returns in (each.sampled, each.greedy):
            assert returns.discount == 0.995
            assert returns.episodes >= 100
            assert returns.error > 0
    best, first = max(found, key=lambda s: s.sampled.mean).sampled, found[0].sampled
    assert best.mean - first.mean > 4 * np.hypot(best.error, first.error)


def test_the_command_shows_them(capsys):
    assert main(["tasks", "--domain", "maze2d"]) == 0
    out = capsys.readouterr().out
    assert "maze2d-umaze-dense snapshot-10" in out
    assert "with mean actions" in out
