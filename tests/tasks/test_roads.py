import math

import numpy as np
import pytest
from lane_poses import lane_pose

from deadreckon.errors import UserError
from deadreckon.tasks.road_maps import figure_eight, town
from deadreckon.tasks.road_network import Connection, Junction, Network
from deadreckon.tasks.road_paths import Path, gaps, joined
from deadreckon.tasks.road_routes import Route
from deadreckon.tasks.roads import Geometry, Lane, Link, Road

EIGHT, TOWN = figure_eight(), town()
MAPS = {"eight": EIGHT, "town": TOWN, "ring": town((1, 1)), "narrow": town((1, 2)), "small eight": figure_eight(10.5, 3.5)}


def path(*rows: tuple[float, float, float, float, float], closed: bool = False) -> Path:
    """Of x, y, heading, curvature and length of each piece."""
    x, y, heading, curvature, length = np.array(rows, np.float64).T
    return Path(x, y, heading, curvature, length, closed)


def lap(network: Network, start: tuple[int, int]) -> Route:
    """The closed route on which no lane has a choice."""
    lanes = [start]
    while (next_ := network.following[lanes[-1]][0]) != start:
        lanes.append(next_)
    return Route(network, tuple(lanes), closed=True)


def beside(pose, lateral) -> np.ndarray:
    """(n, 2) points so many m to the left of poses (n,)."""
    return np.stack([pose.x - lateral * np.sin(pose.heading), pose.y + lateral * np.cos(pose.heading)], axis=1)


def some_routes(generator: np.random.Generator) -> list[Route]:
    """Three laps, and five routes that turn at random in the town."""
    chosen = []
    for start in generator.permutation(list(TOWN.following))[:5].tolist():
        lanes = [tuple(start)]
        for _ in range(12):
            behind = TOWN.following[lanes[-1]]
            lanes.append(behind[generator.integers(len(behind))])
        chosen.append(Route(TOWN, tuple(lanes)))
    return [lap(EIGHT, (1, -1)), lap(EIGHT, (1, 1)), lap(MAPS["ring"], (1, 1)), *chosen]


def test_poses_of_lines_and_arcs_are_their_closed_forms():
    line = path((1.0, 2.0, math.pi / 6, 0.0, 10.0)).pose(np.array([0.0, 4.0]))
    np.testing.assert_allclose(line.x, [1, 1 + 4 * math.sqrt(3) / 2], rtol=1e-15)
    np.testing.assert_allclose(line.y, [2, 4], rtol=1e-15)
    s = np.linspace(0, 20 * 1.5 * math.pi, 50)
    left = path((0.0, 0.0, 0.0, 1 / 20, 20 * 1.5 * math.pi)).pose(s)
    np.testing.assert_allclose([left.x, left.y], [20 * np.sin(s / 20), 20 - 20 * np.cos(s / 20)], atol=1e-13)
    np.testing.assert_allclose(left.heading, s / 20, atol=1e-15)
    right = path((0.0, 0.0, 0.0, -1 / 20, 20 * 1.5 * math.pi)).pose(s)
    np.testing.assert_allclose([right.x, right.y, right.heading], [left.x, -left.y, -left.heading], atol=1e-13)
    np.testing.assert_array_equal(right.curvature, -1 / 20)
    # An arc that hardly bends is a line, and not a division by 0.
    np.testing.assert_allclose(path((0.0, 0.0, 0.0, 1e-300, 10.0)).pose(7.0)[:3], [7, 0, 0], atol=1e-15)


