"""Measures the values of policies: episodes in batches until the error is small, policies in parallel."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.policies import store
from deadreckon.policies.library import Returns
from deadreckon.policies.policy import BlackBoxPolicy
from deadreckon.runs.evaluate import evaluate
from deadreckon.tasks.registry import task as find_task

DISCOUNT = 0.995  # DOPE's


@dataclass(kw_only=True)
class Measuring:
    """Settings for measuring policies."""

    episodes: int = 1000  # episodes of a policy, in each mode (sampled or greedy)
    error: float = 0.666  # standard error of the discounted return below which measuring stops (thesis 8.2)
    most: int = 1000  # episodes at most, whatever the error
    seed: int = 1_000_000  # of the episodes; training evaluates on others
    processes: int = 1  # processes that measure policies in parallel; results do not depend on their number


def measured_enough(
    task: str, wanted: Mapping[tuple[str, str], Path | None], known: Mapping[tuple[str, str], Returns], options: Measuring,
    keep: Callable[[str, str, Returns], None],
) -> dict[tuple[str, str], Returns]:  # fmt: skip
    """Measures the returns of policies in a task.

    Args:
        task: the task.
        wanted: files of policies by (key, mode), with mode `sampled` or `greedy`; None as a file: uniform actions.
        known: earlier measurements, which are continued.
        options: settings.
        keep: called with key, mode and the results so far, after each batch of episodes.

    Returns:
        Results for all entries of `wanted`, by (key, mode).

    Raises:
        UserError: fewer than one process, or than two episodes, which a standard error needs.
    """
    if options.processes < 1:
        raise UserError(f"processes must be 1 or more, got {options.processes}")
    if options.episodes < 2:
        raise UserError(f"episodes must be 2 or more, got {options.episodes}")
    found = dict(known)
    with _side_by_side(options.processes) as each:
        while todo := [which for which in wanted if which not in found or not _enough(found[which], options)]:
            jobs = [(which, wanted[which], task, found.get(which), options) for which in todo]
            for (key, mode), returns in each(jobs):
                found[key, mode] = returns
                keep(key, mode, returns)
    return {which: found[which] for which in wanted}


@contextmanager
def _side_by_side(processes: int) -> Iterator[Callable[[list[Any]], Iterator[Any]]]:
    """A function that runs jobs, in this process or in several others, and yields their results as they come."""
    if processes == 1:
        yield lambda jobs: map(_job, jobs)
        return
    pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=_end_with, initargs=(os.getpid(),))
    try:
        yield lambda jobs: (done.result() for done in as_completed([pool.submit(_job, job) for job in jobs]))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _end_with(parent: int) -> None:
    """Ends this process at an interrupt, and when its parent has ended, even if that was killed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _job(job: tuple[tuple[str, str], Path | None, str, Returns | None, Measuring]) -> tuple[tuple[str, str], Returns]:
    which, file, task, before, options = job
    return which, _measure(file, task, which[1] == "greedy", before, options)


def _enough(returns: Returns, options: Measuring) -> bool:
    small = returns.discounted_error < options.error
    return returns.episodes >= options.episodes and (small or returns.episodes + options.episodes > options.most)


def _uniform(task: str) -> BlackBoxPolicy:
    space = find_task(task).action_space
    assert isinstance(space, Box)
    return BlackBoxPolicy(lambda seen, rng: rng.uniform(space.low, space.high, (len(seen), space.size)))


def _measure(file: Path | None, task: str, greedy: bool, before: Returns | None, options: Measuring) -> Returns:
    """`before` with a further batch of episodes from new starts; a first batch that is incomplete is completed.

    Without a file actions are uniform.
    """
    policy = _uniform(task) if file is None else store.load(file)
    done = before.episodes if before else 0
    batch = options.episodes - done if done < options.episodes else options.episodes
    found = evaluate(policy, find_task(task), episodes=batch, seed=options.seed + done, greedy=greedy, discount=DISCOUNT)
    mean, error = _joined(done, (before.mean, before.error) if before else (0.0, 0.0), found.returns[0])
    known = (before.discounted, before.discounted_error) if before else (0.0, 0.0)
    worth, worth_error = _joined(done, known, found.discounted[0])
    count, steps = done + batch, found.lengths.sum() + (before.length * done if before else 0.0)
    return Returns(count, mean, error, worth, worth_error, DISCOUNT, float(steps / count))


def _joined(done: int, before: tuple[float, float], more: np.ndarray) -> tuple[float, float]:
    """Mean and standard error of `done` numbers, given by theirs, together with further numbers."""
    mean, error = before
    count = done + len(more)
    shift = float(more.mean()) - mean
    within = error**2 * done * max(done - 1, 0) + float(np.square(more - more.mean()).sum())
    squares = within + shift**2 * done * len(more) / count
    return mean + shift * len(more) / count, float(np.sqrt(squares / (count - 1) / count))
