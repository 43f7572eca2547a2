"""Maze2D: a ball that is pushed to a goal in a maze (thesis 7.3), rebuilt on the MuJoCo bindings.

Constants and layouts are D4RL's. Cell (row, column) of a layout is the point x = row, y = column. As in D4RL, the walls stand
one unit further and the ball's origin 1.2 further, so the middle of a cell's free space is at (row - 0.2, column - 0.2): a
quirk that is kept because the original logs were recorded in these coordinates.

One difference is known: here and in D4RL's environment the reward of a step looks at the observation after it; in D4RL's
published *logs* rewards were computed again from the observation before the step, so their columns are one step late.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.copies import bindings
from deadreckon.tasks.mazes import Maze
from deadreckon.tasks.task import Reference, Starts, checked_actions, thread_count

RADIUS = 0.1  # of the ball
OFFSET = 0.2  # a cell's middle lies this much below (row, column), in both coordinates
MAX_SPEED = 5.0  # velocities are clipped to this before each step; one seen after it may be larger
START_NOISE = 0.1  # half-width of the start's uniform position noise, and standard deviation of its velocity

LAYOUTS = {
    "umaze": "#####/#GOO#/###O#/#OOO#/#####",
    "medium": "########/#OO##OO#/#OO#OOO#/##OOO###/#OO#OOO#/#O#OO#O#/#OOO#OG#/########",
    "large": "############/#OOOO#OOOOO#/#O##O#O#O#O#/#OOOOOO#OOO#/#O####O###O#/"
    "#OO#O#OOOOO#/##O#O#O#O###/#OO#OOO#OGO#/############",
    "eval-umaze": "#####/#OOG#/#O###/#OOO#/#####",
    "eval-medium": "########/#OOOOOG#/#O#O##O#/#OOOO#O#/###OO###/#OOOOOO#/#OO##OO#/########",
    "eval-large": "############/#OO#OOO#OGO#/##O###O#O#O#/#OO#O#OOOOO#/#O##O#OO##O#/"
    "#OOOOOO#OOO#/#O##O#O#O###/#OOOO#OOOOO#/############",
}


@dataclass(frozen=True)
class Maze2D(Maze):
    """A Maze2D task. Observations are [x, y, x velocity, y velocity]; actions are two forces; no state is terminal.

    Attributes:
        dense: reward exp(-distance to the goal) instead of 1 within 0.5 of it and 0 elsewhere.
    """

    revision: ClassVar[int] = 1

    dense: bool = False

    @cached_property
    def goal(self) -> np.ndarray:
        """(2,) float32 position of the goal."""
        return self.marked("G").astype(np.float32)

    def goal_place(self) -> np.ndarray:
        """See `Maze`."""
        return self.goal

    def middles(self, cells: np.ndarray) -> np.ndarray:
        """See `Maze`."""
        return cells - OFFSET

    def grid_places(self, positions: np.ndarray) -> np.ndarray:
        """See `Maze`."""
        return positions + OFFSET

    def rewards(self, observations: np.ndarray) -> np.ndarray:
        """(n,) float32 rewards of the steps that led to (n, 4) float32 observations."""
        away = observations[..., :2] - self.goal
        distance = np.sqrt(np.square(away[..., 0]) + np.square(away[..., 1]))
        return np.exp(-distance) if self.dense else (distance <= self.reach).astype(np.float32)

    def start(self, generator: np.random.Generator) -> np.ndarray:
        """(4,) float64 position and velocity of a new episode: any free cell, the goal's too."""
        cell = self.cells[generator.integers(len(self.cells))]
        position = cell + generator.uniform(-START_NOISE, START_NOISE, 2)
        return np.concatenate([position, START_NOISE * generator.standard_normal(2)])

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "MazeSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return MazeSimulator(self, seeds, threads)


