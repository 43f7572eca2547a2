"""Roads in SUMO, and the process that simulates them; the other end of the pipe is `tasks/flow.py`.

A process holds one simulation (libsumo keeps it in global variables), and a simulation many copies of a road: pieces of one
network that are not joined. SUMO draws nothing at random here: what is random about an episode stands in its start. So a copy
depends on its start and its actions alone, to the last bit, whatever goes on beside it and however long the simulation has run.

Constants are those of D4RL's Flow tasks (Fu et al. 2020; Wu et al. 2017; Vinitsky et al. 2018); what differs is in the docs.
"""

import importlib
import os
import signal
import struct
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import IO, Any, ClassVar, NamedTuple

import numpy as np

STEP = 0.5  # seconds of a step of SUMO's
SPEED_LIMIT = 30.0  # m/s, of all roads and cars
CAR = 5.0  # m
FAR = 2000.0  # m, how far leaders and followers are looked for
# What SUMO checks before a car does as it is told, as bits.
SAFE_SPEED, RIGHT_OF_WAY, HARD_BRAKING = 1, 8, 16
HEAD = struct.Struct("<cQ")  # of a message: what it is, and the bytes that follow


class Seen(NamedTuple):
    """What learners see of the road before them, (n, learners) each.

    Attributes:
        speed: m/s.
        leading: the leader's speed, m/s.
        gap: m from bumper to bumper.
        present: whether there is such a learner.
    """

    speed: np.ndarray
    leading: np.ndarray
    gap: np.ndarray
    present: np.ndarray


class Road(ABC):
    """One copy of a road with the cars on it.

    Attributes:
        observation_size: numbers in an observation.
        action_size: learners, each with its acceleration.
        substeps: steps of SUMO's a step of the environment.
        checks: of SUMO's on learners that are guarded.
        running: whether there are cars.
    """

    observation_size: ClassVar[int]
    action_size: ClassVar[int]
    substeps: ClassVar[int]
    checks: ClassVar[int]

    def __init__(self, sumo: Any, copy: int, horizon: int, guarded: bool):
        self.sumo, self.vehicle = sumo, sumo.vehicle
        self.copy, self.horizon, self.guarded = copy, horizon, guarded
        self.episode = -1
        self.running = False

    @staticmethod
    @abstractmethod
    def network(copies: int) -> str:
        """The network file of so many copies."""

    @staticmethod
    @abstractmethod
    def types() -> str:
        """The kinds of cars, as SUMO's XML."""

    @staticmethod
    @abstractmethod
    def start(generator: np.random.Generator, horizon: int) -> np.ndarray:
        """All that is random about an episode, as float64."""

    @staticmethod
    @abstractmethod
    def count(horizon: int) -> int:
        """Cars that take part in an episode."""

    @staticmethod
    @abstractmethod
    def learners(horizon: int) -> list[int]:
        """Their numbers among the cars of an episode."""

    @abstractmethod
    def begin(self, start: np.ndarray) -> None:
        """Puts the cars of a new episode on the road."""

    @abstractmethod
    def cars(self) -> Iterable[str]:
        """The cars that SUMO knows of."""

    @abstractmethod
    def drive(self, action: np.ndarray) -> None:
        """Says before each of SUMO's steps what the learners do in it."""

    @abstractmethod
    def observe(self) -> np.ndarray:
        """What the learners see."""

    @staticmethod
    @abstractmethod
    def read(observations: np.ndarray) -> "Seen":
        """What (n, observation_size) observations say, in m and m/s."""

    @abstractmethod
    def reward(self, action: np.ndarray) -> float:
        """Of the step that has been taken with this action."""

    @abstractmethod
    def traffic(self) -> list[tuple[int, float, float]]:
        """Number, position along the road in m, and speed in m/s of each car."""

    def departed(self, car: str) -> None:  # noqa: B027 (on the ring nothing comes and goes)
        """Takes in that a car has come onto the road."""

    def arrived(self, car: str) -> None:  # noqa: B027
        """Takes in that a car has left it."""

    def end(self) -> None:
        """Takes all cars away."""
        if self.running:
            for car in self.cars():
                self.vehicle.remove(car)
        self.running = False

    def name(self, number: int) -> str:
        """Of a car. None is used twice: SUMO forgets a removed car only after its next step."""
        return f"{self.copy}.{self.episode}.{number}"

    def accelerate(self, car: str, acceleration: float) -> None:
        """Asks for m/s^2 during SUMO's next step."""
        self.vehicle.setSpeed(car, max(self.vehicle.getSpeed(car) + acceleration * STEP, 0.0))


