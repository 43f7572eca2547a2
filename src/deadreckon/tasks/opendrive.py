"""Reading and writing networks of roads as OpenDRIVE 1.4 (`.xodr`), which CARLA reads, too.

What the subset has is in `tasks/roads.py` and `tasks/road_network.py`. Of a file, names, road marks, priorities and user data
are passed over, and so are the place where a road's one speed begins, heights of signals, and further links of a road. Most
else that a network cannot hold is refused. A speed without a unit is in m/s, and a road without one has that of `Road`.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from deadreckon.errors import UserError, reading
from deadreckon.files import write_text
from deadreckon.foreign.door import file_size, read_bytes
from deadreckon.tasks.opendrive_text import TRAFFIC_LIGHT, to_xodr
from deadreckon.tasks.road_network import Connection, Controller, Junction, Network, Signal
from deadreckon.tasks.roads import KINDS, Geometry, Lane, Link, Road

SIZE, ELEMENTS, DEPTH = 16_000_000, 200_000, 20  # bytes and elements of a file, and how deep these may lie in each other
SPEEDS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}
LONGEST = 30  # characters of a word of the file that an error repeats
TOLERANCE = 0.01  # m, by which a given s may miss the sum of the lengths before it
OUTSIDE = "not in the subset of OpenDRIVE that is read"
PASSED_OVER = frozenset(("header", "userData", "roadMark", "priority"))
SUBSET = {
    "OpenDRIVE": "road controller junction",
    "road": "link type planView elevationProfile lateralProfile lanes objects signals",
    "link": "predecessor successor",
    "type": "speed",
    "planView": "geometry",
    "geometry": "line arc",
    "elevationProfile": "elevation",
    "lanes": "laneOffset laneSection",
    "laneSection": "left center right",
    "left": "lane",
    "center": "lane",
    "right": "lane",
    "lane": "link width",
    "signals": "signal",
    "controller": "control",
    "junction": "connection controller",
    "connection": "laneLink",
}


def read_xodr(path: Path | str) -> Network:
    """The network of an OpenDRIVE file.

    Raises:
        UserError: the file cannot be read, is no OpenDRIVE, is too large, has a document type or entities, or has what the
            subset has not. One line names the file and what is wrong.
    """
    size = file_size(path)
    if size > SIZE:
        raise UserError(f"{path}: has {size:,} bytes, more than the {SIZE:,} that are read of a file of roads")
    return parse_xodr(read_bytes(path), path)


def parse_xodr(text: bytes | str, name: Path | str) -> Network:
    """The network of a text in OpenDRIVE; raises as `read_xodr`, with `name` for the file's."""
    try:
        return _network(_tree(text, name))
    except UserError as error:
        raise UserError(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error


def write_xodr(network: Network, path: Path | str) -> None:
    """Writes an OpenDRIVE file, which `read_xodr` reads as an equal network.

    Raises:
        UserError: the file cannot be written.
    """
    write_text(path, to_xodr(network))


@dataclass
class _Element:
    """An element of XML.

    Attributes:
        name: of it.
        where: what errors call it.
        attributes: of it.
        inside: the elements in it.
    """

    name: str
    where: str
    attributes: dict[str, str]
    inside: "list[_Element]" = field(default_factory=list)

    def all(self, name: str) -> "list[_Element]":
        """Elements of that name in it."""
        return [each for each in self.inside if each.name == name]

    def one(self, name: str) -> "_Element":
        """The element of that name in it, of which there must be one."""
        found = self.all(name)
        if len(found) != 1:
            raise UserError(f"{self.where} needs one {name}, and has {len(found) or 'none'}")
        return found[0]

    def word(self, name: str, known: Any = None, usual: str | None = None) -> str:
        """An attribute, which must be there, unless there is a `usual` one, and be one of `known`."""
        if name not in self.attributes and usual is not None:
            return usual
        if name not in self.attributes:
            raise UserError(f"{self.where}: no attribute {name}")
        word = self.attributes[name]
        if known is not None and word not in known:
            raise UserError(f"{self.where}: {name} must be {' or '.join(known)}, got {word[:LONGEST]!r}")
        return word

    def number(self, name: str) -> float:
        """An attribute that is a finite number."""
        word = self.word(name)
        if not re.fullmatch(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", word, re.ASCII) or not math.isfinite(float(word)):
            raise UserError(f"{self.where}: {name} must be a number, got {word[:LONGEST]!r}")
        return float(word)

    def id(self, name: str = "id") -> int:
        """An attribute that is a whole number."""
        word = self.word(name)
        if not re.fullmatch(r"-?\d{1,10}", word, re.ASCII):
            raise UserError(f"{self.where}: {name} must be a whole number, got {word[:LONGEST]!r}")
        return int(word)

    def zero(self, *names: str) -> None:
        """Refuses attributes that are not 0."""
        for name in names:
            if self.number(name) != 0.0:
                raise UserError(f"{self.where}: {name} must be 0, got {self.word(name)[:LONGEST]}: else it is {OUTSIDE}")


def _tree(text: bytes | str, name: Path | str) -> _Element:
    """The elements of a text in XML, without those that are passed over; `name` is the file's."""
    document = _Element("", "the file", {})
    above, count = [document], 0
    ignored: int = 0
    parser = expat.ParserCreate()

    def refuse(*_: Any) -> None:
        raise UserError("has a document type or entities, which are not read")

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal ignored, count
        count += 1
        if count > ELEMENTS or len(above) + ignored > DEPTH:
            raise UserError(f"has more than {ELEMENTS:,} elements, or elements more than {DEPTH} deep in each other")
        if ignored or (name in PASSED_OVER and len(above) > 1):
            ignored += 1
            return
        upper = above[-1]
        where = name if name == "OpenDRIVE" else f"{name} {attributes['id'][:LONGEST]}" if "id" in attributes else name
        if upper.name not in ("", "OpenDRIVE"):
            where = f"{upper.where}, {where}"
        known = SUBSET.get(upper.name, "").split() if upper.name else ["OpenDRIVE"]
        if name not in known:
            raise UserError(f"{where[:200]}: this is {OUTSIDE}")
        upper.inside.append(_Element(name, where, attributes))
        above.append(upper.inside[-1])

    def end(name: str) -> None:
        nonlocal ignored
        if ignored:
            ignored -= 1
        else:
            above.pop()

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    with reading(name, "OpenDRIVE"):
        parser.Parse(text, True)
    return document.one("OpenDRIVE")


def _network(root: _Element) -> Network:
    roads = root.all("road")
    return Network(
        tuple(_road(each) for each in roads),
        tuple(_junction(each) for each in root.all("junction")),
        tuple(_signal(road.id(), each) for road in roads for group in road.all("signals") for each in group.all("signal")),
        tuple(
            Controller(each.id(), tuple(control.id("signalId") for control in each.all("control")))
            for each in root.all("controller")
        ),
    )


def _road(road: _Element) -> Road:
    if "rule" in road.attributes:
        road.word("rule", ("RHT",))
    for elevation in (each for profile in road.all("elevationProfile") for each in profile.all("elevation")):
        elevation.zero("a", "b", "c", "d")
    lanes = road.one("lanes")
    for offset in lanes.all("laneOffset"):
        offset.zero("a", "b", "c", "d")
    section = lanes.one("laneSection")
    section.zero("s")
    groups = [(group, 1) for group in section.all("left")] + [(group, -1) for group in section.all("right")]
    sides = sorted((_lane(each, sign) for group, sign in groups for each in group.all("lane")), key=lambda lane: -lane.id)
    links = [_link(road, end) for end in ("predecessor", "successor")]
    speeds = [each for kind in road.all("type") for each in kind.all("speed")]
    if len(speeds) > 1:
        raise UserError(f"{road.where} has {len(speeds)} speeds, and one is read")
    speed = {"speed": speeds[0].number("max") * SPEEDS[speeds[0].word("unit", SPEEDS, "m/s")]} if speeds else {}
    geometry, along = [], 0.0
    for each in road.one("planView").all("geometry"):
        if abs(each.number("s") - along) > TOLERANCE:
            raise UserError(f"{each.where}: s must be {along:.6g}, the length before it, got {each.number('s'):.6g}")
        geometry.append(_geometry(each))
        along += geometry[-1].length
    if abs(road.number("length") - along) > TOLERANCE:
        raise UserError(f"{road.where}: length must be {along:.6g}, that of its geometry, got {road.number('length'):.6g}")
    return Road(road.id(), tuple(geometry), tuple(sides), links[0], links[1], road.id("junction"), **speed)


def _geometry(each: _Element) -> Geometry:
    if len(each.inside) != 1:
        raise UserError(f"{each.where} needs one line or one arc")
    curvature = each.inside[0].number("curvature") if each.inside[0].name == "arc" else 0.0
    return Geometry(each.number("x"), each.number("y"), each.number("hdg"), each.number("length"), curvature)


def _lane(lane: _Element, sign: int) -> Lane:
    width = lane.one("width")
    width.zero("sOffset", "b", "c", "d")
    ends = [
        next((each.id() for link in lane.all("link") for each in link.all(end)), None) for end in ("predecessor", "successor")
    ]
    if lane.id() * sign <= 0:
        raise UserError(f"{lane.where} lies on the wrong side")
    return Lane(lane.id(), width.number("a"), ends[0], ends[1], lane.word("type", KINDS))


def _link(road: _Element, end: str) -> Link | None:
    for each in (each for link in road.all("link") for each in link.all(end)):
        if each.word("elementType", ("road", "junction")) == "junction":
            return Link("junction", each.id("elementId"))
        # pyrefly: ignore[bad-argument-type] - `word` refuses others
        return Link("road", each.id("elementId"), each.word("contactPoint", ("start", "end")))
    return None


def _junction(junction: _Element) -> Junction:
    connections = tuple(
        Connection(
            each.id("incomingRoad"), each.id("connectingRoad"),
            each.word("contactPoint", ("start", "end")),  # pyrefly: ignore[bad-argument-type]
            tuple((link.id("from"), link.id("to")) for link in each.all("laneLink")),
        )
        for each in junction.all("connection")
    )  # fmt: skip
    return Junction(junction.id(), connections, tuple(each.id() for each in junction.all("controller")))


def _signal(road: int, signal: _Element) -> Signal:
    signal.word("type", (TRAFFIC_LIGHT,))
    direction = signal.word("orientation", ("+", "-"))
    return Signal(signal.id(), road, signal.number("s"), signal.number("t"), direction)  # pyrefly: ignore[bad-argument-type]
