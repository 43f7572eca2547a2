"""Roads in the subset of OpenDRIVE 1.4 that `tasks/opendrive.py` reads and writes: flat, with right-hand traffic.

A road has a reference line of lines and arcs, and lanes of constant width beside it. Lanes with negative ids lie to the right
of the line and are driven along it, those with positive ids lie to its left and are driven against it; both count from it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.road_paths import Path, Pose, gaps

End = Literal["start", "end"]
LaneKey = tuple[int, int]  # ids of a road and of a lane on it

DRIVING = "driving"
KINDS = (DRIVING, "shoulder", "sidewalk", "border", "parking", "none")  # of lanes, as OpenDRIVE calls them
GAP, BEND = 0.01, 0.01  # m and rad, by which what should meet may miss each other: files hold rounded numbers
# Beyond these numbers a file is wrong, or not about roads.
MOST_LANES = 60
FARTHEST, LONGEST, WIDEST, FASTEST, LARGEST_ID = 1e6, 1e5, 50.0, 150.0, 2**31 - 1


def number(where: str, name: str, value: float, low: float, high: float) -> None:
    """Refuses a number that is not between `low` and `high`, or is not a number.

    Raises:
        UserError: begins with `where` and says `name`.
    """
    if not low <= value <= high:
        raise UserError(f"{where}: {name} must be between {low:g} and {high:g}, got {value!r}")


@dataclass(frozen=True)
class Geometry:
    """A piece of a reference line, a line or an arc.

    Attributes:
        x: m, of its beginning.
        y: m.
        heading: rad, at its beginning.
        length: m.
        curvature: 1/m, positive to the left; 0 is a line.
    """

    x: float
    y: float
    heading: float
    length: float
    curvature: float = 0.0


@dataclass(frozen=True)
class Lane:
    """A lane of a road.

    Attributes:
        id: not 0.
        width: m.
        predecessor: id of the lane joined to it at the road's start, if that is linked to a road.
        successor: the same at the road's end.
        kind: one of `KINDS`; cars drive on `DRIVING`.
    """

    id: int
    width: float
    predecessor: int | None = None
    successor: int | None = None
    kind: str = DRIVING


@dataclass(frozen=True)
class Link:
    """What a road is joined to at one of its ends.

    Attributes:
        kind: "road" or "junction".
        id: of that.
        contact: the end of the other road; `None` for a junction.
    """

    kind: Literal["road", "junction"]
    id: int
    contact: End | None = None


@dataclass(frozen=True)
class Road:
    """A road.

    Attributes:
        id: above 0, since CARLA takes 0 for none.
        geometry: pieces of the reference line, at least one, each of which begins where the one before ends.
        lanes: by descending id.
        predecessor: what lies at its start.
        successor: what lies at its end.
        junction: id of the junction that it leads through, else -1.
        speed: m/s, the limit.

    Raises:
        UserError: something about it does not fit, in one line that says what.
    """

    id: int
    geometry: tuple[Geometry, ...]
    lanes: tuple[Lane, ...]
    predecessor: Link | None = None
    successor: Link | None = None
    junction: int = -1
    speed: float = 13.0

    def __post_init__(self):
        where = f"road {self.id}"
        number(where, "id", self.id, 1, LARGEST_ID)
        number(where, "speed", self.speed, 0.1, FASTEST)
        if not self.geometry:
            raise UserError(f"{where} has no geometry")
        for i, piece in enumerate(self.geometry):
            at = f"{where}, geometry {i}"
            for name, value in (("x", piece.x), ("y", piece.y), ("heading", piece.heading)):
                number(at, name, value, -FARTHEST, FARTHEST)
            number(at, "length", piece.length, 1e-9, LONGEST)
            number(at, "curvature", piece.curvature, -1e3, 1e3)
            if abs(piece.curvature) * piece.length > 2 * np.pi + BEND:
                raise UserError(f"{at} is an arc that goes round more than once")
        ids = [lane.id for lane in self.lanes]
        number(where, "number of lanes", len(ids), 0, MOST_LANES)
        left, right = sum(id > 0 for id in ids), sum(id < 0 for id in ids)
        if ids != [id for id in range(left, -right - 1, -1) if id]:
            raise UserError(f"{where} needs lanes by descending id, without 0 and without a hole, got {ids}")
        for lane in self.lanes:
            number(f"{where}, lane {lane.id}", "width", lane.width, 0.01, WIDEST)
            if lane.kind not in KINDS:
                raise UserError(f"{where}, lane {lane.id}: type {lane.kind!r} is none of {', '.join(KINDS)}")
        ends, path = self.path.ends(), self.path
        before, behind = Pose(*(each[:-1] for each in ends)), Pose(path.x[1:], path.y[1:], path.heading[1:], path.curvature[1:])
        apart, bent = gaps(before, behind)
        if (apart > GAP).any() or (bent > BEND).any():
            raise UserError(f"{where} has a gap or a kink between two geometries")
        _ = self._paths  # a lane inside of a bend that is too sharp has none

    @cached_property
    def path(self) -> Path:
        """The reference line."""
        rows = [(g.x, g.y, g.heading, g.curvature, g.length) for g in self.geometry]
        return Path(*np.array(rows, np.float64).T)

    @property
    def length(self) -> float:
        """Of the reference line, in m."""
        return self.path.total

    def pose(self, s: np.ndarray | float, t: np.ndarray | float = 0.0) -> Pose:
        """Poses (...) along the road, at `s` (...) m along its reference line and `t` (...) m to the left of it.

        The curvature is the reference line's. Beyond the ends of the road, poses are those of the ends.
        """
        pose = self.path.pose(s)
        return pose._replace(x=pose.x - t * np.sin(pose.heading), y=pose.y + t * np.cos(pose.heading))

    def lane(self, lane: int) -> Lane:
        """The lane of that id.

        Raises:
            UserError: there is none.
        """
        found = self._lanes.get(lane)
        if found is None:
            raise UserError(f"road {self.id} has no lane {lane}, but {', '.join(str(each.id) for each in self.lanes)}")
        return found

    def lane_offset(self, lane: int) -> float:
        """m from the reference line to the middle of a lane, positive to the left; raises as `lane`."""
        width = self.lane(lane).width
        inside = sum(each.width for each in self.lanes if each.id * lane > 0 and abs(each.id) < abs(lane))
        return float(np.sign(lane)) * (inside + width / 2)

    def lane_path(self, lane: int) -> Path:
        """The middle of a lane, in the direction in which it is driven; raises as `lane`."""
        return self._paths[self.lane(lane).id]

    @cached_property
    def _paths(self) -> dict[int, Path]:
        return {lane.id: self._path(lane.id) for lane in self.lanes}

    def _path(self, lane: int) -> Path:
        try:
            path = self.path.offset(self.lane_offset(lane))
        except UserError as error:
            raise UserError(f"road {self.id}, lane {lane}: {error}") from error
        return path.reversed() if lane > 0 else path

    @cached_property
    def _lanes(self) -> dict[int, Lane]:
        return {lane.id: lane for lane in self.lanes}