def test_lanes_lie_to_the_right_of_who_drives_on_them():
    road = Road(1, (Geometry(0, 0, 0, 20 * math.pi / 2, 1 / 20),), (Lane(2, 2.0), Lane(1, 3.0), Lane(-1, 4.0)))
    assert [road.lane_offset(lane) for lane in (2, 1, -1)] == [4.0, 1.5, -2.0]
    along, against = road.lane_path(-1), road.lane_path(1)
    assert along.total == pytest.approx(22 * math.pi / 2, rel=1e-15)
    assert against.total == pytest.approx(18.5 * math.pi / 2, rel=1e-15)
    np.testing.assert_allclose(along.pose(0.0), [0, -2, 0, 1 / 22], atol=1e-14)
    np.testing.assert_allclose(against.pose(0.0), [18.5, 20, math.pi * 1.5, -1 / 18.5], atol=1e-14)
    np.testing.assert_allclose(against.pose(against.total), [0, 1.5, math.pi, -1 / 18.5], atol=1e-14)
    np.testing.assert_allclose(lane_pose(road, 1, 0.0, offset=0.5), [0, 1, math.pi, -1 / 18.5], atol=1e-14)
    np.testing.assert_allclose(road.pose(0.0, 5.0)[:2], [0, 5], atol=1e-14)
    with pytest.raises(UserError, match="road 1 has no lane 3, but 2, 1, -1"):
        road.lane_offset(3)
    with pytest.raises(UserError, match="road 1, lane 2: an arc of radius 3 m has no path 4 m inside of it"):
        Road(1, (Geometry(0, 0, 0, 1, 1 / 3),), (Lane(2, 2.0), Lane(1, 3.0)))


@pytest.mark.parametrize("name", MAPS)
def test_all_lanes_begin_where_those_before_end(name):
    network = MAPS[name]
    assert all(network.following.values())  # no way ends
    for lane, behind in network.following.items():
        end = network.lane_path(lane)
        for next_ in behind:
            apart, bent = gaps(end.pose(end.total), network.lane_path(next_).pose(0.0))
            assert apart < 1e-6
            assert bent < 1e-6
    # Each lane is entered, too, and all can be reached from any.
    assert {next_ for behind in network.following.values() for next_ in behind} == set(network.following)


@pytest.mark.parametrize("name", MAPS)
def test_routes_run_on_without_a_gap_through_every_junction(name):
    network = MAPS[name]
    through = [(road, -1) for road in (road.id for road in network.roads if road.junction != -1)]
    assert len(through) == sum(len(junction.connections) for junction in network.junctions)
    before = {next_: lane for lane, behind in network.following.items() for next_ in behind}
    for lane in through:
        route = Route(network, (before[lane], lane, network.following[lane][0]))
        at = np.array(route.starts[1:-1])
        before_, behind_ = route.pose(at - 1e-9), route.pose(at + 1e-9)
        assert max(map(np.max, gaps(before_, behind_))) < 1e-6


def test_each_lane_of_a_road_has_its_own_ways_through_a_junction():
    here, right = (Geometry(0, 0, 0, 10),), Link("junction", 9)
    two = Road(1, here, (Lane(-1, 3.0), Lane(-2, 3.0), Lane(-3, 2.0, kind="sidewalk")), successor=right)
    lane, before = (Lane(-1, 3.0),), Link("road", 1, "end")
    ways = [Road(id, (Geometry(10, y, 0, 5),), lane, before, junction=9) for id, y in ((2, 0.0), (3, -3.0))]
    junction = Junction(9, (Connection(1, 2, "start", ((-1, -1),)), Connection(1, 3, "start", ((-2, -1),))))
    network = Network((two, *ways), (junction,))
    assert network.following == {(1, -1): ((2, -1),), (1, -2): ((3, -1),), (2, -1): (), (3, -1): ()}


def test_the_figure_eight_is_two_arcs_and_two_lines_that_cross():
    route = lap(EIGHT, (1, -1))
    # Lanes are 1.75 m outside on one arc and 1.75 m inside on the other; lines are 40 m long.
    assert route.total == pytest.approx(2 * 1.5 * math.pi * 20 + 2 * 40, rel=1e-12)
    assert len({road for road, _ in route.lanes} | {road for road, _ in lap(EIGHT, (1, 1)).lanes}) == 8
    pose = route.pose(np.linspace(0, route.total, 2000))
    assert set(np.round(1 / pose.curvature[pose.curvature != 0], 9)) == {21.75, -18.25}
    end, begin = route.pose(route.total - 1e-9), route.pose(0.0)
    apart, bent = gaps(end, begin)
    assert apart < 1e-6
    assert bent < 1e-6
    assert EIGHT.roads[0].pose(EIGHT.roads[0].length).y == pytest.approx(0.0, abs=1e-12)


