"""The tasks by name. Importing this loads neither MuJoCo nor Gymnasium."""

from deadreckon.data import terminations
from deadreckon.data.catalogue import ENTRIES
from deadreckon.errors import UserError, unknown
from deadreckon.tasks import adroit, antmaze, battery, flow, gym_mujoco, kitchen, maze2d
from deadreckon.tasks.task import Task

_TASKS: dict[str, Task] = {}


def task(name: str) -> Task:
    """The task of that name, such as `maze2d-umaze`.

    Raises:
        UserError: there is none; the message names the nearest.
    """
    try:
        return _TASKS[name]
    except KeyError:
        raise unknown("task", name, _TASKS) from None


def of_log(name: str) -> Task | None:
    """The task of a log that the catalogue knows, by the log's name; None for others."""
    known = ENTRIES.get(name.split("@")[0])
    return None if known is None else task(known.task)


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
for _task in (*_MANY, battery.TASK):
    register(_task)
