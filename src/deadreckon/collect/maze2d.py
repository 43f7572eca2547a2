"""How the Maze2D logs are made: a planner's waypoints, followed by a PD controller (thesis 7.3, D.7).

The controller remembers which waypoints it has reached, so the behaviour that is logged is not Markovian.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from deadreckon.collect.growing_log import collected
from deadreckon.collect.planner import routes
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.data.provenance import Provenance
from deadreckon.progress import Progress
from deadreckon.tasks.maze2d import OFFSET, START_NOISE, Maze2D

P_GAIN, D_GAIN = np.float32(10.0), np.float32(-1.0)
NEAR = 0.1  # a waypoint or target counts as reached within this distance
MAX_STREAMS = 500  # environments side by side; part of the recipe, so that data does not depend on the machine
MIN_STREAM = 2_000  # a short log has fewer streams instead of ones too short to get anywhere
_BLOCK = 50  # steps kept in a small buffer before they go to the log, whose rows lie far apart


class Pursuit:
    """The waypoint controller, for many copies of one maze at once.

    Each copy heads for a target by way of the cells that the planner names. `act` gives the actions and `observe`,
    called with what came of them, tells whose pursuit has ended: the target was reached, or `patience` ran out.

    Attributes:
        target: (copies, 2) float32, what each copy is heading for.
    """

    def __init__(self, task: Maze2D, copies: int, generator: np.random.Generator, *, patience: int, fixed: bool = False):
        """Sets up the controller.

        Args:
            task: the maze.
            copies: number of environments.
            generator: draws targets and the jitter of waypoints.
            patience: steps after which a target is given up.
            fixed: head for the task's goal for ever, instead of a new random target after each one.
        """
        self._task = task
        self._generator = generator
        self._patience = patience
        self._fixed = fixed
        self._next = routes(task.grid)
        self.target = np.zeros((copies, 2), np.float32)
        self._aim = np.zeros((copies, 2), np.float32)  # the waypoint being followed
        self._cell = np.zeros(copies, int)  # the cell it belongs to
        self._goal = np.zeros(copies, int)  # the target's cell
        self._age = np.zeros(copies, int)

    def start(self, observations: np.ndarray) -> None:
        """New targets for all copies, seen at (copies, 4) observations."""
        everyone = np.arange(len(self.target))
        self._retarget(everyone, observations)
        self._head_on(everyone)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """(copies, 2) float32 actions in [-1, 1]."""
        actions = self._aim - observations[:, :2]
        actions *= P_GAIN
        actions += D_GAIN * observations[:, 2:]
        np.maximum(actions, -1.0, out=actions)
        np.minimum(actions, 1.0, out=actions)
        return actions

    def observe(self, observations: np.ndarray) -> np.ndarray:
        """Takes in the observations after a step; gives (copies,) bool, whose pursuit ended with that step."""
        self._age += 1
        away = self._aim - observations[:, :2]
        away *= away
        near = away[:, 0] + away[:, 1] < NEAR**2
        ended = self._age >= self._patience
        final = self._cell == self._goal
        if self._fixed:
            # At the goal the aim stays what it is, the goal.
            self._head_on(np.flatnonzero(near & ~final))
            return ended
        reached = near & final
        over = np.flatnonzero(ended | reached)
        self._retarget(over, observations)
        ended |= reached
        self._head_on(np.flatnonzero(near | ended))
        return ended

    def _retarget(self, who: np.ndarray, observations: np.ndarray) -> None:
        """Draws new targets for `who`; the way to them begins in the cell where each of them is."""
        task = self._task
        self._age[who] = 0
        self._cell[who] = task.cell_of(observations[who, :2])
        if self._fixed:
            self._goal[who] = task.cell_of(task.goal[None])
            self.target[who] = task.goal
        else:
            draws = self._generator.random((len(who), 3))
            goal = (draws[:, 0] * len(task.cells)).astype(int)
            self._goal[who] = goal
            self.target[who] = task.cells[goal] + (draws[:, 1:] * 2 - 1) * START_NOISE

    def _head_on(self, who: np.ndarray) -> None:
        """Sets the next waypoint: a point about the next cell's middle or, in the last cell, the target itself."""
        goal = self._goal[who]
        cells = self._next[goal, self._cell[who]]
        self._cell[who] = cells
        # The free space of a cell is off by 0.2 from (row, column): jitter towards its middle, not into the wall.
        points = self._task.cells[cells] - self._generator.random((len(who), 2)) * OFFSET
        self._aim[who] = np.where((cells == goal)[:, None], self.target[who], points)


