"""Steps of simulation that an online run took, to learn and apart from that in its evaluations, and how it went in between."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from deadreckon.online import Online


class Simulated(NamedTuple):
    """Steps of each seed.

    Attributes:
        learning: that the agent took, the random ones among them.
        evaluating: of the evaluations.
        evaluations: how many of these there were.
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
        evaluations: its table of evaluations, a row an episode, by column.
    """
    steps = np.asarray(evaluations["step"])
    lengths = np.asarray(evaluations["length"])
    taken = Online(**config["online"]).steps(int(steps.max()))
    return Simulated(taken, round(lengths.sum() / len(config["seeds"])), len(np.unique(steps)))


class Course(NamedTuple):
    """Mean returns of an online run: of the policy that it began with, the lowest since, and the last.

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
    """How an online run went; arguments as for `simulated`."""
    step, returns = np.asarray(evaluations["step"]), np.asarray(evaluations["return"])
    steps = np.unique(step)
    means = np.array([returns[step == each].mean() for each in steps])
    lowest = int(means.argmin())
    after = Online(**config["online"]).steps(int(steps[lowest]))
    return Course(float(means[0]), float(means[lowest]), after, float(means[-1]))
