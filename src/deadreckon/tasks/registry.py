"""The tasks by name, and Gymnasium environments as tasks. Importing this loads neither MuJoCo nor Gymnasium."""

import importlib
import sys
from typing import Any

from deadreckon.data import terminations
from deadreckon.data.entries import ENTRIES, ORIGINAL
from deadreckon.errors import UserError, unknown
from deadreckon.tasks import adroit, antmaze, battery, carla_task, control, driving, flow, gym_mujoco, kitchen, maze2d, town
from deadreckon.tasks.pixels import SUFFIX, of_pixels
from deadreckon.tasks.task import Task

_TASKS: dict[str, Task] = {}


def task(given: Any, horizon: int | None = None) -> Task:
    """The task that is meant.

    Args:
        given: a task or its name, such as `maze2d-umaze`, with `:pixels` behind it for pictures of it; a Gymnasium
            environment, its id, such as `Pendulum-v1` or `gymnasium:Pendulum-v1`, or what makes one: a function, or the name
            `module:Class` of one. See `tasks.gymnasium_task`. `carla:HOST:PORT/lane` is driven in a CARLA server; see
            `tasks.carla_task`.
        horizon: of an environment, steps after which an episode times out; None: its own limit.

    Raises:
        UserError: there is none of this name, in which case the message names the nearest; or it is no environment that can be
            a task.
    """
    if isinstance(given, str) and given not in _TASKS and given.endswith(SUFFIX):
        return of_pixels(task(given.removesuffix(SUFFIX), horizon))
    known = given if isinstance(given, Task) else _TASKS.get(given) if isinstance(given, str) else None
    if known is not None:
        return _without(known, horizon)
    if isinstance(given, str) and given.startswith(carla_task.PREFIX):
        return _without(carla_task.named(given), horizon)
    environments = importlib.import_module("deadreckon.tasks.gymnasium_task")  # which loads Gymnasium
    if not isinstance(given, str):
        return environments.of(given, horizon)
    if (found := environments.named(given, horizon)) is None:
        raise UserError(f"{unknown('task', given, _TASKS)}; a Gymnasium environment is named gymnasium:ID")
    return found


def _without(known: Task, horizon: int | None) -> Task:
    if horizon is not None:
        raise UserError(f"{known.name} has a horizon of its own, {known.horizon} steps; leave the other out")
    return known


def of_run(name: str) -> Task:
    """The task that a run's folder names.

    Raises:
        UserError: it is of a module that has not been imported, or in a CARLA server: a folder from elsewhere must not name
            code that runs, or a machine that is talked to.
    """
    if name.startswith(carla_task.PREFIX):
        raise UserError(f"the run's task is in a CARLA server, {name}: name it, or another one, with --task")
    path = name.removesuffix(SUFFIX).partition("?")[0].removeprefix("gymnasium:")
    module = path.partition(":")[0]
    if name not in _TASKS and ":" in path and module not in sys.modules:
        raise UserError(f"the run's task is {name}, not one of deadreckon's: name it with --task, or import {module} first")
    return task(name)


def of_log(name: str) -> Task | None:
    """The task of a log that the catalogue knows, by the log's name; None for others, and for originals of another world."""
    stem, _, version = name.partition("@")
    known = ENTRIES.get(stem)
    if known is None or known.task is None or (known.elsewhere and version == ORIGINAL):
        return None
    return task(known.task)


def names() -> list[str]:
    """All task names, in the order in which they were registered."""
    return list(_TASKS)


def register(task: Task) -> None:
    """Adds a task of one's own; `task(task.name)` then finds it."""
    if task.name in _TASKS:
        raise UserError(f"task {task.name!r} is registered already")
    _TASKS[task.name] = task
    if task.ends is not None:
        terminations.register(terminations.Termination(task.name, task.observation_shape, task.ends))


_MANY = *maze2d.TASKS, *antmaze.TASKS, antmaze.REACH_TASK, *gym_mujoco.TASKS, *adroit.TASKS, *kitchen.TASKS, *flow.TASKS
for _task in (*_MANY, *driving.TASKS, *town.TASKS, *control.TASKS, battery.TASK):
    register(_task)
