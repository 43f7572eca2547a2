"""Networks: roads, junctions and traffic lights, and which lane follows which."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

from deadreckon.errors import UserError
from deadreckon.tasks.road_paths import Path, gaps
from deadreckon.tasks.roads import BEND, DRIVING, GAP, LARGEST_ID, WIDEST, End, LaneKey, Road, number

Direction = Literal["+", "-"]
T = TypeVar("T", Road, "Junction", "Signal", "Controller")


@dataclass(frozen=True)
class Connection:
    """A way through a junction.

    Attributes:
        incoming: id of the road that comes in.
        connecting: id of the road that leads through.
        contact: the end of the connecting road at which it is entered.
        lanes: pairs of ids, a lane of the incoming road and the lane of the connecting road behind it.
    """

    incoming: int
    connecting: int
    contact: End
    lanes: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Junction:
    """Where roads meet.

    Attributes:
        id: above 0, and no road's, for CARLA tells them apart by nothing else.
        connections: the ways through.
        controllers: ids of the controllers of its traffic lights.
    """

    id: int
    connections: tuple[Connection, ...]
    controllers: tuple[int, ...] = ()


@dataclass(frozen=True)
class Signal:
    """A traffic light.

    Attributes:
        id: above 0.
        road: id of the road that it stands beside.
        s: m along the road's reference line.
        t: m to the left of it.
        orientation: "+" if it is for cars that drive along the reference line, "-" against it.
    """

    id: int
    road: int
    s: float
    t: float
    orientation: Direction


@dataclass(frozen=True)
class Controller:
    """What switches traffic lights together.

    Attributes:
        id: above 0.
        signals: ids of the lights that always show the same.
    """

    id: int
    signals: tuple[int, ...]


@dataclass(frozen=True)
class Network:
    """Roads, and how they hang together.

    Attributes:
        roads: at least one.
        junctions: where they meet.
        signals: traffic lights, which are put in the order of their ids.
        controllers: of these.

    Raises:
        UserError: an id stands twice, one that is needed stands for nothing, or a lane does not begin where one ends that it
            follows. One line says which. Lanes that are named as neighbours against the way they are driven are not looked at.
    """

    roads: tuple[Road, ...]
    junctions: tuple[Junction, ...] = ()
    signals: tuple[Signal, ...] = ()
    controllers: tuple[Controller, ...] = ()

    def __post_init__(self):
        # A file has them with their roads, so that another order would be lost.
        object.__setattr__(self, "signals", tuple(sorted(self.signals, key=lambda signal: signal.id)))
        if not self.roads:
            raise UserError("a network needs a road")
        roads, junctions, signals = self._road, self._junction, _by_id("signal", self.signals)
        both = roads.keys() & junctions.keys()
        if both:
            raise UserError(f"{min(both)} is the id of a road and of a junction")
        controllers = _by_id("controller", self.controllers)
        for road in self.roads:
            for link in (road.predecessor, road.successor):
                if link is not None:
                    _known(f"road {road.id}", link.kind, link.id, roads if link.kind == "road" else junctions)
            if road.junction != -1:
                _known(f"road {road.id}", "junction", road.junction, junctions)
        for junction in self.junctions:
            for each in junction.connections:
                for road, lanes in zip((each.incoming, each.connecting), zip(*each.lanes) if each.lanes else ((), ())):
                    _known(f"junction {junction.id}", "road", road, roads)
                    for lane in lanes:
                        roads[road].lane(lane)
                if roads[each.connecting].junction != junction.id:
                    raise UserError(f"junction {junction.id}: road {each.connecting} connects in it, but does not belong to it")
            for controller in junction.controllers:
                _known(f"junction {junction.id}", "controller", controller, controllers)
        for signal in self.signals:
            where = f"signal {signal.id}"
            _known(where, "road", signal.road, roads)
            number(where, "s", signal.s, 0.0, roads[signal.road].length)
            number(where, "t", signal.t, -2 * WIDEST, 2 * WIDEST)
        for controller in self.controllers:
            for signal in controller.signals:
                _known(f"controller {controller.id}", "signal", signal, signals)
        self._meet()

    def road(self, id: int) -> Road:
        """The road of that id.

        Raises:
            UserError: there is none.
        """
        _known("the network", "road", id, self._road)
        return self._road[id]

    def lane_path(self, lane: LaneKey) -> Path:
        """The middle of a lane, in the direction in which it is driven.

        Raises:
            UserError: there is none of these ids.
        """
        return self.road(lane[0]).lane_path(lane[1])

    @cached_property
    def following(self) -> dict[LaneKey, tuple[LaneKey, ...]]:
        """The lanes behind each lane that is driven on, in the order of the ids; none where it ends."""
        ways = {(junction.id, c.incoming): [] for junction in self.junctions for c in junction.connections}
        for junction in self.junctions:
            for c in junction.connections:
                ways[junction.id, c.incoming] += [(start, (c.connecting, end), c.contact) for start, end in c.lanes]
        found: dict[LaneKey, tuple[LaneKey, ...]] = {}
        for road in self.roads:
            for lane in road.lanes:
                if lane.kind != DRIVING:
                    continue
                link, next_ = (road.successor, lane.successor) if lane.id < 0 else (road.predecessor, lane.predecessor)
                behind: list[tuple[LaneKey, End | None]] = []
                if link is not None and link.kind == "junction":
                    behind = [(key, contact) for start, key, contact in ways.get((link.id, road.id), []) if start == lane.id]
                elif link is not None and next_ is not None:
                    behind = [((link.id, next_), link.contact)]
                found[road.id, lane.id] = tuple(sorted({self._entered((road.id, lane.id), *each) for each in behind}))
        return {key: tuple(each for each in behind if each in found) for key, behind in found.items()}

    def _entered(self, lane: LaneKey, next_: LaneKey, contact: End | None) -> LaneKey:
        """`next_`, which exists and is driven away from where it is entered."""
        self.road(next_[0]).lane(next_[1])
        if contact != ("start" if next_[1] < 0 else "end"):
            raise UserError(f"road {lane[0]}, lane {lane[1]} leads against road {next_[0]}, lane {next_[1]}")
        return next_

    def _meet(self) -> None:
        """Refuses lanes that do not begin where those end that they follow."""
        for lane, behind in self.following.items():
            path = self.lane_path(lane)
            end = path.pose(path.total)
            for next_ in behind:
                apart, bent = gaps(end, self.lane_path(next_).pose(0.0))
                if apart > GAP or bent > BEND:
                    raise UserError(
                        f"road {next_[0]}, lane {next_[1]} does not begin where road {lane[0]}, lane {lane[1]} ends before it: "
                        f"{apart:.3g} m and {bent:.3g} rad are between them"
                    )

    @cached_property
    def _road(self) -> dict[int, Road]:
        return _by_id("road", self.roads)

    @cached_property
    def _junction(self) -> dict[int, Junction]:
        return _by_id("junction", self.junctions)


def _by_id(kind: str, items: Iterable[T]) -> dict[int, T]:
    """Items by their ids, none of which stands twice."""
    found: dict[int, T] = {}
    for item in items:
        number(kind, "id", item.id, 1, LARGEST_ID)
        if item.id in found:
            raise UserError(f"two of {kind} {item.id}")
        found[item.id] = item
    return found


def _known(where: str, kind: str, id: int, known: Iterable[int]) -> None:
    if id not in known:
        raise UserError(f"{where}: no {kind} {id}")
