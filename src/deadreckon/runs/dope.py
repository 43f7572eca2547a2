"""The DOPE protocol over tasks and logs; missing logs are collected."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, Unpack, get_args

from deadreckon.collect import collect, recipe
from deadreckon.collect.recipes import default_path
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import read
from deadreckon.errors import UserError, unknown
from deadreckon.ope.dope import UNPLUGGED, DopeOptions, DopeSettings, Result, evaluate_log, of_unplugged
from deadreckon.ope.registry import as_estimators
from deadreckon.policies import library
from deadreckon.progress import Watcher, unwatched
from deadreckon.tasks.control import TASKS as CONTROL

Half = Literal["d4rl", "unplugged"]
KINDS = ("random", "medium", "expert", "medium-replay", "medium-expert")


def dope(
    estimators: Sequence[Any],
    tasks: Sequence[str] | None = None,
    kinds: Sequence[str] = KINDS,
    *,
    half: Half = "d4rl",
    logs: Sequence[str] = (),
    log_steps: int | None = None,
    seeds: int = 1,
    collecting: Watcher = unwatched,
    **options: Unpack[DopeOptions],
) -> list[Result]:
    """Estimates the values of the policies of tasks from their logs; the true values are known.

    `deadreckon.ope.dope.markdown(results, "regret")` makes a table of the results, `deadreckon.report.dope.write_bench` a page.

    Args:
        estimators: names, `Estimator` objects, or functions `fn(data, policies, discount) -> values`.
        tasks: whose policies and logs are used; None: hopper, or with `unplugged` all tasks that have policies.
        kinds: of logs, for half `d4rl`.
        half: of DOPE, `d4rl` (here tasks of Gym-MuJoCo with logs of several kinds; others by `logs`) or `unplugged`
            (dm_control: one log per task, on which its policies were trained).
        logs: names of the catalogue such as `maze2d-umaze-dense-v1` or `door-human-v1`, instead of tasks and kinds.
        log_steps: rows of the logs; None: all.
        seeds: number of fits of each.
        collecting: called while a log is collected, with its name, steps done and steps in all.
        **options: `seed` (of several fits the first), `out`, `watch` and `told`; see `ope.dope.DopeSettings`.

    Raises:
        UserError: unknown estimators, tasks, kinds, halves or logs, no log, or seeds out of range; raised before anything else.
    """
    settings = DopeSettings.of(options)
    first, estimators = settings.seed, as_estimators(estimators)
    if seeds < 1 or first < 0 or first + seeds > 2**32:
        raise UserError(f"seeds must be 1 or more, and all of them 0 .. 2^32 - 1, got {seeds} from {first}")
    recipes = [recipe(name) for name in logs or _logs_of(half, tasks, kinds)]
    if not recipes:
        raise UserError("no log is selected: name a task, and of half d4rl also a kind of its logs")
    for each in recipes:
        library.library(each.task)
    results = []
    for name, task, path in [(each.name, each.task, default_path(each, log_steps, 0)) for each in recipes]:
        if not path.exists():
            collect(name, steps=log_steps, out=path, progress=partial(collecting, name))
        data = read(path)
        _check_taught(task, data, log_steps)
        for seed in range(first, first + seeds):
            results += evaluate_log(data, task, estimators, **vars(replace(settings, seed=seed)))
    return results


def _logs_of(half: str, tasks: Sequence[str] | None, kinds: Sequence[str]) -> list[str]:
    if half not in get_args(Half):
        raise unknown("half of DOPE", half, get_args(Half))
    if half == "d4rl":
        return [f"{task}-{kind}-v2" for task in (("hopper",) if tasks is None else tasks) for kind in kinds]
    known = [task.name for task in CONTROL if task.name in library.library_tasks()]
    if tasks is None and not known:
        raise UserError("there are no policies of dm_control's tasks; `python tools/unplugged_policies.py` makes them")
    return [f"{task}{UNPLUGGED}" for task in (known if tasks is None else tasks)]


def _check_taught(task: str, data: Dataset, log_steps: int | None) -> None:
    """Warns if a task's policies were trained on a log of this name that differs from `data`."""
    taught = library.about(task)["run"].get("data")
    if taught and log_steps is None and of_unplugged(data.name) and taught["fingerprint"] != data.fingerprint:
        warnings.warn(
            f"{data.name} is not the log on which the policies of {task} were trained, but another of the same kind",
            stacklevel=3,
        )
