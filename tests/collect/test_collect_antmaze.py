"""The AntMaze logs: where the guide leads, and what the log says of it."""

from dataclasses import replace

import numpy as np
import pytest

from deadreckon import tasks
from deadreckon.collect import antmaze, recipe, rollouts
from deadreckon.collect.antmaze import Errands, collect_antmaze, walker
from deadreckon.tasks.antmaze import PICKED, TASKS

MEDIUM = tasks.task("antmaze-medium-play")


class Goals:
    """As much of a simulator as the guide looks at."""

    def __init__(self, goal):
        self.goals = np.array([goal])


def led(task, goal=(0.75, 8.75)):
    """A guide of one ant that stands at the start."""
    guide = Errands(task, walker(), copies=1, noise=0.0)
    guide.begin(Goals(goal), 0, standing((0.0, 0.0))[0], np.random.default_rng(0))
    return guide


def standing(place):
    seen = np.zeros((1, 29), np.float32)
    seen[0, :4] = *place, 0.55, 1.0
    return seen


def aim(guide, place):
    guide.act(standing(place), np.array([0]))
    return guide._aim[0].copy()


def test_the_guide_leads_from_cell_to_cell_and_remembers_where_it_is():
    task = tasks.task("antmaze-umaze")
    guide = led(task)
    corners = [(4, 0), (8, 0), (8, 4), (8, 8), (4, 8)]  # middles of the cells on the way
    for corner in corners:
        ahead = aim(guide, guide._aim[0] - [0.0, 1.1])  # not near enough
        assert ((ahead >= corner) & (ahead <= np.add(corner, 1.0))).all()
        aim(guide, ahead - [0.0, 0.9])
    np.testing.assert_allclose(guide._aim[0], [0.75, 8.75])
    assert guide.target[0].tolist() == [0.75, 8.75]
    assert guide.sent == 1
    # Back at the start, as if pushed: two cells off the way, it begins anew.
    assert ((aim(guide, (0.0, 0.0)) >= [4, 0]) & (guide._aim[0] <= [5, 1])).all()


def test_wandering_ants_are_sent_on_when_they_arrive():
    guide, cells = led(MEDIUM), set()
    for sent in range(1, 30):
        assert guide.sent == sent
        cell = MEDIUM.cells[MEDIUM.cell_of(guide.target)[0]]
        off = guide.target[0] - MEDIUM.middles(cell)
        assert ((off >= 0) & (off <= 1.5)).all()
        cells.add(tuple(cell))
        place = guide.target[0].copy()
        aim(guide, place)
        assert MEDIUM.cell_of(guide.target)[0] != MEDIUM.cell_of(place[None])[0]  # never where it is
    assert cells == set(PICKED["medium"])


def test_the_walker_is_led_by_the_direction_alone():
    guide = led(tasks.task("antmaze-umaze"))
    action = guide.act(standing((2.0, 0.0)), np.array([0]))[0]
    guide._aim[0] = [2.0 + 3 * (guide._aim[0, 0] - 2.0), 3 * guide._aim[0, 1]]  # the same direction, further off
    np.testing.assert_allclose(guide.act(standing((2.0, 0.0)), np.array([0]))[0], action, atol=1e-5)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_every_log_can_be_made(task, tmp_path):
    log = collect_antmaze(replace(task, horizon=30), name="short", steps=50, scratch=tmp_path, threads=1)
    assert (len(log), log.episodes, log.observations.shape[1], log.actions.shape[1]) == (50, 2, 29, 8)
    goals = {tuple(cell) for cell in task.cells[task.cell_of(log.extras["goal"])]}
    kind = task.name.rsplit("-", 1)[1]
    if kind == "play":
        assert goals <= set(task.picked)
    elif kind != "diverse":
        assert goals == {tuple(task.marked("G"))}
        assert (np.abs(log.observations[[0, 30], :2]) <= 0.1 + 1e-6).all()
    known = recipe(f"{task.name}-v2")
    assert (known.task, known.steps) == (task.name, 1_000_000)


@pytest.mark.slow
def test_an_ant_walks_to_the_goal_and_a_kill_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(rollouts, "FLUSH", 100)
    task = replace(tasks.task("antmaze-umaze"), horizon=260)

    class Killed(Exception):
        pass

    def kill(done, total):
        if done >= 300:
            raise Killed

    options = {"name": "walked", "steps": 600, "seed": 3}
    whole = collect_antmaze(task, **options, scratch=tmp_path / "whole", threads=2)
    with pytest.raises(Killed):
        collect_antmaze(task, **options, scratch=tmp_path / "parts", threads=1, progress=kill)
    again = collect_antmaze(task, **options, scratch=tmp_path / "parts", threads=1)
    for key in ("observations", "actions", "rewards", "terminals", "timeouts"):
        np.testing.assert_array_equal(getattr(whole, key), getattr(again, key))
    np.testing.assert_array_equal(whole.extras["goal"], again.extras["goal"])
    np.testing.assert_array_equal(whole.extras["episode_goal"], again.extras["episode_goal"])
    assert whole.terminals.sum() >= 1  # in 2 to 4 episodes, of which nine in ten arrive
    np.testing.assert_array_equal(whole.rewards, whole.terminals)
    away = np.linalg.norm(whole.final_observations[:, :2] - whole.extras["episode_goal"][whole.ends], axis=1)
    np.testing.assert_array_equal(away <= 0.5, whole.terminals[whole.ends])
    assert whole.provenance.extra["policies"] == ["ant-reach walker"]


@pytest.mark.slow
def test_most_ants_arrive(tmp_path):
    log = collect_antmaze(tasks.task("antmaze-umaze"), name="walked", steps=8000, scratch=tmp_path)
    assert log.episodes >= 30
    assert log.terminals.sum() >= 0.85 * log.episodes
    away = np.linalg.norm(log.final_observations[:, :2] - log.extras["episode_goal"][log.ends], axis=1)
    np.testing.assert_array_equal(away <= 0.5, log.terminals[log.ends])


@pytest.mark.slow
def test_the_shipped_walker_walks_on_open_ground():
    import deadreckon as dr
    from deadreckon.files import read_json

    told = read_json(antmaze.WALKER.with_suffix(".json"))["return"]
    again = dr.evaluate(walker(), "ant-reach", episodes=40, seed=5).returns
    assert abs(again.mean() - told["mean"]) < 5 * again.std() / 40**0.5


def test_what_the_walker_was_made_with_lies_beside_it():
    from deadreckon.files import read_json

    about = read_json(antmaze.WALKER.with_suffix(".json"))
    assert about["environment_steps"] > about["updates"] > 0
    assert about["return"]["mean"] > 5 * about["return"]["error"]
