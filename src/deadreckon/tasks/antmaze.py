"""AntMaze: a four-legged robot walks to a goal in a maze (thesis 7.3), rebuilt on the MuJoCo bindings.

The body is Gymnasium's `ant.xml` with D4RL's time step, motors and contacts; mazes and places are D4RL's. Place (0, 0) is the
middle of the cell in which an evaluation begins, x runs along the columns and y along the rows, a cell is 4 m wide.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.copies import MujocoCopies, asset, bindings
from deadreckon.tasks.mazes import Maze
from deadreckon.tasks.task import Reference, Task
from deadreckon.versions import installed

SCALE = 4.0  # m, width of a cell
GOAL_NOISE = (1.0, 0.5)  # m: a goal lies off its cell's middle by the sum of two uniform numbers up to these
START_NOISE = 1.0  # m: where a start may be anywhere, it lies off its cell's middle by a uniform number up to this
NOISE = 0.1  # half-width of the uniform noise on the first positions, and standard deviation of that on the first velocities
FRAME_SKIP, TIMESTEP, TORQUE = 5, 0.02, 30.0  # physics steps a step, s, and N m of an action of 1
POSITIONS, VELOCITIES = 15, 14
JOINTS = 8

# "R" is where evaluations begin, "G" where their goals lie; all but "#" is free.
LAYOUTS = {
    "umaze": "#####/#ROO#/###O#/#GOO#/#####",
    "medium": "########/#RO##OO#/#OO#OOO#/##OOO###/#OO#OOO#/#O#OO#O#/#OOO#OG#/########",
    "large": "############/#ROOO#OOOOO#/#O##O#O#O#O#/#OOOOOO#OOO#/#O####O###O#/"
    "#OO#O#OOOOO#/##O#O#O#O###/#OO#OOO#OGO#/############",
    "eval-umaze": "#####/#OOR#/#O###/#OOG#/#####",
    "eval-medium": "########/#ROOOOG#/#O#O##O#/#OOOO#O#/###OO###/#OOOOOO#/#OO##OO#/########",
    "eval-large": "############/#RO#OOO#OGO#/##O###O#O#O#/#OO#O#OOOOO#/#O##O#OO##O#/"
    "#OOOOOO#OOO#/#O##O#O#O###/#OOOO#OOOOO#/############",
}
# Cells (row, column) that the ant is sent to in "play" logs.
PICKED = {
    "umaze": ((3, 1),),
    "medium": ((2, 6), (5, 1), (6, 5)),
    "large": ((1, 6), (3, 5), (3, 10), (5, 2), (7, 4), (7, 6), (7, 9)),
    "eval-umaze": ((3, 3),),
    "eval-medium": ((1, 6), (5, 1), (6, 5)),
    "eval-large": ((1, 4), (1, 9), (3, 6), (5, 1), (7, 4), (7, 6), (7, 10)),
}


@dataclass(frozen=True)
class AntMaze(Maze):
    """An AntMaze task. Observations are positions (15: x, y, z, quaternion, 8 joints) and velocities (14), not the goal.

    Actions in ±1 are the motors of hips and ankles. The step that ends within 0.5 m of the episode's goal earns 1 and is
    the last; a fall ends nothing.

    Attributes:
        picked: cells (row, column) that "play" logs are sent to.
        anywhere: begin in any free cell that is neither picked nor the goal's, as logs other than antmaze-umaze do, instead of
            at the start.
    """

    revision: ClassVar[int] = 1

    marks: str = "RG"
    width: float = SCALE
    picked: tuple[tuple[int, int], ...] = ()
    anywhere: bool = False

    def middles(self, cells: np.ndarray) -> np.ndarray:
        """See `Maze`."""
        return SCALE * (np.asarray(cells) - self.marked("R"))[..., ::-1].astype(np.float64)

    def grid_places(self, positions: np.ndarray) -> np.ndarray:
        """See `Maze`."""
        return positions[..., ::-1] / SCALE + self.marked("R")

    def goal_place(self) -> np.ndarray:
        """See `Maze`: goals lie in a square."""
        return self.middles(self.marked("G")) + self.goal_spread

    @property
    def goal_spread(self) -> float:
        """See `Maze`."""
        return sum(GOAL_NOISE) / 2

    def goal_in(self, cell: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """(2,) a place to go to in a cell (row, column)."""
        return self.middles(cell) + generator.uniform(0.0, GOAL_NOISE[0], 2) + generator.uniform(0.0, GOAL_NOISE[1], 2)

    def start_in(self, generator: np.random.Generator) -> np.ndarray:
        """(2,) where an episode begins: the start, or anywhere that the ant is not sent to."""
        if not self.anywhere:
            return np.zeros(2)
        taken = {*self.picked, tuple(self.marked("G").tolist())}
        free = [cell for cell in self.cells.tolist() if tuple(cell) not in taken]
        return self.middles(np.array(free[generator.integers(len(free))])) + generator.uniform(0.0, START_NOISE, 2)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "AntMazeSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return AntMazeSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of the package that the body is from."""
        return installed("gymnasium")


