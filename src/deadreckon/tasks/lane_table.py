"""The lanes of a network as arrays, so that many cars on many roads are looked up at once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.road_network import Network
from deadreckon.tasks.road_paths import Path, Pose, Projection, joined
from deadreckon.tasks.road_routes import Route
from deadreckon.tasks.roads import LaneKey

NONE = -1  # in a column of lanes or junctions


@dataclass(frozen=True, eq=False)
class LaneTable:
    """The lanes of a network, by the number that a lane has here.

    Attributes:
        network: whose lanes each follow one line or arc, and lead to others.

    Raises:
        UserError: it has other lanes, or a junction that a lane leads to without a light.
    """

    network: Network

    def __post_init__(self):
        for key, path in zip(self.keys, self._paths):
            if len(path.length) != 1 or not self.network.following[key]:
                raise UserError(f"road {key[0]}, lane {key[1]} must follow one line or arc and lead to another")
        entered = self.junction[self.following[:, 0]] != NONE
        if (entered & (self.light == NONE)).any():
            road, lane = self.keys[int(np.argmax(entered & (self.light == NONE)))]
            raise UserError(f"road {road}, lane {lane} leads to a junction without a traffic light")

    @cached_property
    def keys(self) -> tuple[LaneKey, ...]:
        """Ids of road and lane."""
        return tuple(self.network.following)

    @cached_property
    def _paths(self) -> list[Path]:
        return [self.network.lane_path(key) for key in self.keys]

    @cached_property
    def path(self) -> Path:
        """Their middles, one piece a lane; they are no way, for pieces do not begin where others end."""
        return joined(self._paths)

    @property
    def length(self) -> np.ndarray:
        """(lanes,) m."""
        return self.path.length

    @cached_property
    def options(self) -> np.ndarray:
        """(lanes,) how many lanes follow."""
        return np.array([len(self.network.following[key]) for key in self.keys])

    @cached_property
    def following(self) -> np.ndarray:
        """(lanes, most options) the lanes that follow, the last again where there are fewer."""
        number = {key: i for i, key in enumerate(self.keys)}
        rows = [[number[each] for each in self.network.following[key]] for key in self.keys]
        return np.array([row + row[-1:] * (max(self.options) - len(row)) for row in rows])

    @cached_property
    def junction(self) -> np.ndarray:
        """(lanes,) index among the network's junctions of the one that a lane leads through, or `NONE`."""
        index = {junction.id: i for i, junction in enumerate(self.network.junctions)}
        return np.array([index.get(self.network.road(road).junction, NONE) for road, _ in self.keys])

    @cached_property
    def incoming(self) -> np.ndarray:
        """(lanes,) the lane by which who is on this one has come to its junction; lanes outside of junctions: themselves."""
        found = np.arange(len(self.keys))
        for lane, behind in enumerate(self.following):
            found[behind[self.junction[behind] != NONE]] = lane
        return found

    @cached_property
    def line(self) -> np.ndarray:
        """(lanes,) m along the lane to the line before its traffic light, inf without one."""
        return np.array([at for at, _ in self._lights])

    @cached_property
    def light(self) -> np.ndarray:
        """(lanes,) index among the network's controllers of the one that switches the lane's light, or `NONE`."""
        return np.array([which for _, which in self._lights])

    @cached_property
    def _lights(self) -> list[tuple[float, int]]:
        switched = {signal: i for i, each in enumerate(self.network.controllers) for signal in each.signals}
        ahead = [Route(self.network, (key,)).signals() for key in self.keys]
        return [(each[-1][0], switched[each[-1][1].id]) if each else (np.inf, NONE) for each in ahead]

    @cached_property
    def switched(self) -> np.ndarray:
        """(3, controllers) the junction of each, which of its controllers it is, and how many these are.

        Raises:
            UserError: a controller belongs to no junction.
        """
        junctions = self.network.junctions
        rows = {each: (j, k, len(of.controllers)) for j, of in enumerate(junctions) for k, each in enumerate(of.controllers)}
        for each in self.network.controllers:
            if each.id not in rows:
                raise UserError(f"controller {each.id} belongs to no junction")
        return np.array([rows[each.id] for each in self.network.controllers]).reshape(-1, 3).T

    def pose(self, lane: np.ndarray, along: np.ndarray) -> Pose:
        """Poses (...) at so many m (...) along lanes (...); beyond their ends, on the line or arc that goes on."""
        return self.path.along(lane, along)

    def project(self, points: np.ndarray, lanes: np.ndarray, low: np.ndarray, high: np.ndarray) -> Projection:
        """Where points are relative to several lanes each.

        Args:
            points: (n, 2) x and y in m.
            lanes: (n, k).
            low: (n, k) m along these lanes, before which no place is looked for.
            high: (n, k) m, behind which none is.

        Returns:
            (n, k) each. The lateral offset is the distance from the foot, also from one at an end of the lane.
        """
        along = self.path.foot(points, lanes, low, high)
        foot = self.path.along(lanes, along)
        right, up = points[:, :1] - foot.x, points[:, 1:] - foot.y
        side = up * np.cos(foot.heading) - right * np.sin(foot.heading)
        return Projection(along, np.copysign(np.hypot(right, up), side), foot.heading)

    def ways(self, first: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """(n, k + 1) lanes that are driven one after the other.

        Args:
            first: (n,) lanes.
            turns: (n, k) in [0, 1), which of the lanes that follow is taken.
        """
        lanes = [first]
        for turn in turns.T:
            lanes.append(self.after(lanes[-1], turn))
        return np.stack(lanes, 1)

    def after(self, lane: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Lanes (...) that follow lanes (...), by `turn` (...) in [0, 1), which says which of them."""
        return self.following[lane, (turn * self.options[lane]).astype(int)]
