"""How logs of driving are made: a controller, clean or with noise; along a lane pure pursuit at a steady speed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.collect.growing_log import collected
from deadreckon.collect.rollouts import COPIES, Segment, StatefulController, collect_rollouts
from deadreckon.data.catalogue import version_of
from deadreckon.data.dataset import Dataset
from deadreckon.devices import acting_platform
from deadreckon.progress import Progress
from deadreckon.tasks.car import actions_for
from deadreckon.tasks.driving import AHEAD, HEADING, OFFSET, SPEED
from deadreckon.tasks.pixels import Pixels, PixelSimulator
from deadreckon.tasks.task import Task

CRUISE = 20.0 / 3.6  # m/s, the speed of CARLA's local planner
LOOK = 6.0  # m, how far before the car it steers for
EAGER = 4.0  # m/s² for each m/s by which it is too slow or too fast
NOISE = 0.3  # standard deviation of what is added to actions in the noisy log
KINDS = ("controller", "noisy", "uniform")


def pursue(observations: np.ndarray) -> np.ndarray:
    """(n, 2) float32 actions of pure pursuit (Coulter 1992), a function of observations (n, 8) of `tasks.driving.LaneDriving`.

    It steers about the circle that leads from the car to the middle of the lane `LOOK` m ahead, where the lane is taken for a
    parabola of the curvature that is seen near there.
    """
    seen = observations.astype(np.float64)
    bend = seen[:, 4 + int(np.argmin(np.abs(AHEAD - LOOK)))]
    heading = seen[:, HEADING]
    left = np.cos(heading) * (bend * LOOK**2 / 2 - seen[:, OFFSET]) - np.sin(heading) * LOOK
    circle = 2 * left / LOOK**2  # 1/m
    return actions_for(circle, EAGER * (CRUISE - seen[:, SPEED]))


class Shaken(StatefulController):
    """A controller, with Gaussian noise of each copy's own on its actions, cut to the bounds.

    In a task that shows pictures it goes by what these are drawn from.

    Args:
        copies: side by side.
        act: the controller, a function of observations.
        noise: its standard deviation.
    """

    columns: dict[str, tuple[int, ...]] = {}  # noqa: RUF012 (one of the class's own, which nothing changes)

    def __init__(self, copies: int, act: Callable[[np.ndarray], np.ndarray] = pursue, noise: float = NOISE):
        self._act, self._noise = act, noise
        self._generators = [np.random.default_rng(0)] * copies
        self._simulator: Any = None

    def begin(self, simulator: Any, copy: int, observation: np.ndarray, generator: np.random.Generator) -> None:
        """See `StatefulController`."""
        self._generators[copy], self._simulator = generator, simulator

    def act(self, observations: np.ndarray, running: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """See `StatefulController`."""
        actions = self._act(self._simulator.seen if isinstance(self._simulator, PixelSimulator) else observations)
        for copy in running.tolist():
            actions[copy] += self._noise * self._generators[copy].standard_normal(2)
        return np.clip(actions, -1.0, 1.0), {}


def collect_driving(
    task: Task,
    kind: str,
    *,
    act: Callable[[np.ndarray], np.ndarray] = pursue,
    noise: float = NOISE,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects one of `KINDS`: a controller, the same with noise, or uniform actions; see `collect.rollouts.collect_rollouts`.

    Args:
        task: where.
        kind: among `KINDS`.
        act: the controller, a function of observations.
        noise: see `Shaken`.
        name: of the recipe, such as `carla-lane-state-noisy-v0`.
        steps: rows.
        scratch: folder of a collection under way.
        seed: random seed.
        threads: without effect: cars need none.
        progress: called with rows done and rows in all.
    """
    clean = Shaken(COPIES, act, 0.0) if isinstance(task, Pixels) else act
    who = {"controller": clean, "noisy": Shaken(COPIES, act, noise), "uniform": None}[kind]
    extra = {"task": task.name, "actions": kind, "device": acting_platform()}
    drawn = ("mujoco",) if isinstance(task, Pixels) else ()
    return collect_rollouts(
        task, [Segment(who, steps)], name=f"{name}@{version_of(name)}", seed=seed,
        provenance=collected(name, seed, ("numpy", "jax", *drawn), extra), threads=threads, scratch=scratch, progress=progress,
    )  # fmt: skip
