"""The DOPE protocol over tasks and logs, which are collected where they are not there yet."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

from deadreckon.collect import collect, recipe
from deadreckon.collect.recipes import default_path
from deadreckon.data.formats.io import read
from deadreckon.errors import UserError
from deadreckon.ope.dope import DopeOptions, DopeSettings, Result, evaluate_log
from deadreckon.ope.registry import as_estimators
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
    collecting: Watcher = unwatched,
    **options: Unpack[DopeOptions],
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
        collecting: called while a log is collected, with its name, steps done and steps in all.
        **options: `seed` (of several fits the first), `out`, `watch` and `told`; see `ope.dope.DopeSettings`.

    Raises:
        UserError: unknown estimators, tasks, kinds or logs, or seeds out of range, before anything is begun.
    """
    settings = DopeSettings.of(options)
    first, estimators = settings.seed, as_estimators(estimators)
    if seeds < 1 or first < 0 or first + seeds > 2**32:
        raise UserError(f"seeds must be 1 or more, and all of them 0 .. 2^32 - 1, got {seeds} from {first}")
    recipes = [recipe(name) for name in logs or [f"{task}-{kind}-v2" for task in tasks for kind in kinds]]
    for each in recipes:
        library.library(each.task)
    results = []
    for name, task, path in [(each.name, each.task, default_path(each, log_steps, 0)) for each in recipes]:
        if not path.exists():
            collect(name, steps=log_steps, out=path, progress=partial(collecting, name))
        data = read(path)
        for seed in range(first, first + seeds):
            results += evaluate_log(data, task, estimators, **vars(replace(settings, seed=seed)))
    return results
