"""Logs of dm_control's tasks: a part of the episodes of a training online."""

import dataclasses
import importlib.util
import re
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from deadreckon.agents.d4pg import D4PG
from deadreckon.collect import control, recipe, recipe_names, trained
from deadreckon.data.entries import ENTRIES
from deadreckon.data.provenance import Provenance
from deadreckon.errors import UserError
from deadreckon.online import Online, episodes_log
from deadreckon.online.rows import row_columns, row_width, unpacked
from deadreckon.tasks import registry
from deadreckon.tasks.control import TASKS
from deadreckon.training.replay import read_rows

pytest.importorskip("dm_control", reason="dm_control is not installed (extra `control`)")
NAME = "cartpole-swingup-full-replay-v0"
TASK = dataclasses.replace(registry.task("cartpole-swingup"), horizon=20)


@pytest.fixture
def short(monkeypatch):
    """A training of 320 steps: four episodes of each of four copies."""
    monkeypatch.setitem(control.TRAINED, "cartpole-swingup", 320)
    monkeypatch.setattr(control, "AGENT", D4PG(hidden=(8,), critic_hidden=(8,), batch_size=16, n_step=5))
    monkeypatch.setattr(control, "ONLINE", Online(copies=4, explore=64, updates_per_step=0.25, block=32))
    monkeypatch.setattr(trained, "CHUNK", 16)


def collected(scratch, steps=100, progress=None):
    return control.collect_control(TASK, name=NAME, steps=steps, scratch=scratch, seed=3, threads=1, progress=progress)


def test_every_task_has_a_log_of_the_size_of_table_8_1():
    rows = {"cartpole-swingup": 40, "cheetah-run": 300, "finger-turn-hard": 500, "fish-swim": 200, "humanoid-run": 3_000}
    rows |= {"manipulator-insert-ball": 1_500, "manipulator-insert-peg": 1_500, "walker-stand": 200, "walker-walk": 200}
    for task in TASKS:
        name = f"{task.name}-full-replay-v0"
        assert ENTRIES[name].rows == recipe(name).steps == 1_000 * rows[task.name]
        assert name in recipe_names()
        assert registry.of_log(f"{name}@dr1") is registry.task(task.name)
        assert control.TRAINED[task.name] % (task.horizon * control.ONLINE.copies) == 0
        assert control.TRAINED[task.name] >= recipe(name).steps


def test_without_dm_control_one_line_says_what_is_missing(tmp_path, monkeypatch):
    find, version = importlib.util.find_spec, metadata.version

    def missing(name):
        if name == "dm_control":
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "dm_control" else find(name, *more))
    monkeypatch.setattr(metadata, "version", missing)
    with pytest.raises(UserError, match="cartpole-swingup needs dm_control, which is not installed"):
        collected(tmp_path)


@pytest.mark.slow
def test_episodes_are_whole_and_evenly_spaced_over_the_training(short, tmp_path):
    log = collected(tmp_path)
    assert log.name == f"{NAME}@dr1"
    assert (log.lengths == 20).all()
    assert log.timeouts[19::20].all()
    assert not log.terminals.any()
    # By hand: of sixteen episodes numbered as they came, the copies in their order, five from the first to the last.
    rows = read_rows(tmp_path / "training" / "rows.bin", row_width(TASK), 320)
    columns = unpacked(rows, row_columns(TASK))
    turns = {name: column.reshape(4, 20, 4, *column.shape[1:]) for name, column in columns.items()}  # (turn, step, copy, ...)
    for i, number in enumerate((0, 4, 8, 11, 15)):
        turn, copy = divmod(number, 4)
        own = slice(20 * i, 20 * (i + 1))
        for name, column in (("observation", "observations"), ("action", "actions"), ("reward", "rewards")):
            np.testing.assert_array_equal(getattr(log, column)[own], turns[name][turn, :, copy])
        np.testing.assert_array_equal(log.final_observations[i], turns["next_observation"][turn, -1, copy])
    assert log.provenance.extra["trained"] == 320
    assert log.provenance.extra["training"]["n_step"] == 5


@pytest.mark.slow
def test_a_killed_training_goes_on_and_another_log_is_refused(short, tmp_path):
    class Killed(Exception):
        pass

    def kill(done, total):
        if done > 200:
            raise Killed

    told = []
    with pytest.raises(Killed):
        collected(tmp_path / "a", progress=kill)
    resumed = collected(tmp_path / "a", progress=lambda done, total: told.append(done))
    assert told[0] > 150  # not from its beginning
    assert resumed.fingerprint == collected(tmp_path / "b").fingerprint
    with pytest.raises(UserError, match="holds the beginning of another collection"):
        control.collect_control(TASK, name=NAME, steps=100, scratch=tmp_path / "a", seed=4, threads=1)


@pytest.mark.slow
def test_episodes_that_do_not_end_together_are_no_log(short, tmp_path):
    collected(tmp_path)
    path = tmp_path / "training" / "rows.bin"
    rows = np.memmap(path, np.float32, "r+", shape=(320, row_width(TASK)))
    rows[45, -1] = 1.0
    with pytest.raises(UserError, match="episodes do not all end after 20 steps of their copy"):
        episodes_log(path, TASK, 4, 320, 5, name=NAME, provenance=Provenance())


def test_rows_are_whole_episodes_of_the_training(short, tmp_path):
    for steps in (30, 340):
        with pytest.raises(UserError, match=f"steps must be a multiple of 20, 320 at most, got {steps}"):
            collected(tmp_path, steps)


def test_the_page_has_the_sizes_of_the_recipes():
    page = (Path(__file__).parents[2] / "docs" / "tasks" / "control.md").read_text()
    rows = re.findall(r"^\| `([a-z-]+)-full-replay-v0` \| ([\d,]+) \| ([\d,]+) \|$", page, re.M)
    said = {name: (int(kept.replace(",", "")), int(steps.replace(",", ""))) for name, kept, steps in rows}
    assert said == {name: (recipe(f"{name}-full-replay-v0").steps, steps) for name, steps in control.TRAINED.items()}
