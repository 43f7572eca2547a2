"""The text of a network in OpenDRIVE 1.4, as CARLA takes it."""

from collections.abc import Iterable

from deadreckon.tasks.road_network import Junction, Network, Signal
from deadreckon.tasks.roads import Lane, Link, Road

TRAFFIC_LIGHT = "1000001"  # OpenDRIVE's type of signal for lights of three colours
# CARLA computes positions on the globe from it; where that is does not matter here.
PLACE = "+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"


def to_xodr(network: Network) -> str:
    """The text of an OpenDRIVE file. Numbers are written with all their digits, so equal networks have equal texts.

    Lines between lanes are broken and at the edges solid, and the one in the middle is yellow; in junctions there are none.
    """
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<OpenDRIVE>"]
    lines += ['<header revMajor="1" revMinor="4" name="deadreckon" version="1">']
    lines += [f"<geoReference><![CDATA[{PLACE}]]></geoReference>", "</header>"]
    for road in network.roads:
        lines += _road(road, [signal for signal in network.signals if signal.road == road.id])
    for controller in network.controllers:
        lines += [f'<controller id="{controller.id}" name="controller {controller.id}" sequence="0">']
        lines += [*(f'<control signalId="{signal}" type="0"/>' for signal in controller.signals), "</controller>"]
    for junction in network.junctions:
        lines += _junction(junction)
    return "\n".join([*lines, "</OpenDRIVE>", ""])


def _road(road: Road, signals: Iterable[Signal]) -> list[str]:
    lines = [f'<road name="road {road.id}" length="{road.length!r}" id="{road.id}" junction="{road.junction}">', "<link>"]
    lines += _link("predecessor", road.predecessor) + _link("successor", road.successor)
    lines += ["</link>", f'<type s="0" type="town"><speed max="{road.speed!r}" unit="m/s"/></type>', "<planView>"]
    for s, piece in zip(road.path.starts.tolist(), road.geometry):
        kind = f'<arc curvature="{piece.curvature!r}"/>' if piece.curvature else "<line/>"
        lines += [f'<geometry s="{s!r}" x="{piece.x!r}" y="{piece.y!r}" hdg="{piece.heading!r}" length="{piece.length!r}">']
        lines += [kind, "</geometry>"]
    lines += ["</planView>", '<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile>']
    lines += ["<lateralProfile/>", '<lanes><laneSection s="0">']
    left, right = [lane for lane in road.lanes if lane.id > 0], [lane for lane in road.lanes if lane.id < 0]
    if left:
        lines += ["<left>", *(line for lane in left for line in _lane(road, lane, lane is left[0])), "</left>"]
    middle = _mark("none" if road.junction != -1 else "broken" if left and right else "solid", "yellow")
    lines += ['<center><lane id="0" type="none" level="false">', middle, "</lane></center>"]
    if right:
        lines += ["<right>", *(line for lane in right for line in _lane(road, lane, lane is right[-1])), "</right>"]
    lines += ["</laneSection></lanes>", "<objects/>", "<signals>", *map(_signal, signals), "</signals>", "</road>"]
    return lines


def _link(end: str, link: Link | None) -> list[str]:
    if link is None:
        return []
    contact = f' contactPoint="{link.contact}"' if link.kind == "road" else ""
    return [f'<{end} elementType="{link.kind}" elementId="{link.id}"{contact}/>']


def _lane(road: Road, lane: Lane, outermost: bool) -> list[str]:
    lines = [f'<lane id="{lane.id}" type="{lane.kind}" level="false">', "<link>"]
    for end, id in (("predecessor", lane.predecessor), ("successor", lane.successor)):
        lines += [f'<{end} id="{id}"/>'] if id is not None else []
    lines += ["</link>", f'<width sOffset="0" a="{lane.width!r}" b="0" c="0" d="0"/>']
    return [*lines, _mark("none" if road.junction != -1 else "solid" if outermost else "broken", "standard"), "</lane>"]


def _mark(kind: str, colour: str) -> str:
    return f'<roadMark sOffset="0" type="{kind}" weight="standard" color="{colour}" width="0.12" laneChange="none"/>'


def _signal(signal: Signal) -> str:
    return (
        f'<signal id="{signal.id}" name="light {signal.id}" s="{signal.s!r}" t="{signal.t!r}" zOffset="0" hOffset="0" roll="0" '
        f'pitch="0" orientation="{signal.orientation}" dynamic="yes" country="OpenDRIVE" type="{TRAFFIC_LIGHT}" subtype="-1" '
        f'value="-1" text="" height="3" width="0.6"/>'
    )


def _junction(junction: Junction) -> list[str]:
    lines = [f'<junction id="{junction.id}" name="junction {junction.id}">']
    for i, each in enumerate(junction.connections):
        lines += [
            f'<connection id="{i}" incomingRoad="{each.incoming}" connectingRoad="{each.connecting}" '
            f'contactPoint="{each.contact}">',
            *(f'<laneLink from="{start}" to="{end}"/>' for start, end in each.lanes),
            "</connection>",
        ]
    return [*lines, *(f'<controller id="{id}" type="0" sequence="0"/>' for id in junction.controllers), "</junction>"]