class MazeSimulator:
    """Copies of one maze, stepped together by MuJoCo's threaded rollout.

    A step is a pure function of (position, velocity, action), because the solver's warm start is off: any number of
    copies or threads, `Maze2DEnv` and collected logs agree to the bit.
    """

    def __init__(self, task: Maze2D, seeds: Sequence[int], threads: int | None = None):
        from mujoco.rollout import Rollout

        mujoco = bindings()
        self.task, copies = task, len(seeds)
        self._starts = Starts(seeds, task.start)
        # Waking threads costs more than a few copies take.
        threads = min(thread_count(threads, task.name), max(1, copies // 16))
        self._model = model(task.layout)
        self._data = [mujoco.MjData(self._model) for _ in range(threads)]
        self._models = [self._model] * copies
        self._pool = Rollout(nthread=threads if threads > 1 else 0)
        # One chunk a thread: a step is so short that handing out more costs a third of the speed.
        self._chunk = -(-copies // threads)
        self._spec = mujoco.mjtState.mjSTATE_CTRL.value
        # MuJoCo's full state is [time, x, y, x velocity, y velocity]; each step overwrites it in place.
        self._state = np.zeros((copies, 5))
        self._moving, self._velocity = self._state[:, 1:], self._state[:, 3:]
        self._after = self._state[:, None]
        self._control = np.zeros((copies, 1, 2))
        self._sensors = np.zeros((copies, 1, 0))
        self._age = np.zeros(copies, int)
        self._never = np.zeros(copies, bool)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """(which, 4) float32 observations of new episodes; see `Simulator.reset`."""
        which, starts = self._starts.begun(which, seeds)
        self._state[which, 0] = 0.0
        self._moving[which] = starts
        self._age[which] = 0
        return self._moving[which].astype(np.float32)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, 2) forces, clipped to ±1; gives observations, rewards, terminals and timeouts."""
        actions = checked_actions(actions, (len(self._state), 2), self.task.name, np.arange(len(self._state)))
        observations = self.advance(actions)
        self._age += 1
        return observations, self.task.rewards(observations), self._never.copy(), self._age >= self.task.horizon

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {"physics": self._state.copy(), "age": self._age.copy(), **self._starts.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._state[:], self._age[:] = state["physics"], state["age"]
        self._starts.restore(state)

    def advance(self, actions: np.ndarray) -> np.ndarray:
        """Physics alone, unchecked and without end: (copies, 2) float32 forces in, (copies, 4) float32 observations out."""
        control = self._control[:, 0]
        np.maximum(actions, -1.0, out=control)
        np.minimum(control, 1.0, out=control)
        np.maximum(self._velocity, -MAX_SPEED, out=self._velocity)
        np.minimum(self._velocity, MAX_SPEED, out=self._velocity)
        self._pool.rollout(
            self._models, self._data, self._state, self._control, control_spec=self._spec, skip_checks=True, nstep=1,
            state=self._after, sensordata=self._sensors, chunk_size=self._chunk,
        )  # fmt: skip
        return self._moving.astype(np.float32)


@lru_cache
def model(layout: str) -> Any:
    """The compiled MuJoCo model of a layout, shared by all who step it (they never write to it)."""
    return bindings().MjModel.from_xml_string(mjcf(layout))


def mjcf(layout: str) -> str:
    """The maze as MuJoCo's XML: a wall box for each "#" and the ball on two slides."""
    # A contact's margin is the larger or, in other releases, the sum of both bodies': set on the ball alone, it is the same.
    walls = "\n".join(
        f'    <geom type="box" size="0.5 0.5 0.5" pos="{row + 1} {column + 1} 0" contype="1" conaffinity="0" condim="1"/>'
        for row, line in enumerate(layout.split("/"))
        for column, cell in enumerate(line)
        if cell == "#"
    )
    # Warm starts would make a step depend on those before it. Islands and the midphase, both younger than D4RL's MuJoCo, cost a
    # tenth of the speed here: there is one body to solve for, and a few walls to look at.
    return f"""<mujoco model="maze2d">
  <option timestep="0.01" integrator="Euler" gravity="0 0 0" iterations="20">
    <flag warmstart="disable" island="disable" midphase="disable"/>
  </option>
  <worldbody>
{walls}
    <body name="ball" pos="{1 + OFFSET} {1 + OFFSET} 0">
      <joint name="x" type="slide" axis="1 0 0" damping="1"/>
      <joint name="y" type="slide" axis="0 1 0" damping="1"/>
      <geom type="sphere" size="{RADIUS}" density="1000" margin="0.002" condim="1" contype="0" conaffinity="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="x" gear="100" ctrllimited="true" ctrlrange="-1 1"/>
    <motor joint="y" gear="100" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>"""


# ---- the tasks --------------------------------------------------------------------------------------------------------

_HORIZONS = {"umaze": 300, "medium": 600, "large": 800}

# Measured on this simulator (MuJoCo 3.11.0, seed 0): mean return of 100 episodes of uniform actions (thesis 7.3; sparse, its
# standard error is about 4, 3 and 3) and of 1,000 episodes of the planner of `deadreckon.collect` going to the goal and
# staying there. Made by `python -m deadreckon.collect.references`.
_MEASURED = {
    "maze2d-umaze": (28.7800, 224.9790),
    "maze2d-medium": (21.4200, 431.1520),
    "maze2d-large": (11.9300, 557.4270),
    "maze2d-eval-umaze": (37.1500, 221.7260),
    "maze2d-eval-medium": (22.6400, 444.9030),
    "maze2d-eval-large": (10.9600, 573.7390),
    "maze2d-umaze-dense": (73.0153, 236.7739),
    "maze2d-medium-dense": (45.8601, 445.2628),
    "maze2d-large-dense": (31.8549, 577.4826),
    "maze2d-eval-umaze-dense": (75.0714, 233.0478),
    "maze2d-eval-medium-dense": (57.4565, 456.4030),
    "maze2d-eval-large-dense": (42.4374, 594.0618),
}

# D4RL's own: of the training mazes from its published table, of the others from d4rl/pointmaze/__init__.py (commit 34141f3f).
# There eval-large-dense has (56.95455, 326.09647655082637), whose first number is that of eval-umaze-dense to the last digit:
# it is left out, as it is likely a copy.
_PUBLISHED = {
    "maze2d-umaze": (23.85, 161.86),
    "maze2d-umaze-dense": (68.537689, 193.66285642381482),
    "maze2d-medium": (13.13, 277.39),
    "maze2d-medium-dense": (44.264742, 297.4552547777125),
    "maze2d-large": (6.7, 273.99),
    "maze2d-large-dense": (30.569041, 303.4857382709002),
    "maze2d-eval-umaze": (36.63, 141.4),
    "maze2d-eval-umaze-dense": (56.95455, 178.21373133248397),
    "maze2d-eval-medium": (13.07, 204.93),
    "maze2d-eval-medium-dense": (42.28578, 235.5658957482388),
    "maze2d-eval-large": (16.4, 302.22),
}


def _make(maze: str, dense: bool) -> Maze2D:
    name = f"maze2d-{maze}{'-dense' if dense else ''}"
    size = maze.removeprefix("eval-")
    title = ("Eval" if maze != size else "") + {"umaze": "UMaze"}.get(size, size.title())
    random, expert = _MEASURED[name]
    published = _PUBLISHED.get(name)
    return Maze2D(
        name=name,
        domain="maze2d",
        horizon=_HORIZONS[size],
        observation_shape=(4,),
        action_space=Box((-1.0, -1.0), (1.0, 1.0)),
        gym_id=f"deadreckon/Maze2D-{title}{'Dense' if dense else ''}-v1",
        reference=Reference(random, expert, "measured on this simulator: uniform actions, waypoint planner"),
        published=Reference(*published, "D4RL") if published else None,
        split="training" if maze == size else "evaluation",
        summary=f"push a ball to the goal of the {maze} maze; reward " + ("exp(-distance)" if dense else "1 within 0.5 of it"),
        properties=("non-Markovian policies", "undirected data", "temporally extended"),
        source="D4RL (new there)",
        layout=LAYOUTS[maze],
        dense=dense,
    )


TASKS = tuple(_make(maze, dense) for dense in (False, True) for maze in LAYOUTS)