class AntMazeSimulator(MujocoCopies[AntMaze]):
    """Copies of one maze; see `MujocoCopies`.

    Attributes:
        goals: (copies, 2) of the present episodes.
        achieved: (copies,) bool, whether it has been reached.
    """

    def __init__(self, task: AntMaze, seeds: Sequence[int], threads: int | None = None):
        super().__init__(task, model(task.layout), seeds, threads, frame_skip=FRAME_SKIP)
        self.goals = np.zeros((len(seeds), 2))
        self.achieved = np.zeros(len(seeds), bool)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "goals": self.goals.copy(), "achieved": self.achieved.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self.goals[:], self.achieved[:] = state["goals"], state["achieved"]

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        """(positions + velocities + 2,) of a new episode, and its goal."""
        goal = self.task.goal_in(self.task.marked("G"), generator)
        place = self.task.start_in(generator)
        return np.concatenate([stance(self._first, place, generator), goal])

    def _begin(self, data: Any, copy: int, start: np.ndarray) -> None:
        super()._begin(data, copy, start[:-2])
        self.goals[copy], self.achieved[copy] = start[-2:], False

    def _observe(self, which: Any) -> np.ndarray:
        return self._moving[which].astype(np.float32)

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = np.linalg.norm(self._moving[:, :2] - self.goals, axis=1)
        reached = away <= self.task.reach
        self.achieved |= reached & self._alive
        return reached.astype(np.float64), reached


# ---- walking where one is told to ---------------------------------------------------------------------------------------

TURN = 60  # steps between two orders


@dataclass(frozen=True)
class AntReach(Task):
    """Open ground on which the ant learns to go where it is told: what its logs in mazes are made with (thesis 7.3).

    Orders are directions, new ones every 60 steps. The ant sees itself in a frame whose x axis is the direction (27: height,
    quaternion, joints, velocities; see `ahead`), so a goal anywhere is a goal ahead. Its distance is never seen: D4RL brought
    its goal vector to one length, too. A step earns the speed ahead (m/s), 0.5 for standing, and costs 0.05 of the squared
    action. Lying on the back, or a torso below 0.2 or above 1.0 m, ends the episode.
    """

    revision: ClassVar[int] = 1

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "AntReachSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return AntReachSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of the package that the body is from."""
        return installed("gymnasium")


