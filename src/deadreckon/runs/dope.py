"""The DOPE protocol over tasks and logs, which are collected where they are not there yet."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from deadreckon.collect import collect, recipe
from deadreckon.collect.recipes import default_path
from deadreckon.data.formats.io import read
from deadreckon.errors import UserError
from deadreckon.ope.dope import Result, evaluate_log
from deadreckon.ope.registry import as_estimator
from deadreckon.policies import library
from deadreckon.progress import Watcher, unwatched

KINDS = ("random", "medium", "expert", "medium-replay", "medium-expert")


def dope(
    estimators: Sequence[Any],
    tasks: Sequence[str] = ("hopper",),
    kinds: Sequence[str] = KINDS,
    *,
    logs: Sequence[str] = (),
    log_steps: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    out: Path | str | None = None,
    collecting: Watcher = unwatched,
    watch: Watcher = unwatched,
    told: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Estimates the eleven policies of tasks from logs of theirs, whose true values are known.

    `deadreckon.ope.dope.markdown(results, "regret")` makes a table of the results, `deadreckon.report.dope.write_bench` a page.

    Args:
        estimators: names, `Estimator` objects, or functions `fn(data, policies, discount) -> values`.
        tasks: whose policies and logs.
        kinds: of logs.
        logs: names of the catalogue such as `maze2d-umaze-dense-v1` or `door-human-v1`, in the place of tasks and kinds.
        log_steps: rows of the logs; None: all.
        seeds: how many fits of each.
        seed: random seed; of several fits the first.
        out: folder for results and checkpoints; results that are there are not computed again.
        collecting: called while a log is collected, with its name, steps done and steps in all.
        watch: called while something is fitted.
        told: called with every result.

    Raises:
        UserError: unknown estimators, tasks, kinds or logs, or seeds out of range, before anything is begun.
    """
    found = [as_estimator(each) for each in estimators]
    if seeds < 1 or seed < 0 or seed + seeds > 2**32:
        raise UserError(f"seeds must be 1 or more, and all of them 0 .. 2^32 - 1, got {seeds} from {seed}")
    recipes = [recipe(name) for name in logs or [f"{task}-{kind}-v2" for task in tasks for kind in kinds]]
    for each in recipes:
        library.library(each.task)
    results = []
    for name, task, path in [(each.name, each.task, default_path(each, log_steps, 0)) for each in recipes]:
        if not path.exists():
            collect(name, steps=log_steps, out=path, progress=partial(collecting, name))
        data = read(path)
        for number in range(seed, seed + seeds):
            results += evaluate_log(data, task, found, seed=number, out=out, watch=watch, told=told)
    return results
