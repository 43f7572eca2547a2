import dataclasses
import itertools
import math
import re

import numpy as np
import pytest
from lane_poses import lane_pose

from deadreckon.errors import UserError
from deadreckon.tasks import opendrive
from deadreckon.tasks.opendrive import parse_xodr, read_xodr, write_xodr
from deadreckon.tasks.opendrive_text import to_xodr
from deadreckon.tasks.road_maps import figure_eight, town
from deadreckon.tasks.road_network import Controller, Network, Signal
from deadreckon.tasks.roads import Geometry, Lane, Link, Road

EIGHT = figure_eight()
MAPS = {
    "eight": EIGHT,
    "town": town(),
    "ring": town((1, 1)),
    "three": town((1, 2)),
    "small eight": figure_eight(10.5, 3.5),
}
TEXT = to_xodr(EIGHT)


@pytest.mark.parametrize("name", MAPS)
def test_what_is_written_is_read_as_an_equal_network(name, tmp_path):
    write_xodr(MAPS[name], tmp_path / "map.xodr")
    assert read_xodr(tmp_path / "map.xodr") == MAPS[name]


def test_lanes_of_other_kinds_and_one_sided_roads_are_kept(tmp_path):
    lanes = (Lane(-1, 3.1), Lane(-2, 0.1 + 0.2, kind="shoulder"), Lane(-3, 2.0, kind="sidewalk"))
    linked = tuple(dataclasses.replace(lane, successor=lane.id) for lane in lanes)
    first = Road(7, (Geometry(0.1, 1e-7, -3.0, 1 / 3, 0.0),), linked, successor=Link("road", 9, "start"), speed=8.333)
    end = first.pose(first.length)
    second = Road(9, (Geometry(float(end.x), float(end.y), -3.0, 5.0, 1e-3),), lanes, Link("road", 7, "end"))
    network = Network((first, second), signals=(Signal(2, 9, 1.0, -4.0, "+"), Signal(1, 7, 0.1, -4.0, "+")),
                      controllers=(Controller(4, (2, 1)),))  # fmt: skip
    assert [signal.id for signal in network.signals] == [1, 2]
    assert parse_xodr(to_xodr(network), "x") == network
    assert network.following == {(7, -1): ((9, -1),), (9, -1): ()}


def test_what_a_file_says_beside_the_subset_is_passed_over():
    other = TEXT.replace("<objects/>", '<userData><vector a="1"/></userData>').replace("<lateralProfile/>", "")
    other = re.sub(r"<roadMark[^>]*>", "", other.replace('max="13.0" unit="m/s"', 'max="46.8" unit="km/h"'))
    assert parse_xodr("\ufeff" + other, "x") == EIGHT
    assert parse_xodr(TEXT.replace(' unit="m/s"', ""), "x") == EIGHT