def collect_maze2d(
    task: Maze2D,
    *,
    name: str,
    steps: int,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects a log: one episode a pursuit, streams one after the other, the environment never reset within a stream.

    Rewards are those of the task's own goal, whatever target was pursued (thesis 7.3). The target is the column `goal`.

    Args:
        task: the maze and its reward.
        name: of the recipe, such as `maze2d-umaze-v1`; the log is called `maze2d-umaze-v1@dr1`.
        steps: rows.
        seed: random seed.
        threads: to step with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and `steps`.
    """
    streams = min(max(steps // MIN_STREAM, 1), MAX_STREAMS)
    # The first `longer` streams have one row more than the others.
    length, longer = divmod(steps, streams)
    rows = length + (longer > 0)
    seeds, control = np.random.SeedSequence(seed).spawn(2)
    simulator = task.simulate([int(s) for s in seeds.generate_state(streams, np.uint64)], threads)
    controller = Pursuit(task, streams, np.random.default_rng(control), patience=task.horizon)

    observations = np.empty((streams, rows + 1, 4), np.float32)  # one more: what was seen after the last action
    actions, goals = np.empty((2, streams, rows, 2), np.float32)
    ends = np.empty((streams, rows), bool)
    block = (
        np.empty((_BLOCK, streams, 4), np.float32),
        *np.empty((2, _BLOCK, streams, 2), np.float32),
        np.empty((_BLOCK, streams), bool),
    )

    seen = simulator.reset()
    controller.start(seen)
    for start in range(0, rows, _BLOCK):
        stop = min(start + _BLOCK, rows)
        for at in range(stop - start):
            action = controller.act(seen)
            block[0][at], block[1][at], block[2][at] = seen, action, controller.target
            seen = simulator.advance(action)
            block[3][at] = controller.observe(seen)
        for column, part in zip((observations, actions, goals, ends), block):
            column[:, start:stop] = part[: stop - start].swapaxes(0, 1)
        if progress:
            progress(min(stop * streams, steps), steps)
    observations[:, rows] = seen

    # Streams end where the recording does: a timeout, with the observation that came next.
    last = np.where(np.arange(streams) < longer, rows, length) - 1
    ends[np.arange(streams), last] = True
    rewards = task.rewards(observations[:, 1:])
    keep = np.arange(rows) <= last[:, None] if longer else slice(None)
    flat = (-1, 4), (-1, 2)
    return Dataset.from_arrays(
        observations=observations[:, :-1][keep].reshape(flat[0]),
        actions=actions[keep].reshape(flat[1]),
        rewards=rewards[keep].reshape(-1),
        timeouts=ends[keep].reshape(-1),
        final_observations=observations[:, 1:][ends & keep if longer else ends],
        action_space=task.action_space,
        name=f"{name}@{VERSION}",
        provenance=_provenance(task, name, seed, streams),
        goal=goals[keep].reshape(flat[1]),
    )


class Way(NamedTuple):
    """One step of several copies: observations (copies, 4), actions (copies, 2), what followed, and (copies,) rewards."""

    seen: np.ndarray
    actions: np.ndarray
    following: np.ndarray
    rewards: np.ndarray


def to_the_goal(task: Maze2D, seeds: Sequence[int], generator: np.random.Generator) -> Iterator[Way]:
    """One episode of the controller going to the task's goal and staying there, from each seed's start.

    Args:
        task: the maze and its reward.
        seeds: of the starts.
        generator: of the waypoints' jitter.
    """
    simulator = task.simulate(seeds)
    controller = Pursuit(task, len(seeds), generator, patience=task.horizon, fixed=True)
    seen = simulator.reset()
    controller.start(seen)
    for _ in range(task.horizon):
        actions = controller.act(seen)
        following, rewards, _, _ = simulator.step(actions)
        controller.observe(following)
        yield Way(seen, actions, following, rewards)
        seen = following


def demonstrations(task: Maze2D, episodes: int = 25, seed: int = 0) -> Dataset:
    """A log of the controller going to the task's goal, for agents that learn from demonstrations.

    Args:
        task: the maze and its reward.
        episodes: whole ones.
        seed: of the starts and of the waypoints' jitter.
    """
    starts, jitter = np.random.SeedSequence(seed).spawn(2)
    seeds = [int(s) for s in starts.generate_state(episodes, np.uint64)]
    steps = list(to_the_goal(task, seeds, np.random.default_rng(jitter)))
    seen, actions, _, rewards = (np.stack(column, 1) for column in zip(*steps))
    timeouts = np.zeros((episodes, task.horizon), bool)
    timeouts[:, -1] = True
    name = f"{task.name}-planner"
    return Dataset.from_arrays(
        observations=seen.reshape(-1, 4), actions=actions.reshape(-1, 2), rewards=rewards.ravel(), timeouts=timeouts.ravel(),
        final_observations=steps[-1].following, action_space=task.action_space, name=name,
        provenance=_provenance(task, name, seed, episodes),
    )  # fmt: skip


def _provenance(task: Maze2D, name: str, seed: int, streams: int) -> Provenance:
    extra = {"task": task.name, "streams": streams, "patience": task.horizon, "reward_from": "observation after the step"}
    return collected(name, seed, ("mujoco", "numpy"), extra)
