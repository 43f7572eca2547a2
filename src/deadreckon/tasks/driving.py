"""Driving along a lane: the counterpart of D4RL's `carla-lane` that runs wherever numpy does (thesis 7.3 and D).

The road is a figure eight (`road_maps.figure_eight`); steps, actions, reward and ends are those of D4RL's code. CARLA's car is
replaced by a bicycle model, and its pictures by what a driver would read from them: speed, place in the lane, and the bends
ahead. `tasks/road_scene.py` draws what the camera would see.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.car import VELOCITY, WHEEL, YAW, X, Y, course, moved, off_the_road
from deadreckon.tasks.pixels import Pixels
from deadreckon.tasks.road_maps import figure_eight
from deadreckon.tasks.road_routes import Route
from deadreckon.tasks.roads import LaneKey
from deadreckon.tasks.task import Reference, Starts, Task, checked_actions

AHEAD = np.array([0.0, 5.0, 10.0, 20.0])  # m, where the curvature of the lane is seen
SPEED, OFFSET, HEADING, STEERED = range(4)  # columns of an observation, before the curvatures
MOST = 5.0  # of a step's reward, either way
LEFT_THE_ROAD = 100.0  # what that costs
START_OFFSET, START_HEADING = 0.2, 0.05  # m and rad, the largest at a start


@dataclass(frozen=True)
class LaneDriving(Task):
    """The task. An observation has 8 numbers: speed (m/s), offset from the middle of the lane (m, positive to the left),
    heading relative to it (rad), angle of the front wheels (rad), and the curvature (1/m) of the lane at `AHEAD`.

    Attributes:
        radius: m, of the arcs of the eight.
        width: m, of each of its two lanes.
    """

    revision: ClassVar[int] = 2

    radius: float = 20.0
    width: float = 3.5

    @cached_property
    def route(self) -> Route:
        """The right lane, once round."""
        network = figure_eight(self.radius, self.width)
        lanes: list[LaneKey] = [(1, -1)]
        while (behind := network.following[lanes[-1]]) and behind[0] != lanes[0]:
            lanes.append(behind[0])
        return Route(network, tuple(lanes), closed=True)

    @property
    def ends(self) -> Callable[[Any], Any]:
        """See `Task.ends`: where the middle of the car has left the road."""
        return self.off_the_road

    def off_the_road(self, observations: Any) -> Any:
        """(n,) bool of observations (n, 8); see `car.off_the_road`."""
        return off_the_road(observations[..., OFFSET], self.width)

    def start(self, generator: np.random.Generator) -> np.ndarray:
        """(3,) distance in m, offset in m and heading in rad: anywhere on the route, nearly in the middle of the lane."""
        most = np.array([self.route.total, START_OFFSET, START_HEADING])
        return generator.uniform([0.0, -START_OFFSET, -START_HEADING], most)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "LaneSimulator":
        """See `Task.simulate`; all copies are stepped at once, without threads."""
        return LaneSimulator(self, seeds)


class LaneSimulator:
    """Copies of one car on its lane.

    Attributes:
        cars: (copies, 5), see `moved`.
        distance: (copies,) m along the route.
    """

    def __init__(self, task: LaneDriving, seeds: Sequence[int]):
        self.task, copies = task, len(seeds)
        self._starts = Starts(seeds, task.start)
        self.cars, self.distance = np.zeros((copies, 5)), np.zeros(copies)
        self._age, self._alive = np.zeros(copies, int), np.zeros(copies, bool)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """See `Simulator.reset`. Cars stand still at first."""
        which, starts = self._starts.begun(which, seeds)
        distance, offset, heading = np.array(starts).reshape(-1, 3).T
        pose = self.task.route.pose(distance)
        x, y = pose.x - offset * np.sin(pose.heading), pose.y + offset * np.cos(pose.heading)
        self.cars[which] = np.stack([x, y, pose.heading + heading, 0.0 * x, 0.0 * x], 1)
        self.distance[which], self._age[which], self._alive[which] = distance, 0, True
        return self._observe()[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """See `Simulator.step`; a step earns clip(v_s - 5 |v_perp|, -5, 5) of the speeds along and across the lane."""
        running = self._alive
        actions = checked_actions(actions, (len(self.cars), 2), self.task.name, np.flatnonzero(running))
        # A car whose episode is over rests.
        self.cars[running] = moved(self.cars[running], actions[running])
        seen = self._observe()
        self._age += running
        relative = course(self.cars) - self._lane
        along, across = self.cars[:, VELOCITY] * np.cos(relative), self.cars[:, VELOCITY] * np.abs(np.sin(relative))
        off = self.task.off_the_road(seen) & running
        rewards = np.clip(along - 5.0 * across, -MOST, MOST) - LEFT_THE_ROAD * off
        timeouts = running & ~off & (self._age >= self.task.horizon)
        self._alive = running & ~off & ~timeouts
        return seen, np.where(running, rewards, 0.0), off, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        own = {"cars": self.cars, "distance": self.distance, "age": self._age, "alive": self._alive}
        return self._starts.state() | {name: column.copy() for name, column in own.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._starts.restore(state)
        self.cars, self.distance, self._age, self._alive = (state[n].copy() for n in ("cars", "distance", "age", "alive"))

    def picture(self, copy: int, size: tuple[int, int], renderer: Any = None) -> tuple[Any, np.ndarray]:
        """What the camera of a copy sees; see `road_scene.Camera`.

        Args:
            copy: which.
            size: height and width in pixels.
            renderer: one that an earlier call gave; None makes one.

        Returns:
            The renderer, and (height, width, 3) uint8.
        """
        renderer = renderer or self.renderer(size)
        return renderer, renderer.picture(*self.cars[copy, [X, Y, YAW]])

    def renderer(self, size: tuple[int, int], plain: bool = False) -> Any:
        """What draws pictures of copies; see `road_scene.Camera`. They are plain, with smoothed edges."""
        from deadreckon.tasks.road_scene import Camera

        return Camera(self.task.route.network, size)

    def _observe(self) -> np.ndarray:
        """(copies, 8) float32; notes how far each copy is, and the direction of its lane there."""
        route = self.task.route
        found = route.project(self.cars[:, [X, Y]], near=self.distance)
        self.distance, self._lane = found.distance, found.heading
        heading = (self.cars[:, YAW] - found.heading + np.pi) % (2.0 * np.pi) - np.pi
        bends = route.curvature_ahead(found.distance, AHEAD)
        own = np.stack([self.cars[:, VELOCITY], found.lateral, heading, self.cars[:, WHEEL]], 1)
        return np.concatenate([own, bends], 1).astype(np.float32)


TASK = LaneDriving(
    name="carla-lane-state", domain="carla", horizon=250, observation_shape=(4 + len(AHEAD),),
    action_space=Box((-1.0, -1.0), (1.0, 1.0)), gym_id="deadreckon/CarlaLaneState-v0",
    # Made by `python -m deadreckon.collect.references`, 100 episodes each.
    reference=Reference(21.3110, 1130.3935, "measured on this simulator: uniform actions, the controller of its logs"),
    summary="drive along the lane of a figure eight at 5 m/s and more", properties=("narrow data", "realistic"),
)  # fmt: skip

# What the original shows: pictures of 48 x 48 alone, with which a policy does not know how fast it drives.
SEEN = Pixels.of(
    TASK, (48, 48), 1, "carla-lane", gym_id="deadreckon/CarlaLane-v0", places_matter=True,
    summary="the same from images of 48 x 48 pixels",
)  # fmt: skip
TASKS = TASK, SEEN
