"""Driving in a town: the counterpart of D4RL's `carla-town` that runs wherever numpy does (thesis 7.3 and D).

Steps and actions are those of D4RL's code, reward and ends follow it: the speed along the route counts, among 20 other cars and
traffic lights (`tasks/traffic.py`). The town is `road_maps.town`, the car that of `carla-lane-state`. D4RL's goal is a fixed
place, and nothing happens there, so here the route turns at random at junctions and has no end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.tasks.car import VELOCITY, WHEEL, YAW, X, Y, course, moved, off_the_road
from deadreckon.tasks.lane_table import LaneTable
from deadreckon.tasks.pixels import Pixels
from deadreckon.tasks.road_maps import town
from deadreckon.tasks.task import Reference, Starts, Task, checked_actions
from deadreckon.tasks.traffic import (
    BESIDE,
    CRUISE,
    GREEN,
    LENGTH,
    PHASE,
    RED,
    SHIFT,
    SPREAD,
    TURNS,
    YELLOW,
    Learner,
    Traffic,
    colours,
    slots,
    touching,
)

CARS = 20  # others
ROUTE = 99  # lanes of a route; as fast as the car can be, it comes to half of them
AHEAD = np.array([0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0])  # m, where the curvature of the route is seen
NEAREST, RADIUS = 5, 40.0  # how many other cars are seen, and m within which
LIGHT_SEEN = 50.0  # m, from which a light is seen
SPEED, OFFSET, HEADING, STEERED = range(4)  # columns of an observation
LIGHT = 4 + len(AHEAD)  # the first of the light's columns, its distance; behind it green, yellow, red
OTHERS, EACH = LIGHT + 4, 6  # the first of the other cars' columns, and columns of each
PRESENT, BEFORE, LEFT, APPROACH, SIDEWAYS, TURNED = range(EACH)
CRASHED = -100.0  # what a step earns in which the car hits another one or leaves the road


@dataclass(frozen=True)
class TownDriving(Task):
    """The task. An observation has 46 numbers.

    0 to 3: speed (m/s), offset from the middle of the route's lane (m, positive to the left), heading relative to it (rad), and
    angle of the front wheels (rad). 4 to 11: the curvature (1/m) of the route at `AHEAD`. 12: distance (m) from the front of
    the car to the line before the next light on the route, 50 where that is farther; 13 to 15: 1 if the light is green, yellow,
    red, all 0 where it is farther than 50 m. From 16 on, 6 numbers for each of the 5 nearest cars within 40 m, the nearest
    first: 1; place of its middle (m ahead and m to the left of ours); velocity relative to ours (m/s, ahead and to the left);
    heading relative to ours (rad). Those of cars that are not there are 0.

    Attributes:
        blocks: of the town, from west to east and from south to north.
        width: m, of a lane.
    """

    revision: ClassVar[int] = 1

    blocks: tuple[int, int] = (2, 3)
    width: float = 3.5

    @cached_property
    def table(self) -> LaneTable:
        """The lanes of the town."""
        return LaneTable(town(self.blocks, self.width))

    @cached_property
    def slots(self) -> tuple[np.ndarray, np.ndarray]:
        """Where cars may stand at a start."""
        return slots(self.table)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "TownSimulator":
        """See `Task.simulate`; all copies are stepped at once, without threads."""
        return TownSimulator(self, seeds)


class TownSimulator:
    """Copies of a town, in each of which one car is driven by actions.

    Attributes:
        cars: (copies, 5), see `moved`.
        distance: (copies,) m along the route.
        route: (copies, `ROUTE`) lanes.
        traffic: the other cars.
        clock: (copies, junctions) steps, by which lights switch.
        crashes: (copies,) bool, whether the last step ended in a collision or off the road.
        reds: (copies,) bool, whether it passed a red light.
    """

    def __init__(self, task: TownDriving, seeds: Sequence[int]):
        if (places := len(task.slots[0])) < CARS + 1:
            raise UserError(f"{task.name}: {CARS + 1} cars need as many places, and this town has {places}; make it larger")
        self.task, copies, junctions = task, len(seeds), len(task.table.network.junctions)
        self._starts = Starts(seeds, self._start)
        self.traffic = Traffic.empty(task.table, copies, CARS)
        self.cars, self.distance, self.clock = np.zeros((copies, 5)), np.zeros(copies), np.zeros((copies, junctions), int)
        self.route, self._begins = np.zeros((copies, ROUTE), int), np.zeros((copies, ROUTE))
        self._front, self._age, self._alive = np.zeros(copies), np.zeros(copies, int), np.zeros(copies, bool)
        self.crashes, self.reds = np.zeros(copies, bool), np.zeros(copies, bool)

    def _start(self, generator: np.random.Generator) -> np.ndarray:
        """One row: places of all cars, the learner's first; how these are shifted; speeds; lights; turns of all cars."""
        places = generator.permutation(len(self.task.slots[0]))[: CARS + 1]
        shifts = generator.uniform(-SHIFT, SHIFT, CARS + 1)
        cruise = generator.uniform(1.0 - SPREAD, 1.0 + SPREAD, CARS) * CRUISE
        clock = generator.integers(0, 12 * PHASE, len(self.task.table.network.junctions))  # 12 is 3 and 4 turns, whole
        turns = generator.uniform(size=ROUTE - 1 + CARS * TURNS)
        return np.concatenate([places, shifts, cruise, clock, turns])

    def _place(self, copy: int, start: np.ndarray) -> None:
        """Begins an episode of the copy; see `_start`."""
        table, (lanes, along) = self.task.table, self.task.slots
        parts = np.cumsum([CARS + 1, CARS + 1, CARS, self.clock.shape[1], ROUTE - 1])
        places, shifts, cruise, clock, route, turns = np.split(start, parts)
        where = places.astype(int)
        lanes, along = lanes[where], along[where] + shifts
        self.traffic.place(copy, lanes[1:], along[1:], cruise, turns.reshape(CARS, TURNS))
        self.clock[copy], self.route[copy] = clock.astype(int), table.ways(lanes[:1], route[None])[0]
        length = table.length[self.route[copy]]
        self._begins[copy] = np.cumsum(length) - length
        pose = table.pose(lanes[0], along[0])
        self.cars[copy] = pose.x, pose.y, pose.heading, 0.0, 0.0
        self.distance[copy], self._front[copy], self._age[copy], self._alive[copy] = along[0], along[0] + LENGTH / 2, 0, True

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """See `Simulator.reset`. All cars stand still at first, on the middles of their lanes."""
        which, starts = self._starts.begun(which, seeds)
        for copy, start in zip(which.tolist(), starts):
            self._place(copy, start)
        return self._observe()[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """See `Simulator.step`; a step earns the speed along the lane, in m/s.

        A collision and leaving the road earn `CRASHED`, passing a red light nothing; all of them end the episode.
        """
        running = self._alive
        actions = checked_actions(actions, (len(self.cars), 2), self.task.name, np.flatnonzero(running))
        shown, (line, light) = colours(self.task.table, self.clock), self._light()
        self.traffic.step(shown, self._learner(), running)
        # A car whose episode is over rests.
        self.cars[running] = moved(self.cars[running], actions[running])
        self.clock += running[:, None]
        self._age += running
        seen = self._observe()
        self.reds = (self._front > line) & (shown[np.arange(len(line)), light] == RED) & running
        others = np.stack(self.traffic.pose(), 2)
        off = off_the_road(self._offset, self.task.width)
        self.crashes = (off | touching(self.cars[:, [X, Y, YAW]], others).any(1)) & running
        along = self.cars[:, VELOCITY] * np.cos(course(self.cars) - self._lane)
        rewards = np.where(self.crashes, CRASHED, np.where(self.reds, 0.0, along))
        terminals = self.crashes | self.reds
        timeouts = running & ~terminals & (self._age >= self.task.horizon)
        self._alive = running & ~terminals & ~timeouts
        return seen, np.where(running, rewards, 0.0), terminals, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        traffic = {f"traffic_{name}": getattr(self.traffic, name).copy() for name in Traffic.NAMES}
        return self._starts.state() | traffic | {name: getattr(self, name).copy() for name in self._OWN}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._starts.restore(state)
        for name in Traffic.NAMES:
            setattr(self.traffic, name, state[f"traffic_{name}"].copy())
        for name in self._OWN:
            setattr(self, name, state[name].copy())

    _OWN = ("cars", "distance", "clock", "route", "_begins", "_front", "_age", "_alive")

    def picture(self, copy: int, size: tuple[int, int], renderer: Any = None) -> tuple[Any, np.ndarray]:
        """What the camera of a copy sees; see `LaneSimulator.picture`."""
        network, renderer = self.task.table.network, renderer or self.renderer(size)
        others = np.stack(self.traffic.pose(), 2)[copy]
        shown = colours(self.task.table, self.clock[[copy]])[0]
        of = {signal: int(colour) for each, colour in zip(network.controllers, shown) for signal in each.signals}
        return renderer, renderer.picture(*self.cars[copy, [X, Y, YAW]], others, [of[each.id] for each in network.signals])

    def renderer(self, size: tuple[int, int], plain: bool = False) -> Any:
        """What draws pictures of copies; see `LaneSimulator.renderer`."""
        from deadreckon.tasks.road_scene import Camera

        return Camera(self.task.table.network, size, others=CARS)

    def _on(self) -> np.ndarray:
        """(copies,) index into the route of the lane where each car is."""
        return (self._begins <= self.distance[:, None]).sum(1) - 1

    def _ahead(self, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(copies, k) lanes of the route, `offsets` (k,) lanes behind the present one, and m where they begin."""
        which = np.clip(self._on()[:, None] + offsets, 0, ROUTE - 1)
        return np.take_along_axis(self.route, which, 1), np.take_along_axis(self._begins, which, 1)

    def _project(self) -> None:
        """Notes how far each car and its front are on its route, its offset there, and the direction of the lane.

        Only near the last distance, lest progress jumps where the route crosses itself.
        """
        lanes, begins = self._ahead(np.array([-1, 0, 1]))
        near = self.distance[:, None] - begins
        low, high = np.clip(near - 10.0, 0.0, self.task.table.length[lanes]), near + 10.0
        found = self.task.table.project(self.cars[:, [X, Y]], lanes, low, high)
        best = np.abs(found.lateral).argmin(1)[:, None]
        pick = lambda column: np.take_along_axis(column, best, 1)[:, 0]  # noqa: E731
        self.distance, self._offset, self._lane = pick(begins + found.distance), pick(found.lateral), pick(found.heading)
        self._front = np.maximum(self._front, self.distance + LENGTH / 2)

    def _learner(self) -> Learner:
        """The learner's cars, as the others see them."""
        table, lanes = self.task.table, np.arange(len(self.task.table.length))[None]
        found = table.project(self.cars[:, [X, Y]], lanes, np.zeros((1, 1)), table.length[None])
        speed = self.cars[:, VELOCITY, None] * np.cos(course(self.cars)[:, None] - found.heading)
        present = np.abs(found.lateral) < BESIDE
        return Learner(present, found.distance, speed, table.incoming[self._ahead(np.array([0]))[0][:, 0]])

    def _light(self) -> tuple[np.ndarray, np.ndarray]:
        """(copies,) m along the route to the line before the next light, and the controller of that."""
        lanes, begins = self._ahead(np.arange(4))
        line = begins + self.task.table.line[lanes]
        first = np.where(line >= self._front[:, None], line, np.inf).argmin(1)[:, None]
        line, lane = np.take_along_axis(line, first, 1)[:, 0], np.take_along_axis(lanes, first, 1)[:, 0]
        return line, self.task.table.light[lane]

    def _observe(self) -> np.ndarray:
        """(copies, 46) float32, see `TownDriving`."""
        self._project()
        yaw, copies = self.cars[:, YAW], np.arange(len(self.cars))
        heading = (yaw - self._lane + np.pi) % (2.0 * np.pi) - np.pi
        own = np.stack([self.cars[:, VELOCITY], self._offset, heading, self.cars[:, WHEEL]], 1)
        lanes, begins = self._ahead(np.arange(4))
        at = self.distance[:, None] + AHEAD
        which = (begins[:, None, :] <= at[..., None]).sum(2) - 1
        bends = self.task.table.path.curvature[np.take_along_axis(lanes, which, 1)]
        line, light = self._light()
        away = np.minimum(line - self.distance - LENGTH / 2, LIGHT_SEEN)
        colour = np.where(away < LIGHT_SEEN, colours(self.task.table, self.clock)[copies, light], -1)
        lamps = [colour == each for each in (GREEN, YELLOW, RED)]
        return np.concatenate([own, bends, np.stack([away, *lamps], 1), self._others()], 1).astype(np.float32)

    def _others(self) -> np.ndarray:
        """(copies, 30) what is seen of other cars."""
        x, y, heading = self.traffic.pose()
        right, up = x - self.cars[:, [X]], y - self.cars[:, [Y]]
        away = np.hypot(right, up)
        order = np.argsort(away, 1, kind="stable")[:, :NEAREST]
        right, up, away, heading, speed = (
            np.take_along_axis(column, order, 1) for column in (right, up, away, heading, self.traffic.speed)
        )
        way, yaw = course(self.cars)[:, None], self.cars[:, [YAW]]
        over = speed * np.cos(heading) - self.cars[:, [VELOCITY]] * np.cos(way)
        across = speed * np.sin(heading) - self.cars[:, [VELOCITY]] * np.sin(way)
        cos, sin = np.cos(yaw), np.sin(yaw)
        turned = (heading - yaw + np.pi) % (2.0 * np.pi) - np.pi
        there = (away <= RADIUS).astype(float)
        place, velocity = (
            (right * cos + up * sin, up * cos - right * sin),
            (over * cos + across * sin, across * cos - over * sin),
        )
        return (np.stack([there, *place, *velocity, turned], 2) * there[..., None]).reshape(len(x), -1)


TASK = TownDriving(
    name="carla-town-state", domain="carla", horizon=1000, observation_shape=(OTHERS + NEAREST * EACH,),
    action_space=Box((-1.0, -1.0), (1.0, 1.0)), gym_id="deadreckon/CarlaTownState-v0",
    # Made by `python -m deadreckon.collect.references`, 100 episodes each.
    reference=Reference(147.5478, 2824.2895, "measured on this simulator: uniform actions, the controller of its logs"),
    summary="drive through a town among other cars and traffic lights", properties=("narrow data", "realistic"),
)  # fmt: skip

SEEN = Pixels.of(
    TASK, (48, 48), 1, "carla-town", gym_id="deadreckon/CarlaTown-v0", places_matter=True,
    summary="the same from images of 48 x 48 pixels",
)  # fmt: skip
TASKS = TASK, SEEN