def _idm(name: str, acceleration: float = 2.6, deceleration: float = 4.5, gap: float = 2.5) -> str:
    """A kind of cars that SUMO drives by the intelligent driver model (Treiber et al. 2000); the defaults are Flow's."""
    return (
        f'<vType id="{name}" carFollowModel="IDM" accel="{acceleration}" decel="{deceleration}" minGap="{gap}" tau="1" '
        f'delta="4" length="{CAR}" maxSpeed="{SPEED_LIMIT}" speedFactor="1" speedDev="0" sigma="0"/>'
    )


class Ring(Road):
    """22 cars one behind the other on a ring (Sugiyama et al. 2008). The learner is the one that heads the bunch."""

    observation_size, action_size, substeps = 3, 1, 1
    checks = SAFE_SPEED + RIGHT_OF_WAY + HARD_BRAKING
    CARS = 22
    LENGTHS = 220, 270  # m, from and to
    BUNCHING = 50.0  # m before the learner, beside its share of the rest
    JITTER = 1.0  # m, half-width of the noise on where the cars stand
    SEEN_SPEED = 15.0  # m/s, which observed speeds are divided by
    SPEED_REWARD, ACTION_COST = 4.0 / 20.0, 4.0  # of the mean speed, and of the size of the learner's acceleration

    # SUMO cannot stretch a road, so two quarters of a ring come in pieces to choose from: tens and ones of its length, in m.
    HALF = 80.0
    TENS = {f"t{i}": 30.0 + 10.0 * i for i in range(6)}  # noqa: RUF012
    ONES = {f"o{i}": 30.0 + i for i in range(10)}  # noqa: RUF012

    @staticmethod
    def network(copies: int) -> str:
        """Two roads of `HALF` a copy, all of `ONES` from the first to the second, and all of `TENS` back."""
        ways = (("a", "b", {"x": Ring.HALF}), ("b", "c", Ring.ONES), ("c", "d", {"y": Ring.HALF}), ("d", "a", Ring.TENS))
        edges, nodes, joints = [], [], []
        for copy in range(copies):
            for (start, end, pieces), (_, _, others), x in zip(ways, (*ways[1:], ways[0]), range(4)):
                for piece, length in pieces.items():
                    edges.append(
                        f'<edge id="{copy}.{piece}" from="{copy}.{start}" to="{copy}.{end}" priority="1">'
                        f'<lane id="{copy}.{piece}_0" index="0" speed="{SPEED_LIMIT}" length="{length}" '
                        f'shape="{x},{copy} {(x + 1) % 4},{copy}"/></edge>'
                    )
                pairs = [(here, there) for here in pieces for there in others]
                joints += [
                    f'<connection from="{copy}.{here}" to="{copy}.{there}" fromLane="0" toLane="0" dir="s" state="M"/>'
                    for here, there in pairs
                ]
                # No piece is in another's way: of those side by side only one is used.
                none = "0" * len(pairs)
                requests = (f'<request index="{i}" response="{none}" foes="{none}" cont="0"/>' for i in range(len(pairs)))
                lanes, place = " ".join(f"{copy}.{piece}_0" for piece in pieces), f"{(x + 1) % 4},{copy}"
                nodes.append(
                    f'<junction id="{copy}.{end}" type="priority" x="{(x + 1) % 4}" y="{copy}" incLanes="{lanes}" intLanes="" '
                    f'shape="{place} {place}">{"".join(requests)}</junction>'
                )
        return "\n".join([*edges, *nodes, *joints])

    @staticmethod
    def types() -> str:
        """Flow's own drivers, and the learner."""
        return _idm("human", acceleration=1.0, deceleration=1.5, gap=2.0) + _idm("learner")

    @staticmethod
    def start(generator: np.random.Generator, horizon: int) -> np.ndarray:
        """(1 + cars,) the ring's length, and how far from its place each car stands."""
        low, high = Ring.LENGTHS
        return np.append(generator.integers(low, high + 1), generator.uniform(-Ring.JITTER, Ring.JITTER, Ring.CARS))

    @staticmethod
    def count(horizon: int) -> int:
        """22."""
        return Ring.CARS

    @staticmethod
    def learners(horizon: int) -> list[int]:
        """The last, before whom the gap is."""
        return [Ring.CARS - 1]

    def __init__(self, sumo: Any, copy: int, horizon: int, guarded: bool):
        super().__init__(sumo, copy, horizon, guarded)
        self.known: set[int] = set()  # lengths whose routes SUMO has

    def begin(self, start: np.ndarray) -> None:
        """All cars stand, evenly but for the gap before the learner."""
        self.episode += 1
        self.running = True
        self.length = int(start[0])
        even = np.arange(self.CARS) * (self.length - self.BUNCHING) / self.CARS
        self.first = ((even + start[1:]) % self.length).tolist()
        self.names = [self.name(number) for number in range(self.CARS)]
        self.leader, self.learner = self.names[0], self.names[-1]
        tens, ones = divmod(self.length - self.LENGTHS[0], 10)
        pieces = {"x": self.HALF, f"o{ones}": self.ONES[f"o{ones}"], "y": self.HALF, f"t{tens}": self.TENS[f"t{tens}"]}
        ring, ends = [f"{self.copy}.{piece}" for piece in pieces], np.cumsum([*pieces.values()])
        laps = int(self.horizon * self.substeps * STEP * SPEED_LIMIT / self.length) + 2
        routes = [f"{edge}.{self.length}" for edge in ring]
        if self.length not in self.known:
            self.known.add(self.length)
            for i, route in enumerate(routes):
                # Each begins one piece before the car's, so that SUMO knows what the car's rear stands on.
                self.sumo.route.add(route, [*ring[i - 1 :], *ring[: i - 1]] * laps)
        for car, where in zip(self.names, self.first):
            i = int(np.searchsorted(ends, where, "right"))
            place = where - (ends[i - 1] if i else 0.0)
            kind = "learner" if car == self.learner else "human"
            self.vehicle.add(car, routes[i], typeID=kind, departPos=str(place), departSpeed="0")
            self.vehicle.moveTo(car, f"{ring[i]}_0", place)  # at once, and not after SUMO's next step
        self.vehicle.setSpeedMode(self.learner, self.checks if self.guarded else 0)

    def cars(self) -> Iterable[str]:
        """All 22."""
        return self.names

    def drive(self, action: np.ndarray) -> None:
        """Accelerates the learner."""
        self.accelerate(self.learner, float(action[0]))

    def observe(self) -> np.ndarray:
        """(3,) the learner's speed, the leader's relative to it, and the way from front to front."""
        speed, leading = self.vehicle.getSpeed(self.learner), self.vehicle.getSpeed(self.leader)
        way = (self._place(0) - self._place(-1)) % self.length
        return np.array([speed / self.SEEN_SPEED, (leading - speed) / self.SEEN_SPEED, way / self.LENGTHS[1]])

    @staticmethod
    def read(observations: np.ndarray) -> Seen:
        """See `observe`."""
        speed, relative, way = observations.T[:, :, None].astype(np.float64)
        speed, gap = speed * Ring.SEEN_SPEED, way * Ring.LENGTHS[1] - CAR
        return Seen(speed, speed + relative * Ring.SEEN_SPEED, gap, np.ones(speed.shape, bool))

    def reward(self, action: np.ndarray) -> float:
        """The mean speed of all cars, less what accelerating costs."""
        speed = sum(map(self.vehicle.getSpeed, self.names)) / self.CARS
        return self.SPEED_REWARD * speed - self.ACTION_COST * abs(float(action[0]))

    def traffic(self) -> list[tuple[int, float, float]]:
        """Positions are between 0 and the ring's length."""
        return [
            (number, self._place(number) % self.length, self.vehicle.getSpeed(car)) for number, car in enumerate(self.names)
        ]

    def _place(self, number: int) -> float:
        return self.first[number] + self.vehicle.getDistance(self.names[number])


