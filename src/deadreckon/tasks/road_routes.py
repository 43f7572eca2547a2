"""Routes through networks: which lanes are driven one after the other, where a car is on its way, and what lies ahead."""

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
