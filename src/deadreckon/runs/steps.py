"""Simulation steps of an online run, in training and in its evaluations, and its returns over time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from deadreckon.online import Online


class Simulated(NamedTuple):
    """Simulation steps per seed.

    Attributes:
        learning: in training, including random ones.
        evaluating: in evaluations.
        evaluations: number of evaluations.
    """

    learning: int
    evaluating: int
    evaluations: int

    def __str__(self) -> str:
        learning = f"{self.learning:,} environment steps per seed in training"
        return f"{learning}, {self.evaluating:,} in {self.evaluations} evaluations"


def simulated(config: Mapping[str, Any], evaluations: Mapping[str, np.ndarray]) -> Simulated:
    """The steps of an online run.

    Args:
        config: its `run.json`.
        evaluations: columns of its table of evaluations, which has one row per episode.
    """
    steps = np.asarray(evaluations["step"])
    lengths = np.asarray(evaluations["length"])
    taken = Online(**config["online"]).steps(int(steps.max()))
    return Simulated(taken, round(lengths.sum() / len(config["seeds"])), len(np.unique(steps)))


class Course(NamedTuple):
    """Mean returns of an online run: of its initial policy, the lowest one, and of the last policy.

    Attributes:
        first, lowest, last: over seeds and episodes.
        after: environment steps before the lowest.
    """

    first: float
    lowest: float
    after: int
    last: float

    def __str__(self) -> str:
        fall = f", lowest {self.lowest:.1f} after {self.after:,} steps" if self.lowest < self.first else ", never below that"
        return f"from return {self.first:.1f} at the start{fall}, to {self.last:.1f}"


def course(config: Mapping[str, Any], evaluations: Mapping[str, np.ndarray]) -> Course:
    """Mean returns of an online run over time; arguments as for `simulated`."""
    step, returns = np.asarray(evaluations["step"]), np.asarray(evaluations["return"])
    steps = np.unique(step)
    means = np.array([returns[step == each].mean() for each in steps])
    lowest = int(means.argmin())
    after = Online(**config["online"]).steps(int(steps[lowest]))
    return Course(float(means[0]), float(means[lowest]), after, float(means[-1]))