class Merge(Road):
    """A highway of one lane with an on-ramp, whose cars have the right of way; up to five of the cars are learners."""

    observation_size, action_size, substeps = 25, 5, 2
    checks = SAFE_SPEED + RIGHT_OF_WAY  # of all cars
    HIGHWAY, RAMP = ("inflow_highway", "left", "center"), ("inflow_merge", "bottom", "center")
    LENGTH = 900.0  # m of all roads together, which observed distances are divided by
    STANDING = 0.0, 180.0, 360.0, 540.0, 720.0  # m along the highway, where cars stand at the beginning
    # Seconds from one car to the next (1,800, 200 and 100 an hour), its road, its speed in m/s, and whether it is a learner.
    INFLOWS = (2.0, HIGHWAY, 10.0, False), (18.0, HIGHWAY, 10.0, True), (36.0, RAMP, 7.5, False)
    OPENING = 1.0  # s, when the first of each come
    # m along the highway at which each piece of it begins; the ramp ends where it joins the highway.
    JOINT = 624.63
    BEGINS = {"inflow_highway": 0.0, ":left_0": 100.0, "left": 100.1, ":center_1": 600.1, "center": JOINT, ":center_0": 601.68}  # noqa: RUF012
    RAMP_BEGINS = {"inflow_merge": 401.58, ":bottom_0": 501.58, "bottom": 501.68}  # noqa: RUF012
    GAP = 2.5  # m, SUMO's gaps are less than the true ones by this
    TARGET = 20.0  # m/s
    HEADWAY = 1.0  # s; learners that are closer to their leaders pay
    HEADWAY_COST = 0.1
    SPREAD = 0.1  # standard deviation of the share of the speed limit that drivers like

    @staticmethod
    def network(copies: int) -> str:
        """The same network again and again."""
        from xml.etree import ElementTree

        net = ElementTree.fromstring(resources.files("deadreckon.tasks").joinpath("assets", "merge.net.xml").read_text())
        parts = []
        for kind in ("edge", "junction", "connection"):  # SUMO reads them in this order
            text = "".join(ElementTree.tostring(each, "unicode") for each in net.findall(kind))
            parts += [text.replace("@", f"{copy}.") for copy in range(copies)]
        return "\n".join(parts)

    @staticmethod
    def types() -> str:
        """All cars are alike; learners are told apart by name."""
        return _idm("car", gap=Merge.GAP)

    @staticmethod
    def schedule(horizon: int) -> list[tuple[float, tuple[str, ...], float, bool]]:
        """When each car wants to come, and its line in `INFLOWS`; in time's order."""
        end = horizon * Merge.substeps * STEP
        cars = []
        for period, road, speed, learner in Merge.INFLOWS:
            cars += [(float(time), road, speed, learner) for time in np.arange(Merge.OPENING, end, period)]
        return sorted(cars, key=lambda car: car[0])

    @staticmethod
    def start(generator: np.random.Generator, horizon: int) -> np.ndarray:
        """(cars,) what share of the speed limit each driver likes, within SUMO's bounds."""
        return np.clip(generator.normal(1.0, Merge.SPREAD, Merge.count(horizon)), 0.2, 2.0)

    @staticmethod
    def count(horizon: int) -> int:
        """Those that stand on the road at the beginning, and those that want to come."""
        return len(Merge.STANDING) + len(Merge.schedule(horizon))

    @staticmethod
    def learners(horizon: int) -> list[int]:
        """One in ten of those on the highway."""
        return [len(Merge.STANDING) + i for i, (_, _, _, learner) in enumerate(Merge.schedule(horizon)) if learner]

    def __init__(self, sumo: Any, copy: int, horizon: int, guarded: bool):
        super().__init__(sumo, copy, horizon, guarded)
        self.coming = self.schedule(horizon)
        self.routes: dict[tuple[str, ...], str] = {road: f"{copy}.{road[0]}" for road in (self.HIGHWAY, self.RAMP)}
        for road, route in self.routes.items():
            sumo.route.add(route, [f"{copy}.{edge}" for edge in road])

    def begin(self, start: np.ndarray) -> None:
        """A few cars stand on an empty road."""
        self.episode += 1
        self.running = True
        self.time, self.likes = 0.0, start
        self.come = 0  # how many of those that are coming have
        self.waiting: dict[str, tuple[bool, bool]] = {}  # cars that SUMO has no room for yet: from the ramp, a learner
        self.present: dict[str, None] = {}  # the others, in the order in which they came
        self.highway: list[str] = []  # of these, those that came on the highway, and so are one behind the other,
        self.ramp: list[str] = []  # those that came on the ramp,
        self.driven: list[str] = []  # and the learners
        for number, place in enumerate(self.STANDING):
            car = self._add(number, self.HIGHWAY, 0.0)
            edge = max((edge for edge in self.HIGHWAY if self.BEGINS[edge] <= place), key=lambda edge: self.BEGINS[edge])
            self.vehicle.moveTo(car, f"{self.copy}.{edge}_0", place - self.BEGINS[edge])
            self.present[car] = None
            self.highway.insert(0, car)

    def _add(self, number: int, road: tuple[str, ...], speed: float) -> str:
        car = self.name(number)
        self.vehicle.add(car, self.routes[road], typeID="car", depart="now", departSpeed=str(speed))
        self.vehicle.setSpeedFactor(car, float(self.likes[number]))
        self.vehicle.setSpeedMode(car, self.checks)
        return car

    def cars(self) -> Iterable[str]:
        """Those on the road and those that wait."""
        return [*self.present, *self.waiting]

    def drive(self, action: np.ndarray) -> None:
        """Accelerates the first five learners; others drive as all do. Cars come whose time it is."""
        while self.come < len(self.coming) and self.coming[self.come][0] <= self.time:
            _, road, speed, learner = self.coming[self.come]
            self.waiting[self._add(len(self.STANDING) + self.come, road, speed)] = road is self.RAMP, learner
            self.come += 1
        for car, acceleration in zip(self.driven, action.tolist()):
            self.accelerate(car, acceleration)
        self.time += STEP

    def departed(self, car: str) -> None:
        """It has come onto the road; those that stood there at the beginning are known."""
        if car in self.waiting:
            self.present[car] = None
            ramp, learner = self.waiting.pop(car)
            (self.ramp if ramp else self.highway).append(car)
            if learner:
                self.driven.append(car)
                if not self.guarded:
                    self.vehicle.setSpeedMode(car, 0)

    def arrived(self, car: str) -> None:
        """It has left at the end of the highway. The learners behind it move up."""
        del self.present[car]
        for cars in (self.highway, self.ramp, self.driven):
            if car in cars:
                cars.remove(car)

    def observe(self) -> np.ndarray:
        """(25,) of each learner its speed, and of its leader and its follower their relative speeds and gaps; 0 of none."""
        seen = np.zeros((self.action_size, 5))
        for row, car in zip(seen, self.driven):
            speed = self.vehicle.getSpeed(car)
            leading, before = self._leader(car)
            following, behind = self._follower(car)
            row[:] = (
                speed / SPEED_LIMIT, (leading - speed) / SPEED_LIMIT, before / self.LENGTH,
                (speed - following) / SPEED_LIMIT, behind / self.LENGTH,
            )  # fmt: skip
        return seen.ravel()

    @staticmethod
    def read(observations: np.ndarray) -> Seen:
        """See `observe`; a learner that is there has a gap."""
        seen = observations.reshape(len(observations), -1, 5).astype(np.float64)
        speed = seen[..., 0] * SPEED_LIMIT
        return Seen(speed, speed + seen[..., 1] * SPEED_LIMIT, seen[..., 2] * Merge.LENGTH, np.any(seen, axis=-1))

    def _leader(self, car: str) -> tuple[float, float]:
        """Its speed, and the gap to it from bumper to bumper."""
        found = self.vehicle.getLeader(car, FAR)
        if not found or not found[0]:
            return SPEED_LIMIT, self.LENGTH
        return self.vehicle.getSpeed(found[0]), found[1] + self.GAP

    def _follower(self, car: str) -> tuple[float, float]:
        """Its speed and the gap to it. SUMO's own answer behind a joint depends on where things lie in its memory."""
        place = self._place(car)
        behind = self.highway[self.highway.index(car) + 1 :][:1]
        if place >= self.JOINT:
            behind += self.ramp
        gaps = [(place - self._place(other) - CAR, other) for other in behind]
        gap, other = min(((gap, other) for gap, other in gaps if gap > -CAR), default=(self.LENGTH, ""))
        return self.vehicle.getSpeed(other) if other else 0.0, gap

    def _place(self, car: str) -> float:
        """Along the highway in m; on the ramp as far before the joint."""
        edge = self.vehicle.getRoadID(car).replace(f"{self.copy}.", "")
        return (self.BEGINS | self.RAMP_BEGINS)[edge] + self.vehicle.getLanePosition(car)

    def reward(self, action: np.ndarray) -> float:
        """How near all cars are to the speed that is wanted, less what following closely costs; never below 0."""
        if not self.present:
            return 0.0
        speeds = np.fromiter(map(self.vehicle.getSpeed, self.present), float, len(self.present))
        most = self.TARGET * np.sqrt(len(speeds))
        near = max(most - float(np.linalg.norm(speeds - self.TARGET)), 0.0) / most
        close = 0.0
        for car in self.driven[: self.action_size]:
            found, speed = self.vehicle.getLeader(car, FAR), self.vehicle.getSpeed(car)
            if found and found[0] and speed > 0.0:
                close += min(max(found[1] + self.GAP, 0.0) / speed / self.HEADWAY - 1.0, 0.0)
        return max(near + self.HEADWAY_COST * close, 0.0)

    def traffic(self) -> list[tuple[int, float, float]]:
        """Positions are along the highway, which is 724.6 m long; of cars on the ramp they are NaN."""
        shown = []
        for car in self.present:
            on_ramp = car in self.ramp and self._place(car) < self.BEGINS[":center_0"]
            place = float("nan") if on_ramp else self._place(car)
            shown.append((int(car.rsplit(".", 1)[1]), place, self.vehicle.getSpeed(car)))
        return shown


