"""Checked scores of a method by task, for tables and comparisons."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deadreckon.errors import UserError

# A method's scores: task -> (seeds,), or one (seeds,) a task, or a matrix (seeds, tasks). Only a matrix is an ndarray.
Scores = Mapping[str, ArrayLike] | Sequence[ArrayLike] | np.ndarray


def by_task(scores: Scores, whose: str = "the scores", *, stacked: bool = False) -> dict[Any, np.ndarray]:
    """Checked scores: task's name or number -> (seeds,), or (..., seeds) if `stacked`.

    Raises:
        UserError: no task, no run, another form, or numbers that are not finite; `whose` names the scores.
    """
    if isinstance(scores, Mapping):
        items = list(scores.items())
    elif isinstance(scores, np.ndarray) and scores.ndim != 2:
        raise UserError(f"{whose} as a matrix must be (seeds, tasks), got shape {scores.shape}; of one task, give [scores]")
    elif isinstance(scores, (np.ndarray, Sequence)) and not isinstance(scores, (str, bytes)):
        items = list(enumerate(scores.T if isinstance(scores, np.ndarray) else scores))
    else:
        wanted = "a mapping of tasks to runs, one array of runs a task, or a (seeds, tasks) matrix"
        raise UserError(f"{whose} must be {wanted}, got {type(scores).__name__}")
    if not items:
        raise UserError(f"{whose} have no task: give at least one, with at least one run")
    found = {name: numbers(values, f"{whose} of task {name!r}", stacked) for name, values in items}
    if len({x.shape[:-1] for x in found.values()}) > 1:
        raise UserError(f"{whose} must have the same leading axes in all tasks, got {[x.shape for x in found.values()]}")
    return found


def numbers(values: ArrayLike, what: str, stacked: bool) -> np.ndarray:
    """Finite numbers (runs,), or (..., runs) if `stacked`.

    Raises:
        UserError: something else; `what` names the numbers.
    """
    try:
        runs = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{what} must be numbers, got {str(values)[:40]!r}") from error
    if runs.ndim < 1 or (runs.ndim > 1 and not stacked):
        raise UserError(f"{what} must be a list of numbers, got shape {runs.shape}")
    if not runs.shape[-1]:
        raise UserError(f"{what} are empty: give at least one number")
    if not np.isfinite(runs).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(runs))[0])
        raise UserError(f"{what} must be finite, got {runs[where]} at place {where[-1]}")
    return runs


def pairs_of(ours: Scores, theirs: Scores) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """(task, our runs, their runs) of every task, matched by name, or by position if there are no names.

    Raises:
        UserError: different tasks, or what `by_task` raises.
    """
    x, y = by_task(ours, "our scores"), by_task(theirs, "their scores")
    same_tasks(x, y, "ours", "theirs")
    return [(task, x[task], y[task]) for task in x]


def same_tasks(x: Mapping[Any, Any], y: Mapping[Any, Any], first: str, second: str) -> None:
    """Refuses two methods whose tasks differ.

    Raises:
        UserError: names the first task that one lacks.
    """
    for one, other, has, lacks in ((x, y, first, second), (y, x, second, first)):
        extra = [task for task in one if task not in other]
        if extra:
            raise UserError(f"both must have the same tasks, but {has} has {extra[0]!r} and {lacks} has not")


def check_level(level: float, name: str = "level") -> None:
    """Refuses levels of intervals and of significance that are not between 0 and 1.

    Raises:
        UserError: in one line.
    """
    if not 0.0 < level < 1.0:
        raise UserError(f"{name} must lie between 0 and 1, got {level}")
