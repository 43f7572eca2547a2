"""Maps that are made here: a figure eight, and towns whose streets form a grid. The same arguments give the same map."""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

from deadreckon.tasks.road_network import Connection, Controller, Junction, Network, Signal
from deadreckon.tasks.roads import End, Geometry, Lane, Link, Road, number

BLOCK = 60.0  # m, from the middle of a street to the middle of the next
JUNCTION = 10.0  # m, from the middle of a junction to its ends, which is the radius of reference lines that turn there
CORNER = 15.0  # m, the radius of a town's outer corners
BEFORE, BESIDE = 1.0, 1.0  # m, how far lights stand before the junction and beside the lane
Street = tuple[tuple[int, int], tuple[int, int]]  # column and row where a street begins, and where it ends


class _Arm(NamedTuple):
    """A road's end at a junction.

    Attributes:
        road: its id.
        end: which end of it.
        x: m, of that end of the reference line.
        y: m.
        heading: rad, into the junction.
    """

    road: int
    end: End
    x: float
    y: float
    heading: float


_Way = tuple[_Arm, _Arm]  # in, and out


def figure_eight(radius: float = 20.0, lane_width: float = 3.5) -> Network:
    """Two arcs of three quarters of a circle, joined by two straight streets that cross at a right angle at the origin.

    The crossing is a junction, since OpenDRIVE wants one wherever roads meet at grade, and since cars and CARLA's clients learn
    from it where others cross. Its four ways lead straight on. Roads 1 to 4 lead from it to the far ends of the arcs, the first
    to the south-east and the others counter-clockwise: loops that both begin and end at the junction would be one road each,
    but CARLA 0.9.16 then finds no way out of the junction.

    Args:
        radius: m, of the reference lines of the arcs.
        lane_width: m, of the two lanes.

    Raises:
        UserError: an argument is out of range; the radius must be at least three times a lane's width.
    """
    number("figure_eight", "lane_width", lane_width, 1.0, 10.0)
    number("figure_eight", "radius", radius, 3 * lane_width, 1e4)
    clear = 2 * lane_width  # m from the middle to where the junction ends; cars beyond are in nobody's way
    junction, roads = 5, []
    for id, side, other in ((1, 1.0, 2), (2, -1.0, 1), (3, 1.0, 4), (4, -1.0, 3)):
        heading = math.pi / 4 + math.pi / 2 * (id - 2)
        x, y = math.cos(heading), math.sin(heading)
        # Lines at 45 degrees through the middle touch a circle whose centre is sqrt(2) radii away one radius from the middle.
        pieces = (
            Geometry(clear * x, clear * y, heading, radius - clear),
            Geometry(radius * x, radius * y, heading, 0.75 * math.pi * radius, side / radius),
        )
        lanes = _lanes(lane_width, behind=_meets("end", "end"))
        roads.append(Road(id, pieces, lanes, Link("junction", junction), Link("road", other, "end")))
    arms = [_arm(road, "start") for road in roads]
    ways = [(arm, other) for arm, other in itertools.permutations(arms, 2) if abs(_turn(arm, other)) < 1.0]
    connecting = _connecting(itertools.count(junction + 1), junction, ways, lane_width)
    return Network((*roads, *connecting), (_junction(junction, ways, connecting),))


def town(blocks: tuple[int, int] = (2, 3), lane_width: float = 3.5) -> Network:
    """Streets with one lane each way round all of the blocks of a grid, whose south-western corner is the origin.

    Where streets meet is a junction whose ways lead straight on and through arcs to the right and to the left, never back. The
    four outer corners are arcs. Each street has a traffic light at its junctions, with a controller of its own, as in CARLA's
    towns: who comes in by one street need not meet who comes in by another.

    Args:
        blocks: how many, from west to east and from south to north.
        lane_width: m.

    Raises:
        UserError: an argument is out of range.
    """
    for name, count in zip(("columns of blocks", "rows of blocks"), blocks):
        number("town", name, count, 1, 50)
    number("town", "lane_width", lane_width, 1.0, JUNCTION / 2)
    nodes = list(itertools.product(range(blocks[0] + 1), range(blocks[1] + 1)))
    streets: list[Street] = [((i, j), (i + 1, j)) for i, j in nodes if i < blocks[0]]
    streets += [((i, j), (i, j + 1)) for i, j in nodes if j < blocks[1]]
    # Which streets begin or end at each node.
    at: dict[tuple[int, int], list[tuple[int, End]]] = {node: [] for node in nodes}
    for i, (start, end) in enumerate(streets):
        at[start].append((i, "start"))
        at[end].append((i, "end"))
    ids = itertools.count(len(streets) + 1)
    joint = {node: next(ids) for node in nodes}  # id of the junction or, at a corner, of the road there
    cut = {node: CORNER if len(at[node]) == 2 else JUNCTION for node in nodes}
    links: dict[tuple[int, End], Link] = {}
    for node, ends in at.items():
        if len(ends) == 2:  # the road round the corner begins at the first street and ends at the second
            links[ends[0]], links[ends[1]] = Link("road", joint[node], "start"), Link("road", joint[node], "end")
        else:
            links |= {street: Link("junction", joint[node]) for street in ends}
    roads = []
    for i, (start, end) in enumerate(streets):
        east = start[1] == end[1]
        x, y = BLOCK * start[0] + cut[start] * east, BLOCK * start[1] + cut[start] * (not east)
        piece = Geometry(x, y, 0.0 if east else math.pi / 2, BLOCK - cut[start] - cut[end])
        before, behind = links[i, "start"], links[i, "end"]
        lanes = _lanes(lane_width, _meets("start", before.contact), _meets("end", behind.contact))
        roads.append(Road(i + 1, (piece,), lanes, before, behind))
    bends, through, junctions, signals = [], [], [], []
    for node, ends in at.items():
        arms = [_arm(roads[i], end) for i, end in ends]
        if len(arms) == 2:
            bends.append(_bend(joint[node], arms[0], arms[1], lane_width))
            continue
        ways = list(itertools.permutations(arms, 2))
        connecting = _connecting(ids, joint[node], ways, lane_width)
        lights = [_light(len(signals) + k, roads[arm.road - 1], arm, lane_width) for k, arm in enumerate(arms, 1)]
        signals += lights
        through += connecting
        junctions.append(_junction(joint[node], ways, connecting, tuple(light.id for light in lights)))
    controllers = tuple(Controller(light.id, (light.id,)) for light in signals)
    return Network((*roads, *bends, *through), tuple(junctions), tuple(signals), controllers)


