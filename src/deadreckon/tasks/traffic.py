"""Other cars in a town and its traffic lights, for many towns at once.

Cars are on rails, the middles of lanes; they follow one another by the intelligent driver model (Treiber et al. 2000), turn at
random, slow down before bends, and stop before red lights and before junctions that are not clear.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadreckon.tasks.car import STEP
from deadreckon.tasks.lane_table import NONE, LaneTable

LENGTH, WIDTH = 4.5, 1.8  # m, of every car
# The intelligent driver model.
ACCELERATION, COMFORT, HARDEST = 2.0, 3.0, 8.0  # m/s², how fast a car gathers speed, and brakes, and can brake
HEADWAY, STANDSTILL, EXPONENT = 1.2, 2.0, 4  # s, m
CRUISE, SPREAD = 8.0, 0.2  # m/s on free roads, and by which part of it cars differ either way
ACROSS, SLOWING = 2.5, 1.5  # m/s² across in bends, and along before them
SEEN = 5  # lanes of a way that are known: the one before, the present one and three more
BESIDE = 2.1  # m from the middle of a lane, within which the learner's car is in the way there
SLOT = 12.0  # m from the middle of a car to the next at a start
SHIFT = 1.0  # m by which these places differ at random, either way
TURNS = 24  # drawn for each car; they repeat, but no car comes to so many junctions in an episode
# Steps that a light is green and yellow, and that all of a junction are red afterwards.
GREEN_FOR, YELLOW_FOR, CLEAR_FOR = 100, 40, 40
PHASE = GREEN_FOR + YELLOW_FOR + CLEAR_FOR
GREEN, YELLOW, RED = range(3)


def acceleration(
    speed: np.ndarray, wanted: np.ndarray | float, gap: np.ndarray | float, closing: np.ndarray | float
) -> np.ndarray:
    """(...) m/s² of the intelligent driver model (Treiber et al. 2000, eqs. 2 and 3), not below what brakes can do.

    Args:
        speed: (...) m/s.
        wanted: (...) m/s on a free road.
        gap: (...) m to what is ahead, inf for nothing.
        closing: (...) m/s by which that is slower.
    """
    dynamic = speed * HEADWAY + speed * closing / (2.0 * np.sqrt(ACCELERATION * COMFORT))
    desired = STANDSTILL + np.maximum(dynamic, 0.0)
    interaction = np.square(desired / np.maximum(gap, 0.01))
    return np.maximum(ACCELERATION * (1.0 - (speed / wanted) ** EXPONENT - interaction), -HARDEST)


def colours(table: LaneTable, clock: np.ndarray) -> np.ndarray:
    """(n, controllers) what lights show: at each junction one controller after the other has its turn.

    Args:
        table: of the lanes.
        clock: (n, junctions) steps, which may be any.
    """
    junction, turn, turns = table.switched
    into = clock[:, junction] % (PHASE * turns) - PHASE * turn
    colour = np.where(into < GREEN_FOR, GREEN, np.where(into < GREEN_FOR + YELLOW_FOR, YELLOW, RED))
    return np.where(into >= 0, colour, RED)


class Learner(NamedTuple):
    """Where the learner's car is, as other cars see it.

    Attributes:
        present: (n, lanes) bool, whether it is in the way on a lane.
        along: (n, lanes) m along that lane.
        speed: (n, lanes) m/s in the direction of that lane.
        incoming: (n,) the lane by which it has come to the junction where it is, by its route.
    """

    present: np.ndarray
    along: np.ndarray
    speed: np.ndarray
    incoming: np.ndarray


@dataclass
class Traffic:
    """Cars of n towns, (n, cars, ...) each.

    Attributes:
        table: of the lanes.
        way: (n, cars, `SEEN`) int, lanes: the one before, the present one, and those that follow.
        along: m along the present lane, of the middle of the car.
        speed: m/s.
        cruise: m/s that it drives on a free road.
        turns: (n, cars, `TURNS`) in [0, 1), which way it takes where.
        turned: int, how many of them have been used.
    """

    table: LaneTable
    way: np.ndarray
    along: np.ndarray
    speed: np.ndarray
    cruise: np.ndarray
    turns: np.ndarray
    turned: np.ndarray

    NAMES = ("way", "along", "speed", "cruise", "turns", "turned")

    @classmethod
    def empty(cls, table: LaneTable, towns: int, cars: int) -> "Traffic":
        """Cars that are to be put somewhere by `place`."""
        shape = towns, cars
        along, speed, cruise = np.zeros(shape), np.zeros(shape), np.ones(shape)
        way, turns = np.zeros((*shape, SEEN), int), np.zeros((*shape, TURNS))
        return cls(table, way, along, speed, cruise, turns, np.zeros(shape, int))

    def place(self, town: int, lanes: np.ndarray, along: np.ndarray, cruise: np.ndarray, turns: np.ndarray) -> None:
        """Puts the cars of a town at rest on lanes (cars,), so many m (cars,) along them; see the attributes."""
        ways = self.table.ways(lanes, turns[:, : SEEN - 2])
        self.way[town] = np.concatenate([ways[:, :1], ways], 1)
        self.along[town], self.speed[town], self.cruise[town], self.turns[town] = along, 0.0, cruise, turns
        self.turned[town] = SEEN - 2

    def step(self, shown: np.ndarray, learner: Learner, running: np.ndarray) -> None:
        """Drives all cars for a step in the towns `running` (n,) bool, by what lights show, (n, controllers)."""
        before = self._offsets()
        wanted = self._wanted(before)
        ahead, closing = self._leading(before)
        force = acceleration(self.speed, wanted, ahead, closing)
        force = np.minimum(force, acceleration(self.speed, wanted, *self._behind_learner(before, learner)))
        stop = self._line(before, shown, learner)
        force = np.minimum(force, acceleration(self.speed, wanted, stop, self.speed))
        force = np.where(running[:, None], force, 0.0)
        speed = np.maximum(self.speed + force * STEP, 0.0)
        self.along += np.where(running[:, None], (self.speed + speed) / 2.0 * STEP, 0.0)
        self.speed = np.where(running[:, None], speed, self.speed)
        self._enter()

    def pose(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x and y in m and heading in rad of all cars."""
        pose = self.table.pose(self.way[..., 1], self.along)
        return pose.x, pose.y, pose.heading

    def _enter(self) -> None:
        """Cars at the end of their lane enter the next."""
        length = self.table.length[self.way[..., 1]]
        over = self.along >= length
        if not over.any():
            return
        self.along[over] -= length[over]
        turn = np.take_along_axis(self.turns, self.turned[..., None] % TURNS, 2)[..., 0]
        last = self.table.after(self.way[over][:, -1], turn[over])
        self.way[over] = np.concatenate([self.way[over][:, 1:], last[:, None]], 1)
        self.turned += over

    def _offsets(self) -> np.ndarray:
        """(n, cars, `SEEN`) m from the middle of the car to where the lanes of its way begin."""
        length = self.table.length[self.way]
        begins = np.concatenate([-length[..., :1], np.cumsum(length[..., 1:], 2) - length[..., 1:]], 2)
        return begins - self.along[..., None]

    def _wanted(self, before: np.ndarray) -> np.ndarray:
        """(n, cars) m/s on a free road: less in bends, and before them as much less as brings it down gently."""
        bend = np.abs(self.table.path.curvature[self.way[..., 1:]])
        allowed = ACROSS / np.maximum(bend, 1e-6) + 2.0 * SLOWING * np.maximum(before[..., 1:], 0.0)
        return np.minimum(self.cruise, np.sqrt(allowed.min(2)))

    def _leading(self, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, cars) m to the next car ahead, and m/s by which it is slower.

        Ways that leave a junction's entry side by side count as one, for cars on them are in each other's way at first.
        """
        lane = self.way[..., 1]
        of = self.table.incoming + len(self.table.length) * (self.table.junction != NONE)
        ahead = np.full((*lane.shape, lane.shape[1]), np.inf)  # (n, who, whom)
        for k in range(1, SEEN):
            apart = before[..., k, None] + self.along[:, None, :]  # exactly 0 to itself
            there = (of[self.way[..., k]][..., None] == of[lane][:, None, :]) & (apart > 0.0)
            ahead = np.where(there & (apart < ahead), apart, ahead)
        first = ahead.argmin(2)
        nearest = np.take_along_axis(ahead, first[..., None], 2)[..., 0]
        return nearest - LENGTH, self.speed - np.take_along_axis(self.speed, first, 1)

    def _behind_learner(self, before: np.ndarray, learner: Learner) -> tuple[np.ndarray, np.ndarray]:
        """(n, cars) m to the learner's car, where it is ahead, and m/s by which it is slower."""
        town = np.arange(len(self.way))[:, None, None]
        way = self.way[..., 1:]
        apart = before[..., 1:] + learner.along[town, way]
        apart = np.where(learner.present[town, way] & (apart > 0.0), apart, np.inf)
        first = apart.argmin(2)[..., None]
        lane = np.take_along_axis(way, first, 2)
        nearest = np.take_along_axis(apart, first, 2)[..., 0]
        return nearest - LENGTH, self.speed - learner.speed[town, lane][..., 0]

    def _line(self, before: np.ndarray, shown: np.ndarray, learner: Learner) -> np.ndarray:
        """(n, cars) m from the front of the car to the line where it has to stop, inf for none."""
        way, town = self.way[..., 1:-1], np.arange(len(self.way))[:, None]
        apart = before[..., 1:-1] + self.table.line[way] - LENGTH / 2
        apart = np.where(apart > 0.0, apart, np.inf)
        first = apart.argmin(2)[..., None]
        apart = np.take_along_axis(apart, first, 2)[..., 0]
        lane = np.take_along_axis(way, first, 2)[..., 0]
        into = self.table.junction[np.take_along_axis(self.way[..., 2:], first, 2)[..., 0]]
        needed = np.square(self.speed) / (2.0 * np.maximum(apart, 0.01))
        colour = shown[town, self.table.light[lane]]
        stop = (colour == RED) | ((colour == YELLOW) & (needed <= COMFORT))
        stop |= self._taken(lane, into, learner) & (needed <= HARDEST)
        return np.where(stop, apart, np.inf)

    def _taken(self, lane: np.ndarray, into: np.ndarray, learner: Learner) -> np.ndarray:
        """(n, cars) bool, whether somebody who has come another way than `lane` is in the junction `into`."""
        junction, incoming = self.table.junction, self.table.incoming
        # A car whose tail is still in the junction is in it.
        at = np.where(self.along < LENGTH / 2, self.way[..., 0], self.way[..., 1])
        at = np.where(junction[self.way[..., 1]] != NONE, self.way[..., 1], at)
        taken = ((junction[at][:, None, :] == into[..., None]) & (incoming[at][:, None, :] != lane[..., None])).any(2)
        inside = np.stack([learner.present[:, junction == j].any(1) for j in range(junction.max() + 1)], 1)
        there = inside[np.arange(len(lane))[:, None], into] & (learner.incoming[:, None] != lane)
        return taken | there