ROADS: dict[str, type[Road]] = {"ring": Ring, "merge": Merge}


class World:
    """Copies of a road in one simulation.

    Args:
        road: among `ROADS`.
        copies: of it.
        horizon: steps of an episode.
        guarded: whether SUMO keeps learners from crashing.
    """

    def __init__(self, road: str, copies: int, horizon: int, guarded: bool):
        self.sumo: Any = importlib.import_module("libsumo")
        kind = ROADS[road]
        place = '<location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>'
        with tempfile.TemporaryDirectory() as folder:
            network, types = Path(folder) / "roads.net.xml", Path(folder) / "types.add.xml"
            network.write_text(f'<net version="1.20">\n{place}\n{kind.network(copies)}\n</net>')
            types.write_text(f"<additional>{kind.types()}</additional>")
            options = {
                "net-file": network, "additional-files": types, "step-length": STEP, "xml-validation": "never",
                "no-step-log": True, "no-warnings": True, "no-internal-links": road == "ring", "time-to-teleport": -1,
                "collision.action": "warn", "collision.mingap-factor": 0,
            }  # fmt: skip
            self.sumo.start(["sumo", *(word for key, value in options.items() for word in (f"--{key}", str(value).lower()))])
        self.roads = [kind(self.sumo, copy, horizon, guarded) for copy in range(copies)]

    def begin(self, which: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(which, observation_size) float32, of new episodes in these copies."""
        for copy, start in zip(which.tolist(), starts):
            self.roads[copy].end()
            self.roads[copy].begin(start)
        return np.array([self.roads[copy].observe() for copy in which.tolist()], np.float32)

    def end(self, which: np.ndarray) -> None:
        """Takes the cars of these copies away."""
        for copy in which.tolist():
            self.roads[copy].end()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Takes (copies, action_size) accelerations in m/s^2; gives float32 observations and rewards, and uint8 crashes.

        Copies without cars rest: zeros.
        """
        copies = len(self.roads)
        seen = np.zeros((copies, self.roads[0].observation_size), np.float32)
        rewards, crashed = np.zeros(copies, np.float32), np.zeros(copies, np.uint8)
        running = [road for road in self.roads if road.running]
        for _ in range(self.roads[0].substeps):
            for road in running:
                road.drive(actions[road.copy])
            self.sumo.simulationStep()
            for car in self.sumo.simulation.getDepartedIDList():
                self._road(car).departed(car)
            for car in self.sumo.simulation.getArrivedIDList():
                self._road(car).arrived(car)
            for car in self.sumo.simulation.getCollidingVehiclesIDList():
                crashed[self._road(car).copy] = True
        for road in running:
            seen[road.copy] = road.observe()
            if not crashed[road.copy]:
                rewards[road.copy] = road.reward(actions[road.copy])
        return seen, rewards, crashed

    def _road(self, car: str) -> Road:
        return self.roads[int(car.split(".", 1)[0])]

    def traffic(self, which: np.ndarray) -> np.ndarray:
        """(cars, 4) float64 position in `which`, number of the car, its position in m, and its speed in m/s."""
        roads = [(i, self.roads[copy]) for i, copy in enumerate(which.tolist())]
        rows = [(i, *car) for i, road in roads if road.running for car in road.traffic()]
        return np.array(rows, np.float64).reshape(-1, 4)


def read(stream: IO[bytes]) -> tuple[bytes, bytes] | None:
    """A message: a letter and what follows it; None where the stream has ended."""
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    letter, size = HEAD.unpack(head)
    body = stream.read(size)
    return (letter, body) if len(body) == size else None


def write(stream: IO[bytes], letter: bytes, *arrays: np.ndarray) -> None:
    """Sends a message; see `read`."""
    body = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    stream.write(HEAD.pack(letter, len(body)) + body)
    stream.flush()


def serve(road: str, copies: int, horizon: int, guarded: bool) -> None:
    """Simulates what standard input asks for until it ends, as it does when whoever asks is gone, however they went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever asks
    asked = sys.stdin.buffer
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libsumo prints is no answer
    world = World(road, copies, horizon, guarded)
    kind = ROADS[road]
    while (message := read(asked)) is not None:
        letter, body = message
        if letter == b"S":
            write(answers, b"S", *world.step(np.frombuffer(body, np.float32).reshape(copies, kind.action_size)))
            continue
        count = int(np.frombuffer(body, np.int64, 1)[0])
        which = np.frombuffer(body, np.int64, count, offset=8)
        if letter == b"B":
            write(answers, b"B", world.begin(which, np.frombuffer(body, np.float64, offset=8 * (1 + count)).reshape(count, -1)))
        elif letter == b"E":
            world.end(which)
            write(answers, b"E")
        elif letter == b"T":
            write(answers, b"T", world.traffic(which))
