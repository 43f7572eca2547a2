"""The tasks by name, and Gymnasium environments as tasks. Importing this loads neither MuJoCo nor Gymnasium."""

import contextlib
import dataclasses
import importlib
import math
import re
import sys
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.data import terminations
from deadreckon.data.entries import task_of
from deadreckon.errors import UserError, unknown
from deadreckon.imports import trusted
from deadreckon.tasks import adroit, antmaze, battery, carla_task, control, driving, flow, gym_mujoco, kitchen, maze2d, town
from deadreckon.tasks.gymnasium_names import array_text, options_of
from deadreckon.tasks.pixels import SUFFIX, of_pixels
from deadreckon.tasks.task import Task, keeping_horizon

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
        return keeping_horizon(known, horizon)
    if isinstance(given, str) and given.startswith(carla_task.PREFIX):
        return keeping_horizon(carla_task.named(given), horizon)
    environments = importlib.import_module("deadreckon.tasks.gymnasium_task")  # which loads Gymnasium
    if not isinstance(given, str):
        return environments.of(given, horizon)
    if (found := environments.named(given, horizon)) is None:
        raise UserError(f"{unknown('task', given, _TASKS)}; a Gymnasium environment is named gymnasium:ID")
    return found


def own_fields(given: Task) -> dict[str, Any]:
    """The fields in which a task differs from the one that its name finds, as JSON values; none where its name tells it.

    Such a task is an object that a user has made, as by `dataclasses.replace`. Where its name finds none, these are all of its
    fields. Functions and other objects are known by their names, and arrays by a digest.
    """
    if given is _TASKS.get(given.name):
        return {}
    own, found = _told(given), {}
    with contextlib.suppress(UserError), warnings.catch_warnings(action="ignore"):  # they have been shown already
        found = _told(task(given.name))
    return {name: value for name, value in own.items() if name not in found or found[name] != value}


def registered_fields(given: Task) -> dict[str, Any]:
    """All fields of a task whose name a user has registered, as JSON values like `own_fields`; none of other tasks.

    Another process may register another task under the same name.
    """
    name = given.name.removesuffix(SUFFIX)
    return _told(given) if name in _TASKS and name not in _OURS else {}


def _told(value: Any) -> Any:
    """A task, or what its fields hold, as JSON values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = {each.name: _told(getattr(value, each.name)) for each in dataclasses.fields(value) if each.compare}
        return {"class": _told(type(value))} | own
    if isinstance(value, Mapping):
        return {str(key): _told(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_told(each) for each in value]
    if isinstance(value, set | frozenset):
        return sorted(map(_told, value), key=str)  # their order differs from process to process
    if isinstance(value, np.ndarray):
        return array_text(value)
    if value is None or isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    name = getattr(value, "__qualname__", None)
    # Where an object lies in memory differs from process to process.
    return re.sub(" at 0x[0-9a-f]+", "", repr(value)) if name is None else f"{value.__module__}:{name}"


def of_run(name: str) -> Task:
    """The task that a run's folder names.

    Raises:
        UserError: as `check_named` says.
    """
    check_named(name, "the run's task", "name it with --task")
    return task(name)


def check_named(name: str, what: str, remedy: str) -> None:
    """Refuses a task that a file names where making it would run code, open files or talk to a machine of the file's choice.

    Of other packages a file may name environments by their ids, and tasks and classes of environments, in modules that are
    imported already; all else in modules that the user trusts (`imports.trust`). Options are numbers, truths and words.

    Args:
        name: of the task, as a file has it.
        what: it is, for the error.
        remedy: what the user can do, for the error.

    Raises:
        UserError: it is none of these.
    """
    stem = name.removesuffix(SUFFIX)
    if stem in _TASKS:
        return
    if name.startswith(carla_task.PREFIX):
        raise UserError(f"{what} is in a CARLA server, {name}: {remedy}")
    path, _, text = stem.partition("?")
    if len(name) > LONGEST:
        raise UserError(f"{what} has a name of {len(name):,} characters; {LONGEST} are allowed")
    module, colon, attribute = path.removeprefix("gymnasium:").partition(":")
    if colon and trusted(module):
        return
    if any(_is_path(value) for value in options_of(name, text).values()):
        raise UserError(f"{what} is {name}: a file may not give an environment the path of another file; {remedy}")
    if not colon:
        return
    refused = f"{what} is {name}, not one of deadreckon's: {remedy}"
    if module not in sys.modules:
        raise UserError(f"{refused}, or import {module} first")
    if not path.startswith("gymnasium:") and not _is_world(getattr(sys.modules[module], attribute, None)):
        why = f"{attribute} of {module} is no class of environments, and its code could do anything"
        raise UserError(f"{refused}; {why} (deadreckon.imports.trust allows it)")


LONGEST = 1000  # characters of a name that a file gives


def _is_path(value: Any) -> bool:
    """Whether an option, or anything in it, is a text that leads to another folder."""
    if isinstance(value, Mapping):
        return any(map(_is_path, [*value, *value.values()]))
    if isinstance(value, list | tuple | set | frozenset):
        return any(map(_is_path, value))
    text = value.decode(errors="replace") if isinstance(value, bytes) else value
    return isinstance(text, str) and (any(sign in text for sign in "/\\:") or text.startswith(("~", "..")))


def _is_world(found: Any) -> bool:
    """Whether it is a task, or a class of environments."""
    gymnasium = sys.modules.get("gymnasium")
    return isinstance(found, Task) or (
        gymnasium is not None and isinstance(found, type)
        and issubclass(found, gymnasium.Env) and not issubclass(found, gymnasium.Wrapper)
    )  # fmt: skip


def of_log(name: str) -> Task | None:
    """The task of a log that the catalogue knows, by the log's name; None for others, and for originals of another world."""
    known = task_of(name)
    return None if known is None else task(known)


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
_OURS = frozenset(_TASKS)  # the names of the package's own