def _lanes(width: float, before: tuple[int, int] | None = None, behind: tuple[int, int] | None = None) -> tuple[Lane, Lane]:
    """A lane each way, given the lanes that lie at the start and at the end beside lanes 1 and -1."""
    starts, ends = before or (None, None), behind or (None, None)
    return Lane(1, width, starts[0], ends[0]), Lane(-1, width, starts[1], ends[1])


def _meets(end: End, contact: End | None) -> tuple[int, int] | None:
    """The lanes that lanes 1 and -1 meet where an end of a road touches an end of another; `None` at a junction."""
    if contact is None:
        return None
    return (-1, 1) if contact == end else (1, -1)


def _arm(road: Road, end: End) -> _Arm:
    pose = road.pose(0.0 if end == "start" else road.length)
    return _Arm(road.id, end, float(pose.x), float(pose.y), float(pose.heading) + (math.pi if end == "start" else 0.0))


def _turn(arm: _Arm, other: _Arm) -> float:
    """rad, between -pi and pi, by which who comes in by one arm turns to leave by another; positive to the left."""
    return (other.heading + math.pi - arm.heading + math.pi) % (2 * math.pi) - math.pi


def _curve(arm: _Arm, other: _Arm) -> Geometry:
    """The line or arc from one arm to another, which are as far from where they meet."""
    turn, apart = _turn(arm, other), math.hypot(other.x - arm.x, other.y - arm.y)
    if abs(turn) < 1e-6:
        return Geometry(arm.x, arm.y, arm.heading, apart)
    radius = apart / (2 * math.sin(abs(turn) / 2))
    return Geometry(arm.x, arm.y, arm.heading, radius * abs(turn), math.copysign(1.0 / radius, turn))


def _bend(id: int, arm: _Arm, other: _Arm, width: float) -> Road:
    """The road round a corner, between two others."""
    before, behind = Link("road", arm.road, arm.end), Link("road", other.road, other.end)
    lanes = _lanes(width, _meets("start", arm.end), _meets("end", other.end))
    return Road(id, (_curve(arm, other),), lanes, before, behind)


def _connecting(ids: Iterator[int], junction: int, ways: list[_Way], width: float) -> list[Road]:
    """The roads through a junction, one for each way, with a lane on the right of the line."""
    return [
        Road(
            next(ids), (_curve(arm, other),), (Lane(-1, width, _leaves(arm), -_leaves(other)),),
            Link("road", arm.road, arm.end), Link("road", other.road, other.end), junction,
        )
        for arm, other in ways
    ]  # fmt: skip


def _leaves(arm: _Arm) -> int:
    """The lane by which its road is left there."""
    return -1 if arm.end == "end" else 1


def _junction(id: int, ways: list[_Way], connecting: list[Road], controllers: tuple[int, ...] = ()) -> Junction:
    connections = [Connection(arm.road, road.id, "start", ((_leaves(arm), -1),)) for (arm, _), road in zip(ways, connecting)]
    return Junction(id, tuple(connections), controllers)


def _light(id: int, road: Road, arm: _Arm, width: float) -> Signal:
    """The light for who comes in by an arm, on the right side of the street."""
    if arm.end == "end":
        return Signal(id, road.id, road.length - BEFORE, -width - BESIDE, "+")
    return Signal(id, road.id, BEFORE, width + BESIDE, "-")