class AntReachSimulator(MujocoCopies[AntReach]):
    """Copies of the open ground; see `MujocoCopies`."""

    def __init__(self, task: AntReach, seeds: Sequence[int], threads: int | None = None):
        super().__init__(task, model(""), seeds, threads, frame_skip=FRAME_SKIP)
        # When the first order ends, and the directions in radians.
        self._orders = np.zeros((len(seeds), 2 - (-task.horizon // TURN)))
        self._before = np.zeros((len(seeds), 2))  # the place a step ago

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "orders": self._orders.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self._orders[:] = state["orders"]

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        body = stance(self._first, np.zeros(2), generator)
        directions = generator.uniform(-np.pi, np.pi, self._orders.shape[1] - 1)
        return np.concatenate([body, [generator.integers(1, TURN + 1)], directions])

    def _begin(self, data: Any, copy: int, start: np.ndarray) -> None:
        size = POSITIONS + VELOCITIES
        super()._begin(data, copy, start[:size])
        self._orders[copy] = start[size:]

    def _direction(self) -> np.ndarray:
        """(copies,) radians of the present orders."""
        count = (self._age - self._orders[:, 0] + TURN) // TURN
        return np.take_along_axis(self._orders, 1 + count.astype(int)[:, None], 1)[:, 0]

    def _observe(self, which: Any) -> np.ndarray:
        return ahead(self._moving[which], self._direction()[which]).astype(np.float32)

    def _advance(self, running: np.ndarray, actions: np.ndarray) -> None:
        self._before[:] = self._moving[:, :2]
        super()._advance(running, actions)

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved, angle = (self._moving[:, :2] - self._before) / self._dt, self._direction()
        speed = moved[:, 0] * np.cos(angle) + moved[:, 1] * np.sin(angle)
        height, (x, y) = self._moving[:, 2], self._moving[:, 4:6].T
        upright = 1.0 - 2.0 * (x**2 + y**2)  # z of the torso's own z axis
        fallen = (height < 0.2) | (height > 1.0) | (upright < 0.0) | ~np.isfinite(self._moving).all(1)
        costs = 0.05 * np.square(actions, dtype=np.float64).sum(1)
        return speed + 0.5 * ~fallen - costs, fallen


def ahead(states: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(n, 27) what a walker sees: states (n, 29) without their place, in frames whose x axes point at angles (n,), radians.

    Of a quaternion and its negative, which are one rotation, it is the one whose first number is not negative.
    """
    half, cos, sin = angles / 2, np.cos(angles), np.sin(angles)
    w, x, y, z = states[:, 3:7].T
    c, s = np.cos(half), np.sin(half)
    turned = np.stack([c * w + s * z, c * x + s * y, c * y - s * x, c * z - s * w], 1)
    turned = np.where(turned[:, :1] < 0, -turned, turned)
    vx, vy = states[:, 15:17].T
    velocity = np.stack([cos * vx + sin * vy, cos * vy - sin * vx], 1)
    return np.concatenate([states[:, 2:3], turned, states[:, 7:15], velocity, states[:, 17:]], 1)


def stance(first: np.ndarray, place: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """(29,) positions and velocities of an ant that stands at a place, with noise."""
    positions = first + generator.uniform(-NOISE, NOISE, POSITIONS)
    positions[:2] += place
    return np.concatenate([positions, NOISE * generator.standard_normal(VELOCITIES)])


@lru_cache
def model(layout: str) -> Any:
    """The compiled model of an ant in a maze, or on open ground if the layout is empty; shared by all who step it."""
    mujoco = bindings()
    spec = mujoco.MjSpec.from_file(str(asset("gymnasium", "envs/mujoco/assets/ant.xml")))
    spec.option.timestep = TIMESTEP
    for motor in spec.actuators:
        motor.gear[0] = TORQUE
    rows = layout.split("/") if layout else []
    origin = np.array([(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "R"] or [(0, 0)])[0]
    for r, row in enumerate(rows):
        for c, cell in enumerate(row):
            if cell == "#":
                x, y = SCALE * (c - origin[1]), SCALE * (r - origin[0])
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX, pos=[x, y, SCALE / 4], size=[SCALE / 2, SCALE / 2, SCALE / 4],
                    contype=1, conaffinity=1, rgba=[0.7, 0.5, 0.3, 1.0],
                )  # fmt: skip
    for geom in spec.geoms:
        geom.solimp = [0.8, 0.8, 0.01, 0.5, 2.0]  # the last two are MuJoCo's own
    return spec.compile()


# ---- the tasks ----------------------------------------------------------------------------------------------------------

_ACTIONS = Box((-1.0,) * JOINTS, (1.0,) * JOINTS)
_PROPERTIES = ("non-Markovian policies", "sparse rewards", "high-dimensional", "long horizon", "temporally extended")
# Logs differ in where they begin and where the ant is sent, and are judged alike: at the start, with the goal in one cell.
_KINDS = {"umaze": ("", "diverse"), "medium": ("play", "diverse"), "large": ("play", "diverse")}


def _make(maze: str, kind: str) -> AntMaze:
    name = "-".join(filter(None, ("antmaze", maze, kind)))
    size = maze.removeprefix("eval-")
    published = Reference(0.0, 1.0, "D4RL: no goal reached, and every goal reached")
    title = "".join(part.title() for part in (*maze.split("-"), kind)).replace("Umaze", "UMaze")
    return AntMaze(
        name=name, domain="antmaze", horizon=700 if size == "umaze" else 1000, observation_shape=(POSITIONS + VELOCITIES,),
        action_space=_ACTIONS, gym_id=f"deadreckon/AntMaze{title}-v2", reference=published,
        published=published if maze == size else None, split="training" if maze == size else "evaluation",
        summary=f"walk on four legs to the goal of the {maze} maze; reward 1 within 0.5 m of it",
        properties=(*(("undirected data",) if kind else ()), *_PROPERTIES),
        source="D4RL (new there)", layout=LAYOUTS[maze], picked=PICKED[maze],
    )  # fmt: skip


REACH_TASK = AntReach(
    name="ant-reach", domain="antmaze", horizon=300, observation_shape=(POSITIONS + VELOCITIES - 2,), action_space=_ACTIONS,
    gym_id="deadreckon/AntReach-v0", reference=None,
    summary="walk on four legs to given positions on open ground; the walker of the AntMaze logs",
)  # fmt: skip

TASKS = tuple(_make(maze, kind) for maze in LAYOUTS for kind in _KINDS[maze.removeprefix("eval-")])
