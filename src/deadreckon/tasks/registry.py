"""The tasks by name, and their Gymnasium ids. Importing this loads neither MuJoCo nor Gymnasium."""

import importlib.abc
import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

from deadreckon.errors import UserError, unknown
from deadreckon.tasks import maze2d
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


def names() -> list[str]:
    """All task names, in the order in which they were registered."""
    return list(_TASKS)


def register(task: Task) -> None:
    """Adds a task of one's own; `task(task.name)` then finds it."""
    if task.name in _TASKS:
        raise UserError(f"task {task.name!r} is registered already")
    _TASKS[task.name] = task


for _task in maze2d.TASKS:
    register(_task)


# ---- Gymnasium --------------------------------------------------------------------------------------------------------


def register_envs() -> None:
    """Makes `gymnasium.make("deadreckon/Maze2D-UMaze-v1")` and its kin work; imports gymnasium."""
    from gymnasium.envs.registration import register, registry

    for task in maze2d.TASKS:
        if task.gym_id not in registry:
            register(
                task.gym_id,
                "deadreckon.tasks.maze2d_env:Maze2DEnv",
                max_episode_steps=task.horizon,
                kwargs={"task": task.name},
            )


class _AfterGymnasium(importlib.abc.MetaPathFinder):
    """Calls `register_envs` at the end of whatever import of gymnasium comes first.

    Gymnasium has no entry points for plug-ins, and importing it here would cost every command 150 ms.
    """

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            sys.meta_path.insert(0, self)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            sys.meta_path.remove(self)
            register_envs()

        spec.loader.exec_module = execute_and_register
        return spec


def register_envs_lazily() -> None:
    """Registers the ids now if gymnasium is loaded, else as soon as someone imports it."""
    if "gymnasium" in sys.modules:
        register_envs()
    elif not any(isinstance(finder, _AfterGymnasium) for finder in sys.meta_path):
        sys.meta_path.insert(0, _AfterGymnasium())
