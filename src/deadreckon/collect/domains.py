"""The recipes of all domains, which register themselves here."""

from functools import partial
from pathlib import Path
from typing import Any

from deadreckon.collect.adroit import collect_adroit
from deadreckon.collect.antmaze import collect_antmaze
from deadreckon.collect.control import collect_control
from deadreckon.collect.driving import KINDS as DRIVERS
from deadreckon.collect.driving import collect_driving
from deadreckon.collect.flow import collect_flow
from deadreckon.collect.gym import collect_gym, collect_replay
from deadreckon.collect.kitchen import collect_kitchen
from deadreckon.collect.maze2d import collect_maze2d
from deadreckon.collect.recipes import Maker, Recipe, register
from deadreckon.collect.town import NOISE as TOWN_NOISE
from deadreckon.collect.town import drive
from deadreckon.data.catalogue import entry
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import ENTRIES
from deadreckon.policies.library import about, library_tasks
from deadreckon.tasks import adroit, antmaze, control, driving, flow, gym_mujoco, kitchen, maze2d, registry, town
from deadreckon.tasks.maze2d import Maze2D
from deadreckon.tasks.task import Task


def _register(name: str, task: Task, make: Maker, summary: str, rows: int | None = None) -> None:
    """Registers the recipe of the catalogue's log `name`, with as many rows unless `rows` says how many ours has."""
    known = entry(name)
    register(Recipe(known.name, task.name, rows or known.rows or 0, make, summary))


# ---- Maze2D -----------------------------------------------------------------------------------------------------------


def _maze2d(task: Maze2D, *, scratch: Path, **options: Any) -> Dataset:
    return collect_maze2d(task, **options)  # made in one go, without a folder


for _task in maze2d.TASKS:
    assert registry.task(_task.name) is _task
    _register(f"{_task.name}-v1", _task, partial(_maze2d, _task), "waypoints of a planner to random targets, PD control")


# ---- Gym-MuJoCo -------------------------------------------------------------------------------------------------------

_GYM = {
    "random": "a randomly initialised policy",
    "uniform": "actions drawn uniformly between the bounds",
    "medium": "SAC, stopped early",
    "expert": "SAC, the best of its run",
    "medium-expert": "first medium, then expert",
    "uniform-expert": "first uniform actions, then expert",
}

for _task in gym_mujoco.TASKS:
    for _kind, _summary in _GYM.items():
        if f"{_task.name}-{_kind}-v2" in ENTRIES:
            _register(f"{_task.name}-{_kind}-v2", _task, partial(collect_gym, _task, _kind), _summary)
    if f"{_task.name}-medium-replay-v2" in ENTRIES:
        # The replay buffer is as long as our own run took to get to medium, whatever the original's length.
        _rows = about(_task.name)["medium_replay"]["environment_steps"] if _task.name in library_tasks() else None
        _summary = "all steps of SAC up to medium, by training again"
        _register(f"{_task.name}-medium-replay-v2", _task, partial(collect_replay, _task), _summary, _rows)


# ---- Flow -------------------------------------------------------------------------------------------------------------

_FLOW = {"random": "accelerations drawn uniformly between the bounds", "controller": "the intelligent driver model"}

for _task in flow.TASKS:
    for _kind, _summary in _FLOW.items():
        _register(f"{_task.name}-{_kind}-v0", _task, partial(collect_flow, _task, _kind), _summary)


# ---- Adroit -----------------------------------------------------------------------------------------------------------

_ADROIT = {
    "human": "people: 25 demonstrations",
    "cloned": "half people, over and over, half a clone of them by behaviour cloning",
    "expert": "the policy that DAPG trained",
}

for _task in adroit.TASKS:
    for _kind, _summary in _ADROIT.items():
        _register(f"{_task.name}-{_kind}-v1", _task, partial(collect_adroit, _task, _kind), _summary)


# ---- FrankaKitchen ----------------------------------------------------------------------------------------------------

_KITCHEN = {
    "complete": "a scripted demonstrator: the four sub-tasks in order, always with success",
    "partial": "a scripted demonstrator: four sub-tasks of six at random, in one episode of four the task's",
    "mixed": "a scripted demonstrator: four sub-tasks of six at random, never all of the task's",
}

for _task in kitchen.TASKS:
    _summary = _KITCHEN[_task.name.removeprefix("kitchen-")]
    _register(f"{_task.name}-v0", _task, partial(collect_kitchen, _task), _summary)


# ---- AntMaze ----------------------------------------------------------------------------------------------------------

_ANTMAZE = {
    "play": "a planner's waypoints to hand-picked cells, one after the other, from anywhere; a walker with noise",
    "diverse": "a planner's waypoints to random cells, one after the other, from anywhere; a walker with noise",
    "umaze": "a planner's waypoints from the start to the goal; a walker with noise",
}

for _task in antmaze.TASKS:
    _register(f"{_task.name}-v2", _task, partial(collect_antmaze, _task), _ANTMAZE[_task.name.rsplit("-", 1)[1]])


# ---- CARLA ------------------------------------------------------------------------------------------------------------

_DRIVING = ("pure pursuit along the lane at 20 km/h", "the same with noise on its actions", "uniform actions")

for _task in driving.TASKS:
    for _kind, _summary in zip(DRIVERS, _DRIVING, strict=True):
        _middle = "" if _kind == "controller" else f"-{_kind}"
        _register(f"{_task.name}{_middle}-v0", _task, partial(collect_driving, _task, _kind), _summary)

_TOWN = ("pure pursuit along the route, by lights and behind other cars", *_DRIVING[1:])

for _task in town.TASKS:
    for _kind, _summary in zip(DRIVERS, _TOWN, strict=True):
        _middle, _make = "" if _kind == "controller" else f"-{_kind}", partial(collect_driving, act=drive, noise=TOWN_NOISE)
        _register(f"{_task.name}{_middle}-v0", _task, partial(_make, _task, _kind), _summary)


# ---- dm_control ---------------------------------------------------------------------------------------------------------

for _task in control.TASKS:
    _summary = "episodes from a whole online training run of D4PG"
    _register(f"{_task.name}-full-replay-v0", _task, partial(collect_control, _task), _summary)
