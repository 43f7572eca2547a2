"""Roads in SUMO: what they have in common, and the ring. `tasks/flow_world.py` simulates them.

A process holds one simulation (libsumo keeps it in global variables), and a simulation many copies of a road: pieces of one
network that are not joined. SUMO draws nothing at random here: what is random about an episode stands in its start. So a copy
depends on its start and its actions alone, to the last bit, whatever goes on beside it and however long the simulation has run.

Constants are those of D4RL's Flow tasks (Fu et al. 2020; Wu et al. 2017; Vinitsky et al. 2018); what differs is in the docs.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import numpy as np

STEP = 0.5  # seconds of a step of SUMO's
SPEED_LIMIT = 30.0  # m/s, of all roads and cars
CAR = 5.0  # m
FAR = 2000.0  # m, how far leaders and followers are looked for
# What SUMO checks before a car does as it is told, as bits.
SAFE_SPEED, RIGHT_OF_WAY, HARD_BRAKING = 1, 8, 16


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


def driver(name: str, acceleration: float = 2.6, deceleration: float = 4.5, gap: float = 2.5) -> str:
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
        return driver("human", acceleration=1.0, deceleration=1.5, gap=2.0) + driver("learner")

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
