"""Episodes side by side as far as a task can have copies, and in turns beyond."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from deadreckon.tasks.task import Simulator, Task


def turns(task: Task, episodes: int) -> list[np.ndarray]:
    """Which episodes run side by side, one turn after the other: all of them, where the task does not limit copies."""
    most = task.most_copies or episodes
    return [np.arange(first, min(first + most, episodes)) for first in range(0, episodes, most)]


@contextlib.contextmanager
def simulating(task: Task, seeds: Sequence[int], threads: int | None = None) -> Iterator[Simulator]:
    """A simulator of the first turn's copies, which is closed at the end, however that comes, if it is to be closed."""
    chosen = () if threads is None else (threads,)  # a user's task may take seeds alone
    simulator: Any = task.simulate(seeds[: task.most_copies], *chosen)
    try:
        yield simulator
    finally:
        if hasattr(simulator, "close"):
            simulator.close()


def begun(simulator: Simulator, turn: np.ndarray, seeds: Sequence[int]) -> np.ndarray:
    """First observations (turn, *shape) of the episodes of a turn; copies beyond these rest.

    Args:
        simulator: of the first turn's copies, none of whose episodes is under way.
        turn: which episodes.
        seeds: of all episodes.
    """
    if turn[0] == 0:
        return simulator.reset()
    return simulator.reset(np.arange(len(turn)), [seeds[i] for i in turn])


def first_observations(task: Task, seeds: Sequence[int]) -> np.ndarray:
    """(episodes, *shape) what the first episodes of copies with these seeds begin with."""
    with simulating(task, seeds) as simulator:
        return np.concatenate([begun(simulator, turn, seeds) for turn in turns(task, len(seeds))])
