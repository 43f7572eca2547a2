"""How the Flow logs are made (thesis 7.3), and controllers that are known to calm traffic, which the tasks are measured by."""

from pathlib import Path
from typing import Protocol

import numpy as np

from deadreckon.collect.growing_log import collected
from deadreckon.collect.rollouts import Segment, collect_rollouts
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.data.spec import Box
from deadreckon.progress import Progress
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.flow_roads import SPEED_LIMIT
from deadreckon.tasks.sumo import sumo_version


class Controller(Protocol):
    """Drives the learners of many copies at once."""

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """(copies, learners) float32 accelerations within the bounds, for (copies, size) observations."""
        ...


class Idm:
    """The intelligent driver model (Treiber et al. 2000, eqs. 2 and 3), with Flow's settings. It remembers nothing.

    Args:
        task: whose observations it reads.
    """

    TIME, ACCELERATION, BRAKING, GAP = 1.0, 1.0, 1.5, 2.0  # s, m/s^2, m/s^2, m
    EXPONENT = 4

    def __init__(self, task: Flow):
        self.task = task

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """See `Controller`."""
        speed, leading, gap, present = self.task.kind.read(observations)
        closing = speed * (speed - leading) / (2.0 * np.sqrt(self.ACCELERATION * self.BRAKING))
        wanted = self.GAP + np.maximum(speed * self.TIME + closing, 0.0)
        free = 1.0 - (speed / SPEED_LIMIT) ** self.EXPONENT
        return _bounded(self.task, self.ACCELERATION * (free - np.square(wanted / np.maximum(gap, 1e-3))), present)


class FollowerStopper:
    """Keeps to one speed, and less only where the gap before it is short (Stern et al. 2018, section 3.1).

    Args:
        task: whose observations it reads.
        speed: (copies, 1) or a number, m/s.
    """

    GAPS = np.array([4.5, 5.25, 6.0])  # m: it stops below the first, and knows no leader above the last
    BRAKING = np.array([1.5, 1.0, 0.5])  # m/s^2, by which a leader's lower speed widens them

    def __init__(self, task: Flow, speed: np.ndarray | float):
        self.task, self.wanted = task, speed

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """See `Controller`."""
        speed, leading, gap, present = self.task.kind.read(observations)
        slower = np.minimum(leading - speed, 0.0)
        stop, follow, free = (near + np.square(slower) / (2.0 * braking) for near, braking in zip(self.GAPS, self.BRAKING))
        most = np.minimum(np.maximum(leading, 0.0), self.wanted)
        command = np.select(
            [gap <= stop, gap <= follow, gap <= free],
            [0.0, most * (gap - stop) / (follow - stop), most + (self.wanted - most) * (gap - follow) / (free - follow)],
            self.wanted,
        )
        return _bounded(self.task, (command - speed) / self.task.seconds, present)


class PISaturation:
    """Follows its own mean speed, which it learns on the way, and catches up where the gap is wide (Stern et al. 2018, 3.2).

    Args:
        task: whose observations it reads.
    """

    WINDOW = 38.0  # s of its own speed
    CATCH_UP = 1.0  # m/s, at most
    NARROW, WIDE = 7.0, 30.0  # m, gaps between which catching up sets in
    SAFE_TIME, SAFE_GAP, BLEND = 2.0, 4.0, 2.0  # s, m, m: how near it follows its leader instead

    def __init__(self, task: Flow):
        self.task = task
        self.speeds: list[np.ndarray] = []
        self.command: np.ndarray | float = 0.0

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """See `Controller`."""
        speed, leading, gap, present = self.task.kind.read(observations)
        self.speeds = [*self.speeds, speed][-int(self.WINDOW / self.task.seconds) :]
        target = np.mean(self.speeds, 0) + self.CATCH_UP * np.clip((gap - self.NARROW) / (self.WIDE - self.NARROW), 0.0, 1.0)
        safe = np.maximum(self.SAFE_TIME * (leading - speed), self.SAFE_GAP)
        share = np.clip((gap - safe) / self.BLEND, 0.0, 1.0)
        weight = 1.0 - 0.5 * share
        self.command = weight * (share * target + (1.0 - share) * leading) + (1.0 - weight) * self.command
        return _bounded(self.task, (self.command - speed) / self.task.seconds, present)


def _bounded(task: Flow, accelerations: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Within the bounds; 0 for learners that are not there."""
    assert isinstance(task.action_space, Box)
    clipped = np.clip(accelerations, task.action_space.low, task.action_space.high)
    return np.where(present, clipped, 0.0).astype(np.float32)


def collect_flow(
    task: Flow,
    kind: str,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects uniform accelerations, or what `Idm` does; see `collect.rollouts.collect_rollouts`.

    Args:
        task: where.
        kind: `random` or `controller`.
        name: of the recipe, such as `flow-ring-controller-v0`.
        steps: rows.
        scratch: folder of a collection under way.
        seed: random seed.
        threads: to simulate with.
        progress: called with rows done and rows in all.
    """
    extra = {"task": task.name, "actions": "uniform" if kind == "random" else "intelligent driver model, within the bounds"}
    provenance = collected(name, seed, ("numpy", "jax"), extra, {"libsumo": sumo_version(task.name)})
    return collect_rollouts(
        task, [Segment(None if kind == "random" else Idm(task), steps)], name=f"{name}@{VERSION}", seed=seed,
        provenance=provenance, threads=threads, scratch=scratch, progress=progress,
    )  # fmt: skip
