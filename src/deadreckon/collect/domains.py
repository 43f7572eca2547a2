"""The recipes of all domains, which register themselves here."""

from pathlib import Path
from typing import Any

from deadreckon.collect.recipes import Maker, Recipe, register
from deadreckon.data.catalogue import ENTRIES, entry
from deadreckon.data.dataset import Dataset
from deadreckon.policies.library import about, library_tasks
from deadreckon.progress import Progress
from deadreckon.tasks import adroit, antmaze, flow, gym_mujoco, kitchen, maze2d, registry
from deadreckon.tasks.adroit import Adroit
from deadreckon.tasks.antmaze import AntMaze
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.gym_mujoco import GymMujoco
from deadreckon.tasks.kitchen import Kitchen
from deadreckon.tasks.maze2d import Maze2D
from deadreckon.tasks.task import Task

# ---- Maze2D -----------------------------------------------------------------------------------------------------------


def _maze2d(task: Maze2D) -> Recipe:
    def make(
        *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        from deadreckon.collect.maze2d import collect_maze2d

        return collect_maze2d(task, name=name, steps=steps, seed=seed, threads=threads, progress=progress)

    known = entry(f"{task.name}-v1")
    return Recipe(known.recipe, task.name, known.rows, make, "waypoints of a planner to random targets, PD control")


for _task in maze2d.TASKS:
    assert registry.task(_task.name) is _task
    register(_maze2d(_task))


# ---- Gym-MuJoCo -------------------------------------------------------------------------------------------------------

_GYM = {
    "random": "a randomly initialised policy",
    "uniform": "actions drawn uniformly between the bounds",
    "medium": "SAC, stopped early",
    "expert": "SAC, the best of its run",
    "medium-expert": "first medium, then expert",
    "uniform-expert": "first uniform actions, then expert",
    "medium-replay": "all that SAC did until medium, by training again",
}


def _gym(task: GymMujoco, kind: str, summary: str) -> Recipe:
    def make(
        *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        from deadreckon.collect.gym import collect_gym, collect_replay

        options = {"name": name, "steps": steps, "seed": seed, "threads": threads, "scratch": scratch, "progress": progress}
        return collect_replay(task, **options) if kind == "medium-replay" else collect_gym(task, kind, **options)

    known = entry(f"{task.name}-{kind}-v2")
    # The replay buffer is as long as our own run took to get to medium, whatever the original's length.
    ours = kind == "medium-replay" and task.name in library_tasks()
    rows = about(task.name)["medium_replay"]["environment_steps"] if ours else known.rows
    return Recipe(known.recipe, task.name, rows, make, summary)


for _task in gym_mujoco.TASKS:
    for _kind, _summary in _GYM.items():
        if f"{_task.name}-{_kind}-v2" in ENTRIES:
            register(_gym(_task, _kind, _summary))


def _of_the_catalogue(name: str, task: Task, make: Maker, summary: str) -> Recipe:
    """The recipe of a log that the catalogue has, with as many rows."""
    known = entry(name)
    return Recipe(known.recipe, task.name, known.rows, make, summary)


# ---- Flow -------------------------------------------------------------------------------------------------------------

_FLOW = {"random": "accelerations drawn uniformly between the bounds", "controller": "the intelligent driver model"}


def _flow(task: Flow, kind: str, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.flow import collect_flow

        return collect_flow(task, kind, **options)

    return _of_the_catalogue(f"{task.name}-{kind}-v0", task, make, summary)


for _task in flow.TASKS:
    for _kind, _summary in _FLOW.items():
        register(_flow(_task, _kind, _summary))


# ---- Adroit -----------------------------------------------------------------------------------------------------------

_ADROIT = {
    "human": "people: 25 demonstrations",
    "cloned": "half people, over and over, half a clone of them by behaviour cloning",
    "expert": "the policy that DAPG trained",
}


def _adroit(task: Adroit, kind: str, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.adroit import collect_adroit

        return collect_adroit(task, kind, **options)

    return _of_the_catalogue(f"{task.name}-{kind}-v1", task, make, summary)


for _task in adroit.TASKS:
    for _kind, _summary in _ADROIT.items():
        register(_adroit(_task, _kind, _summary))


# ---- FrankaKitchen ----------------------------------------------------------------------------------------------------

_KITCHEN = {
    "complete": "a scripted demonstrator: the four sub-tasks in order, always with success",
    "partial": "a scripted demonstrator: four sub-tasks of six at random, in one episode of four the task's",
    "mixed": "a scripted demonstrator: four sub-tasks of six at random, never all of the task's",
}


def _kitchen(task: Kitchen, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.kitchen import collect_kitchen

        return collect_kitchen(task, **options)

    return _of_the_catalogue(f"{task.name}-v0", task, make, summary)


for _task in kitchen.TASKS:
    register(_kitchen(_task, _KITCHEN[_task.name.removeprefix("kitchen-")]))


# ---- AntMaze ----------------------------------------------------------------------------------------------------------

_ANTMAZE = {
    "play": "a planner's waypoints to hand-picked cells, one after the other, from anywhere; a walker with noise",
    "diverse": "a planner's waypoints to random cells, one after the other, from anywhere; a walker with noise",
}


def _antmaze(task: AntMaze) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.antmaze import collect_antmaze

        return collect_antmaze(task, **options)

    summary = _ANTMAZE.get(task.name.rsplit("-", 1)[1], "a planner's waypoints from the start to the goal; a walker with noise")
    return _of_the_catalogue(f"{task.name}-v2", task, make, summary)


for _task in antmaze.TASKS:
    register(_antmaze(_task))