def test_a_town_has_streets_junctions_corners_and_lights():
    assert town() == TOWN
    assert len(TOWN.junctions) == 8  # 12 crossings, 4 of them corners
    assert sorted(len(junction.connections) for junction in TOWN.junctions) == [6] * 6 + [12] * 2
    turns = [network.geometry[0].curvature for network in TOWN.roads if network.junction != -1]
    assert {round(1 / turn) for turn in turns if turn} == {10, -10}
    assert len(TOWN.signals) == 6 * 3 + 2 * 4
    for signal in TOWN.signals:
        road = next(road for road in TOWN.roads if road.id == signal.road)
        lane = -1 if signal.orientation == "+" else 1
        # 1 m before the junction, on the right.
        route = Route(TOWN, ((road.id, lane),))
        assert [(pytest.approx(route.total - 1.0), signal)] == list(route.signals())
        assert signal.t * lane > 3.5
    assert [controller.signals for controller in TOWN.controllers] == [(signal.id,) for signal in TOWN.signals]
    for junction in TOWN.junctions:  # who comes in by one street has one light
        own = {controller.id: controller.signals[0] for controller in TOWN.controllers if controller.id in junction.controllers}
        lit = {signal.road for signal in TOWN.signals if signal.id in own.values()}
        assert lit == {connection.incoming for connection in junction.connections}
        assert len(own) == len(lit)
    for bad in ({"blocks": (0, 1)}, {"blocks": (2, 51)}, {"lane_width": 5.5}, {"lane_width": math.nan}):
        with pytest.raises(UserError, match="must be between"):
            town(**bad)
    with pytest.raises(UserError, match="radius must be between 10.5"):
        figure_eight(radius=10.0)


def test_projection_is_the_inverse_of_pose():
    generator = np.random.default_rng(0)
    for route in some_routes(generator):
        distance = generator.uniform(0, route.total, 1000)
        lateral = generator.uniform(-3.0, 3.0, 1000)
        pose = route.pose(distance)
        near = distance + generator.uniform(-4.0, 4.0, 1000)
        found = route.project(beside(pose, lateral), near)
        np.testing.assert_allclose(found.distance, distance, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.lateral, lateral, rtol=0, atol=1e-9)
        apart, bent = gaps(pose, route.pose(found.distance))
        assert max(apart.max(), bent.max()) < 1e-9
        assert np.abs(np.sin(found.heading - pose.heading)).max() < 1e-9


def bends(curvature: float) -> Path:
    """An arc, up to seven eighths of a circle, and one to the other side behind it."""
    length = min(5.5 / abs(curvature), 50.0) if curvature else 30.0
    first = path((3.0, -2.0, 2.0, curvature, length))
    end = first.pose(length)
    return joined([first, path((float(end.x), float(end.y), float(end.heading), -curvature / 2, length))])


def test_projection_finds_what_looking_everywhere_finds():
    generator = np.random.default_rng(1)
    paths = [*(bends(curvature) for curvature in (0.0, 0.05, -0.05, 1e-6, -0.3)), lap(EIGHT, (1, -1)).path]
    for both in paths:
        points = generator.uniform(-40, 40, (100, 2))
        dense = both.pose(np.linspace(0, both.total * (1 - 1e-12), 5001))
        away = np.hypot(points[:, :1] - dense.x, points[:, 1:] - dense.y).min(axis=1)
        found = both.project(points)
        foot = both.pose(found.distance)
        nearest = np.hypot(points[:, 0] - foot.x, points[:, 1] - foot.y)
        assert (nearest <= away + 1e-9).all()
        assert (nearest >= away - 0.06).all()
        # Within a window nothing outside of it is found, and the nearest in it is.
        near = generator.uniform(5, both.total - 5, 100)
        found = both.project(points, near, window=5.0)
        assert (np.abs(found.distance - near) <= 5.0 + 1e-9).all()
        along = near[:, None] + np.linspace(-5, 5, 1001)
        dense, foot = both.pose(along), both.pose(found.distance)
        away = np.hypot(points[:, :1] - dense.x, points[:, 1:] - dense.y).min(axis=1)
        nearest = np.hypot(points[:, 0] - foot.x, points[:, 1] - foot.y)
        assert (nearest <= away + 1e-9).all()


