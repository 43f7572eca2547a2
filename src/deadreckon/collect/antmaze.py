"""How the AntMaze logs are made: a planner's waypoints, followed by an ant that walks where it is told (thesis 7.3, D.7).

The guide remembers which waypoints it has reached, so the behaviour that is logged is not Markovian.
"""

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.collect.planner import routes
from deadreckon.collect.rollouts import COPIES, Segment, StatefulController, acted_in, collect_rollouts
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.policies import library, store
from deadreckon.policies.deployed import EnvPolicy, first_actions
from deadreckon.progress import Progress
from deadreckon.tasks.antmaze import GOAL_NOISE, AntMaze, ahead

ACTION_NOISE = 0.2  # standard deviation of the noise on the walker's actions
NEAR = 1.0  # m, within which a waypoint counts as reached
WALKER = library.ROOT / "ant-reach" / "walker.npz"


@lru_cache
def walker() -> EnvPolicy:
    """The policy that walks where it is told: of what `ahead` shows (27) to the motors (8).

    Trained by SAC in the task `ant-reach` and shipped by `tools/antmaze_walker.py`; beside it lies how it was made.
    """
    return store.load(WALKER)


class Errands(StatefulController):
    """Sends the ants of many copies of one maze from target to target, by way of the cells that the planner names.

    Attributes:
        columns: `goal`, the target that each row's action heads for, and `episode_goal`, which the episode's rewards are of.
        sent: how many targets there were in all copies.
    """

    def __init__(self, task: AntMaze, policy: EnvPolicy, *, copies: int = COPIES, noise: float = ACTION_NOISE):
        """Sets up the guide.

        Args:
            task: the maze; its name says where the ants are sent: to the episode's goal (neither play nor diverse), to picked
                cells (play), or anywhere (diverse).
            policy: see `walker`.
            copies: of the maze.
            noise: standard deviation of what is added to the walker's mean actions, which are then cut to ±1.
        """
        self.columns = {"goal": (2,), "episode_goal": (2,)}
        self._task, self._policy, self._noise = task, policy, noise
        self._next = routes(task.grid)
        kind = task.name.rpartition("-")[2]
        cells = {"play": task.cell_of(task.middles(np.array(task.picked))), "diverse": np.arange(len(task.cells))}
        self._targets = cells.get(kind)
        self._generators = [np.random.default_rng(0)] * copies
        self.target = np.zeros((copies, 2))
        self.episode_goals = np.zeros((copies, 2))
        self._aim = np.zeros((copies, 2))  # the waypoint that is headed for
        self._cell = np.zeros(copies, int)  # the cell that it lies in
        self._left = np.zeros(copies, int)  # the cell before that
        self._goal = np.zeros(copies, int)  # the target's cell
        self.sent = 0

    @property
    def wanders(self) -> bool:
        """Whether ants are sent to targets other than their episodes' goals."""
        return self._targets is not None

    def begin(self, simulator: Any, copy: int, observation: np.ndarray, generator: np.random.Generator) -> None:
        """See `StatefulController`."""
        self._generators[copy] = generator
        self.episode_goals[copy] = simulator.goals[copy]
        here = int(self._task.cell_of(observation[None, :2])[0])
        if self._targets is None:
            self.target[copy] = simulator.goals[copy]
            self._goal[copy] = self._task.cell_of(self.target[copy : copy + 1])[0]
            self.sent += 1
        else:
            self._send(copy, here)
        self._head_on(copy, here)

    def act(self, observations: np.ndarray, running: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """See `StatefulController`."""
        place = observations[:, :2].astype(np.float64)
        cells = self._task.cell_of(place)
        there = np.linalg.norm(place - self.target, axis=1) <= self._task.reach
        near = (np.linalg.norm(place - self._aim, axis=1) <= NEAR) & (self._cell != self._goal)
        # Pushed off its way, an ant would be led through walls.
        lost = (cells >= 0) & (cells != self._cell) & (cells != self._left)
        for copy in running[(there | near | lost)[running]].tolist():
            if there[copy] and self._targets is not None:
                self._send(copy, int(cells[copy]))
            self._head_on(copy, int(cells[copy] if there[copy] or lost[copy] else self._cell[copy]))
        angles = np.arctan2(*(self._aim - place).T[::-1])
        seen = ahead(observations.astype(np.float64), angles).astype(np.float32)
        actions = np.array(first_actions(self._policy, jnp.asarray(seen), jax.random.key(0), True))
        for copy in running.tolist():
            actions[copy] += self._noise * self._generators[copy].standard_normal(actions.shape[1])
        return np.clip(actions, -1.0, 1.0), {"goal": self.target.copy(), "episode_goal": self.episode_goals.copy()}

    def _send(self, copy: int, here: int) -> None:
        """Draws a new target in another cell than `here`."""
        assert self._targets is not None
        others = self._targets[self._targets != here]
        self._goal[copy] = others[self._generators[copy].integers(len(others))]
        self.target[copy] = self._task.goal_in(self._task.cells[self._goal[copy]], self._generators[copy])
        self.sent += 1

    def _head_on(self, copy: int, here: int) -> None:
        """Sets the waypoint after the cell `here`: a point of the next cell or, in the last one, the target itself."""
        self._left[copy], self._cell[copy] = here, self._next[self._goal[copy], here]
        if self._cell[copy] == self._goal[copy]:
            self._aim[copy] = self.target[copy]
        else:
            noise = self._generators[copy].uniform(0.0, GOAL_NOISE[0], 2)
            self._aim[copy] = self._task.middles(self._task.cells[self._cell[copy]]) + noise


def collect_antmaze(
    task: AntMaze,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects a log of one of the mazes; see `collect.rollouts.collect_rollouts`.

    Ants of umaze logs begin at the start and go to the episode's goal. Those of the others begin anywhere and are sent to one
    target after the other, until they come upon the episode's goal (a terminal) or time is up (a timeout). The target is the
    column `goal`; rewards are those of the task's own goal, the column `episode_goal`.

    Args:
        task: where, and where to.
        name: of the recipe, such as `antmaze-umaze-v2`.
        steps: rows.
        scratch: folder of a collection under way.
        seed: random seed.
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and `steps`.
    """
    guide = Errands(task, walker())
    walked = hashlib.sha256(WALKER.read_bytes()).hexdigest()
    extra = {"task": task.name, "policies": ["ant-reach walker"], "noise": ACTION_NOISE, "walker": walked}
    place = replace(task, anywhere=guide.wanders)
    return collect_rollouts(
        place, [Segment(guide, steps)], name=f"{name}@{VERSION}", seed=seed, scratch=scratch, threads=threads,
        provenance=acted_in("gymnasium", name, seed, extra), progress=progress,
    )  # fmt: skip