ROAD = re.search(r'<road .*?id="1".*?</road>\n', TEXT, re.DOTALL)[0]
# The line is 26 m shorter.
SHORT = TEXT.replace('length="13.0"', 'length="-13.0"').replace(f'length="{EIGHT.roads[0].length!r}"', 'length="34.1238898"')
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in itertools.pairwise("abcdefghij")
) + "]>"  # fmt: skip
SIGNAL = '<signals><signal id="1" s="{}" t="0" orientation="+" type="{}"/>'
HOSTILE = {
    "an entity bomb": (TEXT.replace("<OpenDRIVE>", f"{BOMB}<OpenDRIVE>&j;"), "a document type or entities"),
    "an outer entity": (
        TEXT.replace("<OpenDRIVE>", '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><OpenDRIVE>&a;'), "a document type",
    ),
    "no XML": ("roads", "cannot be read as OpenDRIVE"),
    "nothing": ("", "cannot be read as OpenDRIVE"),
    "cut short": (TEXT[: len(TEXT) // 2], "cannot be read as OpenDRIVE"),
    "another document": ("<svg/>", "svg: this is not in the subset"),
    "no road": ("<OpenDRIVE/>", "needs a road"),
    "no id": (TEXT.replace(' id="1"', "", 1), "road: no attribute id"),
    "no length": (re.sub(r' length="[^"]*"', "", TEXT), "no attribute length"),
    "no curvature": (TEXT.replace("<arc curvature=", "<arc bend="), "road 1, planView, geometry, arc: no attribute curv"),
    "no plan": (re.sub(r"<planView>.*?</planView>", "", TEXT, count=1, flags=re.DOTALL), "road 1 needs one planView"),
    "no geometry": (re.sub(r"<geometry .*?</geometry>", "", TEXT, flags=re.DOTALL), "road 1: length must be 0, that of its"),
    "a spiral": (TEXT.replace("<line/>", '<spiral curvStart="0" curvEnd="1"/>', 1), "geometry, spiral: this is not in the sub"),
    "two shapes": (TEXT.replace("<line/>", "<line/><line/>", 1), "needs one line or one arc"),
    "NaN": (re.sub(r' hdg="[^"]*"', ' hdg="nan"', TEXT), "hdg must be a number, got 'nan'"),
    "infinity": (re.sub(r' x="[^"]*"', ' x="1e999"', TEXT), "x must be a number, got '1e999'"),
    "far away": (re.sub(r' x="[^"]*"', ' x="1e300"', TEXT), r"road 1, geometry 0: x must be between"),
    "a length below 0": (SHORT.replace('<geometry s="13.0"', '<geometry s="-13.0"'), "geometry 0: length must be between"),
    "another s": (TEXT.replace('<geometry s="13.0"', '<geometry s="12.0"', 1), "geometry: s must be 13, the length before it"),
    "an arc of many turns": (TEXT.replace('<arc curvature="0.05"', '<arc curvature="5"', 1), "goes round more than once"),
    "a gap": (TEXT.replace(f'x="{7 * math.cos(-math.pi / 4)!r}"', 'x="5.1"', 1), "a gap or a kink"),
    "a hill": (TEXT.replace('s="0" a="0" b="0"', 's="0" a="0" b="0.1"'), "Profile, elevation: b must be 0, got 0.1"),
    "a width that changes": (TEXT.replace('a="3.5" b="0"', 'a="3.5" b="1"', 1), "left, lane 1, width: b must be 0, got 1"),
    "a width below 0": (TEXT.replace('a="3.5"', 'a="-3.5"', 1), "road 1, lane 1: width must be between"),
    "a lane on the wrong side": (TEXT.replace('<lane id="1"', '<lane id="-2"', 1), "lies on the wrong side"),
    "a lane twice": (TEXT.replace('<lane id="1"', '<lane id="2"', 1), "without a hole"),
    "two sections": (TEXT.replace("</laneSection>", '</laneSection><laneSection s="5"/>', 1), "one laneSection, and has 2"),
    "left-hand traffic": (TEXT.replace("<road ", '<road rule="LHT" ', 1), "rule must be RHT, got 'LHT'"),
    "a strange unit": (TEXT.replace('unit="m/s"', 'unit="knots"', 1), "unit must be m/s or km/h or mph"),
    "a road twice": (TEXT.replace("</OpenDRIVE>", f"{ROAD}</OpenDRIVE>"), "two of road 1"),
    "a road and a junction": (TEXT.replace('junction id="5"', 'junction id="1"'), "1 is the id of a road and of a junction"),
    "a link to nowhere": (TEXT.replace('elementId="2"', 'elementId="99"', 1), "road 1: no road 99"),
    "no such lane": (TEXT.replace('<laneLink from="1" to="-1"/>', '<laneLink from="1" to="-7"/>', 1), "has no lane -7"),
    "a lane that comes from none": (
        TEXT.replace('<laneLink from="1" to="-1"/>', '<laneLink from="9" to="-1"/>', 1), "has no lane 9",
    ),
    "a lane against another": (TEXT.replace('"2" contactPoint="end"', '"2" contactPoint="start"', 1), "leads against"),
    "a road that follows itself": (
        TEXT.replace('<successor elementType="road" elementId="2" contactPoint="end"/>',
                     '<successor elementType="road" elementId="1" contactPoint="end"/>'), "does not begin where",
    ),
    "a circle of roads in a junction": (TEXT.replace('connectingRoad="6"', 'connectingRoad="1"'), "road 1 connects in it, but"),
    "an id that is none": (TEXT.replace(' id="1"', ' id="one"', 1), "id must be a whole number, got 'one'"),
    "an id of many digits": (TEXT.replace(' id="1"', f' id="{"9" * 5000}"', 1), "id must be a whole number"),
    "another signal": (TEXT.replace("<signals>", SIGNAL.format(0, 205), 1), "type must be 1000001"),
    "a light off the road": (TEXT.replace("<signals>", SIGNAL.format(1e9, 1000001), 1), "signal 1: s must be between"),
    "a control character in an id": (TEXT.replace(' id="1"', ' id="1\x7f\u202e"', 1), "id must be a whole number"),
    "deep": ("<OpenDRIVE>" + "<userData>" * 5000, "deep in each other"),
    "a line break in a word": (TEXT.replace('type="driving"', 'type="dri&#10;ving\x7f&#9;"', 1), "type must be driving or"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_refused_in_one_line(case, tmp_path):
    text, words = HOSTILE[case]
    assert text != TEXT
    (tmp_path / "bad.xodr").write_text(text)
    with pytest.raises(UserError, match=words) as caught:
        read_xodr(tmp_path / "bad.xodr")
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "bad.xodr"))
    assert message.isprintable()
    assert len(message) < len(str(tmp_path)) + 300


def test_large_files_are_refused_before_they_are_read(tmp_path, monkeypatch):
    with open(tmp_path / "large.xodr", "wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(UserError, match="large.xodr: has 100,000,000 bytes, more than the 16,000,000"):
        read_xodr(tmp_path / "large.xodr")
    monkeypatch.setattr(opendrive, "ELEMENTS", 100)
    with pytest.raises(UserError, match="more than 100 elements"):
        parse_xodr(TEXT, "many.xodr")
    with pytest.raises(UserError, match="number of lanes must be between 0 and 60, got 61"):
        Road(1, (Geometry(0, 0, 0, 1),), tuple(Lane(-id, 0.1) for id in range(1, 62)))
    with pytest.raises(UserError, match="no-such.xodr"):
        read_xodr(tmp_path / "no-such.xodr")


@pytest.mark.parametrize("name", MAPS)
def test_carla_has_the_same_roads(name):
    carla = pytest.importorskip("carla")
    network = MAPS[name]
    theirs = carla.Map(name, to_xodr(network))
    pairs = {((a.road_id, a.lane_id), (b.road_id, b.lane_id)) for a, b in theirs.get_topology()}
    assert pairs == {(lane, next_) for lane, behind in network.following.items() for next_ in behind}
    generator = np.random.default_rng(0)
    lanes = list(network.following)
    worst = np.zeros(3)
    for _ in range(1000):
        road, lane = lanes[generator.integers(len(lanes))]
        s = generator.uniform(0.01, network.road(road).length - 0.01)
        pose = lane_pose(network.road(road), lane, s)
        point = theirs.get_waypoint_xodr(road, lane, float(s))
        at = point.transform.location
        # CARLA's y points south, and so its angles count the other way round.
        away = math.hypot(at.x - pose.x, -at.y - pose.y)
        turn = math.radians(-point.transform.rotation.yaw) - pose.heading
        bent = math.degrees(abs((turn + math.pi) % (2 * math.pi) - math.pi))
        assert point.is_junction == (network.road(road).junction != -1)
        assert point.lane_width == pytest.approx(3.5)
        # The nearest lane that it finds is exact across, but along the lane it rounds to pieces of it (by 0.2 m on these arcs).
        nearest = theirs.get_waypoint(carla.Location(x=float(pose.x), y=-float(pose.y)))
        found = nearest.transform.location
        assert math.hypot(found.x - pose.x, -found.y - pose.y) < 0.5
        across = network.lane_path((nearest.road_id, nearest.lane_id)).project(np.array([[found.x, -found.y]])).lateral[0]
        worst = np.maximum(worst, [away, bent, abs(across)])
    print(f"{name}: {worst[0]:.2g} m, {worst[1]:.2g} degrees, and {worst[2]:.2g} m across the nearest lane")
    assert worst[0] < 0.01
    assert worst[1] < 0.1
    assert worst[2] < 0.01
    assert sorted(int(each.id) for each in theirs.get_all_landmarks_of_type("1000001")) == [each.id for each in network.signals]
