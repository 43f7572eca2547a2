"""Routes through networks: which lanes are driven one after the other, where a car is on its way, and what lies ahead."""

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.road_network import Network, Signal
from deadreckon.tasks.road_paths import Path, Pose, Projection, joined
from deadreckon.tasks.roads import LaneKey


@dataclass(frozen=True, eq=False)
class Route:
    """Lanes that are driven one after the other. Distances are m along their middles, from where the first is entered.

    On a closed route distances count on from lap to lap, and any distance is on it. Others end at their ends.

    Attributes:
        network: that it leads through.
        lanes: ids of a road and of a lane on it, in the order of travel, at least one; a lane may come twice.
        closed: whether the first follows the last.

    Raises:
        UserError: a lane does not exist, or does not follow the one before.
    """

    network: Network
    lanes: tuple[LaneKey, ...]
    closed: bool = False

    def __post_init__(self):
        if not self.lanes:
            raise UserError("a route needs a lane")
        pairs = list(zip(self.lanes, self.lanes[1:] + (self.lanes[:1] if self.closed else ())))
        for lane in self.lanes:
            self.network.lane_path(lane)
        for lane, next_ in pairs:
            if next_ not in self.network.following.get(lane, ()):
                raise UserError(f"road {next_[0]}, lane {next_[1]} does not follow road {lane[0]}, lane {lane[1]}")

    @cached_property
    def path(self) -> Path:
        """The middles of the lanes, as one path."""
        return joined([self.network.lane_path(lane) for lane in self.lanes], self.closed)

    @property
    def total(self) -> float:
        """Its length, in m; of one lap, if it is closed."""
        return self.path.total

    @cached_property
    def starts(self) -> np.ndarray:
        """(lanes + 1,) distance at which each lane begins, in m, and behind these the length."""
        return self.path.starts[self._first_pieces]

    def pose(self, distance: np.ndarray | float) -> Pose:
        """Poses (...) in the direction of travel at distances (...) in m."""
        return self.path.pose(distance)

    def curvature_ahead(self, distance: np.ndarray, ahead: np.ndarray) -> np.ndarray:
        """(n, k) curvature in 1/m, at `ahead` (k,) m before each of `distance` (n,) m; beyond an end, that at the end."""
        return self.path.pose(np.asarray(distance)[:, None] + np.asarray(ahead)).curvature

    def project(self, points: np.ndarray, near: np.ndarray | float | None = None, window: float = 10.0) -> Projection:
        """Where points (n, 2) are on the route; see `Path.project`."""
        return self.path.project(points, near, window)

    def locate(self, distance: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Which lane a distance lies on.

        Args:
            distance: (...) m.

        Returns:
            (...) int index into `lanes`, and (...) m along the reference line of that lane's road, OpenDRIVE's s.
        """
        distance = self.path.within(distance)
        piece = self.path.piece(distance)
        along = (distance - self.path.starts[piece]) / self.path.length[piece]
        span = self._s[piece]
        s = span[..., 0] + along * (span[..., 1] - span[..., 0])
        return np.searchsorted(self._first_pieces, piece, "right") - 1, s

    def signals(self) -> tuple[tuple[float, Signal], ...]:
        """Traffic lights that hold for who drives along, each with its distance in m, in the order of travel."""
        found = []
        for i, (road, lane) in enumerate(self.lanes):
            for signal in self.network.signals:
                if signal.road == road and signal.orientation == ("+" if lane < 0 else "-"):
                    found.append((float(self.starts[i] + self._distance((road, lane), signal.s)), signal))
        return tuple(sorted(found, key=lambda each: each[0]))

    def _distance(self, key: LaneKey, s: float) -> float:
        """m from where a lane is entered to s m along the reference line of its road."""
        road, lane = key
        line, path = self.network.road(road).path, self.network.lane_path(key)
        starts = path.total - path.starts[::-1] if lane > 0 else path.starts
        distance = float(np.interp(s, line.starts, starts))
        return path.total - distance if lane > 0 else distance

    @cached_property
    def _first_pieces(self) -> np.ndarray:
        """(lanes + 1,) the first piece of each lane, and behind these how many there are."""
        return np.cumsum([0, *(len(self.network.lane_path(lane).length) for lane in self.lanes)])

    @cached_property
    def _s(self) -> np.ndarray:
        """(pieces, 2) s of their roads, in m, where pieces are entered and left."""
        spans = []
        for road, lane in self.lanes:
            starts = self.network.road(road).path.starts
            span = np.stack([starts[:-1], starts[1:]], axis=1)
            spans.append(span[::-1, ::-1] if lane > 0 else span)
        return np.concatenate(spans)


def routes(network: Network) -> dict[LaneKey, tuple[LaneKey, ...]]:
    """The graph of lanes: for each that is driven on, those that follow it, through junctions too."""
    return network.following


def shortest_route(network: Network, start: LaneKey, goal: LaneKey) -> Route:
    """The route of least length from the beginning of one lane to the end of another; of several, always the same.

    Args:
        network: of roads.
        start: ids of a road and of a lane on it.
        goal: the same; if it is `start`, the route is that lane alone.

    Raises:
        UserError: no way leads there, or there is no such lane.
    """
    for lane in (start, goal):
        network.lane_path(lane)
    before: dict[LaneKey, LaneKey | None] = {}
    queue: list[tuple[float, LaneKey, LaneKey | None]] = [(0.0, start, None)]
    while queue:
        way, lane, previous = heapq.heappop(queue)
        if lane in before:
            continue
        before[lane] = previous
        if lane == goal:
            return Route(network, tuple(_back(before, goal))[::-1])
        length = network.lane_path(lane).total
        for next_ in network.following.get(lane, ()):
            heapq.heappush(queue, (way + length, next_, lane))
    raise UserError(f"no way leads from road {start[0]}, lane {start[1]} to road {goal[0]}, lane {goal[1]}")


def random_route(network: Network, start: LaneKey, length: float, generator: np.random.Generator) -> Route:
    """A route that takes any way at each junction, all with the same probability.

    Args:
        network: of roads.
        start: ids of the first road and of the lane on it.
        length: m, that it has at least, unless it ends before where no lane follows.
        generator: draws at each place where several lanes follow, and nowhere else.

    Raises:
        UserError: there is no such lane.
    """
    lanes, total = [start], network.lane_path(start).total
    while total < length and (options := network.following.get(lanes[-1], ())):
        choice = int(generator.integers(len(options))) if len(options) > 1 else 0
        lanes.append(options[choice])
        total += network.lane_path(lanes[-1]).total
    return Route(network, tuple(lanes))


def _back(before: dict[LaneKey, LaneKey | None], lane: LaneKey) -> Iterable[LaneKey]:
    """The lanes from `lane` back to the first."""
    at: LaneKey | None = lane
    while at is not None:
        yield at
        at = before[at]