def test_progress_does_not_jump_where_the_figure_eight_crosses_itself():
    route = lap(EIGHT, (1, -1))
    way = np.arange(0.0, 2 * route.total, 0.5)
    lateral = 1.2 * np.sin(way / 7.0)
    points = beside(route.pose(way), lateral)
    naive = route.project(points).distance
    assert np.abs(np.diff(naive)[np.abs(np.diff(naive)) < route.total - 5]).max() > 50.0  # the nearest point jumps
    distance, progress = np.zeros(1), []
    for point in points:
        found = route.project(point[None], distance)
        progress.append(found.distance[0] - distance[0])
        distance = found.distance
    np.testing.assert_allclose(progress[1:], 0.5, atol=1e-9)
    assert distance[0] == pytest.approx(way[-1], abs=1e-9)


def test_windows_of_closed_routes_wrap_around_and_those_of_open_ones_end():
    route = lap(EIGHT, (1, -1))
    total = route.total
    true = np.array([2.0, total - 1.0, 3.0, -4.0])
    near = np.array([total - 1.0, 3 * total + 0.5, -2 * total - 1.0, 2.0])
    found = route.project(beside(route.pose(true), 0.5), near).distance
    np.testing.assert_allclose(found, [total + 2, 3 * total - 1, -2 * total + 3, -4], atol=1e-9)
    np.testing.assert_allclose(route.pose(true + 5 * total), route.pose(true), atol=1e-9)
    # A window longer than the route is the whole route, once.
    found = route.project(beside(route.pose(true), 0.5), near, window=1e9).distance
    assert (np.abs(found - near) <= total / 2 + 1e-9).all()
    open_ = Route(EIGHT, route.lanes)
    found = open_.project(beside(route.pose(true), 0.5), np.array([-3.0, total + 7, 0.0, total]))
    np.testing.assert_allclose(found.distance, [2, total - 1, 3, total - 4], atol=1e-9)
    behind = open_.project(beside(open_.pose([0.0]), 0.5) - [[3, -3]], np.zeros(1))  # heads south-east
    assert behind.distance[0] == 0.0
    assert behind.lateral[0] == pytest.approx(0.5, abs=1e-9)
    assert open_.project(np.zeros((0, 2)), np.zeros(0)).distance.shape == (0,)


def test_a_route_knows_what_lies_ahead():
    generator = np.random.default_rng(2)
    for route in some_routes(generator):
        distance, ahead = generator.uniform(0, route.total, 200), np.array([0.0, 5.0, 20.0])
        seen = route.curvature_ahead(distance, ahead)
        np.testing.assert_array_equal(seen, np.stack([route.pose(distance + each).curvature for each in ahead], axis=1))


def test_places_on_a_lane_are_those_beside_its_road():
    generator = np.random.default_rng(3)
    for network, key in ((each, key) for each in (EIGHT, TOWN) for key in each.following):
        road, route = network.road(key[0]), Route(network, (key,))
        for s in generator.uniform(0, road.length, 5):
            pose, mine = route.pose(route._distance(key, s)), lane_pose(road, key[1], s)
            np.testing.assert_allclose([mine.x, mine.y, mine.curvature], [pose.x, pose.y, pose.curvature], atol=1e-9)
            assert math.cos(mine.heading - pose.heading) == pytest.approx(1.0)


def test_lanes_of_a_route_follow_one_another():
    for lanes, closed in ((((1, 1), (1, -1)), False), (((1, 1),), True)):
        with pytest.raises(UserError, match="road 1, lane -?1 does not follow road 1, lane 1"):
            Route(MAPS["narrow"], lanes, closed)
    with pytest.raises(UserError, match="the network: no road 999"):
        Route(MAPS["narrow"], ((999, 1),))
