"""The highway with an on-ramp (Flow's merge; thesis 7.3; Fu et al. 2020)."""

from collections.abc import Iterable
from importlib import resources
from typing import Any

import numpy as np

from deadreckon.tasks.flow_roads import CAR, FAR, RIGHT_OF_WAY, SAFE_SPEED, SPEED_LIMIT, STEP, Road, Seen, driver


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
        return driver("car", gap=Merge.GAP)

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