def slots(table: LaneTable) -> tuple[np.ndarray, np.ndarray]:
    """Lanes outside of junctions, and m along them, where cars may stand at a start: `SLOT` apart, clear of lines."""
    lanes, along = [], []
    for lane in np.flatnonzero(table.junction == NONE):
        last = min(table.line[lane], table.length[lane]) - LENGTH / 2 - SHIFT
        for at in np.arange(SLOT / 2, last, SLOT):
            lanes.append(lane)
            along.append(at)
    return np.array(lanes), np.array(along)


def touching(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n, k) bool, whether cars (n, 3) touch others (n, k, 3): x and y in m, and heading in rad, of rectangles.

    Two rectangles are apart if the direction of a side of one of them separates them (the separating axis theorem).
    """
    right, up = others[..., 0] - one[:, None, 0], others[..., 1] - one[:, None, 1]
    turn = others[..., 2] - one[:, None, 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    long, wide = LENGTH / 2 * (1.0 + cos) + WIDTH / 2 * sin, WIDTH / 2 * (1.0 + cos) + LENGTH / 2 * sin
    apart = np.zeros(right.shape, bool)
    for heading in (np.broadcast_to(one[:, None, 2], right.shape), others[..., 2]):
        ahead, left = right * np.cos(heading) + up * np.sin(heading), up * np.cos(heading) - right * np.sin(heading)
        apart |= (np.abs(ahead) > long) | (np.abs(left) > wide)
    return ~apart
