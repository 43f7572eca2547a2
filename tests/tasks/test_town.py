"""Driving in a town: observations and reward by hand, ends, the controller, and what every simulator promises."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from town_lanes import TABLE, street

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon.collect.driving import KINDS, collect_driving
from deadreckon.collect.recipes import recipe
from deadreckon.collect.references import measure
from deadreckon.collect.town import NOISE, drive, route_ahead
from deadreckon.tasks import car, town, traffic
from deadreckon.tasks.lane_table import NONE
from deadreckon.tasks.town import TASK
from deadreckon.tasks.traffic import GREEN, LENGTH, PHASE, RED, YELLOW

COAST = np.zeros((1, 2))


def placed(lane=None, along=20.0, speed=0.0, offset=0.0, heading=0.0, task=TASK):
    """A simulator whose car is on the first lane of its route, and whose other cars are all far away from it."""
    simulator = task.simulate([0])
    simulator.reset()
    lane = street() if lane is None else lane
    simulator.route[0] = TABLE.ways(np.array([lane]), np.full((1, town.ROUTE - 1), 0.5))[0]
    simulator._begins[0] = np.cumsum(TABLE.length[simulator.route[0]]) - TABLE.length[simulator.route[0]]
    pose = TABLE.pose(np.array(lane), np.array(along))
    x, y = pose.x - offset * np.sin(pose.heading), pose.y + offset * np.cos(pose.heading)
    simulator.cars[0] = x, y, pose.heading + heading, speed, 0.0
    simulator.distance[0], simulator._front[0] = along, along + LENGTH / 2
    middle = TABLE.pose(np.arange(len(TABLE.length)), TABLE.length / 2)
    away = np.hypot(middle.x - x, middle.y - y) * (TABLE.junction == NONE)
    far = int(away.argmax())
    simulator.traffic.place(0, np.full(20, far), np.arange(20) * 1e-3, np.full(20, 8.0), np.zeros((20, traffic.TURNS)))
    return simulator


def show(simulator, colour):
    """Sets all clocks so that the light before the car shows a colour, for some steps more."""
    light = simulator._light()[1][0]
    junction, turn, _ = TABLE.switched[:, light]
    into = {GREEN: 0, YELLOW: traffic.GREEN_FOR, RED: traffic.GREEN_FOR + traffic.YELLOW_FOR}[colour]
    simulator.clock[0, junction] = turn * PHASE + into


def test_observations_by_hand():
    lane = street()
    simulator = placed(lane, along=20.0, speed=4.0, offset=0.5, heading=0.1)
    show(simulator, YELLOW)
    # Another car 8 m ahead on the lane, and one that comes towards ours beside it.
    simulator.traffic.way[0, 7] = [lane, *simulator.route[0, :4]]
    simulator.traffic.along[0, 7], simulator.traffic.speed[0, 7] = 28.0, 5.0
    pose = TABLE.pose(np.array(lane), np.array(25.0))
    beside = np.array([[pose.x - 3.5 * np.sin(pose.heading), pose.y + 3.5 * np.cos(pose.heading)]])
    found = TABLE.project(beside, np.arange(len(TABLE.length))[None], np.zeros((1, 1)), TABLE.length[None])
    back = int(np.abs(found.lateral[0]).argmin())
    simulator.traffic.way[0, 4, 1:] = TABLE.ways(np.array([back]), np.zeros((1, 3)))[0]
    simulator.traffic.along[0, 4], simulator.traffic.speed[0, 4] = found.distance[0, back], 6.0
    seen = simulator._observe()[0]
    np.testing.assert_allclose(seen[:4], [4.0, 0.5, 0.1, 0.0], atol=1e-6)
    bends = [TABLE.path.curvature[simulator.route[0, 0 if 20.0 + each < 35.0 else 1]] for each in town.AHEAD]
    np.testing.assert_allclose(seen[4:12], bends, atol=1e-7)
    np.testing.assert_allclose(seen[12:16], [34.0 - 20.0 - LENGTH / 2, 0, 1, 0], atol=1e-6)
    cos, sin = np.cos(0.1), np.sin(0.1)
    turn = np.array([[cos, sin], [-sin, cos]])  # into the car's coordinates
    near, far = seen[16:22], seen[22:28]
    np.testing.assert_allclose(near[1:3], turn @ [5.0, 3.0], atol=1e-5)
    np.testing.assert_allclose(near[3:5], turn @ [-6.0, 0.0] - [4.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(far[1:3], turn @ [8.0, -0.5], atol=1e-5)
    np.testing.assert_allclose(far[3:5], turn @ [5.0, 0.0] - [4.0, 0.0], atol=1e-5)
    np.testing.assert_allclose([near[0], far[0], abs(near[5] + 0.1), far[5]], [1.0, 1.0, np.pi, -0.1], atol=1e-5)
    assert not seen[28:].any()  # the others are beyond the radius


def test_no_light_is_seen_from_far_and_none_behind():
    seen = placed(street(towards_light=False), along=1.0)._observe()[0]
    np.testing.assert_array_equal(seen[12:16], [town.LIGHT_SEEN, 0, 0, 0])
    lane = street()
    simulator = placed(lane, along=TABLE.line[lane] - LENGTH / 2 + 0.1)
    route = simulator.route[0]
    assert np.isfinite(TABLE.line[route[2]])
    away = TABLE.length[route[:2]].sum() + TABLE.line[route[2]] - TABLE.line[lane] - 0.1
    assert simulator._observe()[0, 12] == pytest.approx(min(away, town.LIGHT_SEEN), abs=1e-5)


def test_the_reward_is_the_speed_along_the_lane():
    simulator = placed(along=5.0, speed=6.0, heading=0.2)
    _, reward, terminal, _ = simulator.step(COAST)
    speed, angle = simulator.cars[0, car.VELOCITY], simulator.cars[0, car.YAW] - TABLE.path.heading[street()]
    assert reward[0] == pytest.approx(speed * np.cos(angle), rel=1e-12)
    assert 5.8 < reward[0] < 6.0 * np.cos(0.19)
    assert not terminal[0]
    assert placed(along=20.0, speed=6.0, heading=np.pi).step(COAST)[1][0] < -5.8  # the wrong way


@pytest.mark.parametrize(("away", "hit"), [(LENGTH - 0.1, True), (LENGTH + 0.6, False)])
def test_who_hits_another_car_pays_and_rests(away, hit):
    simulator = placed(along=15.0, speed=2.0)
    simulator.traffic.way[0, 7] = [street(), *simulator.route[0, :4]]
    simulator.traffic.along[0, 7] = 15.0 + away
    _, reward, terminal, timeout = simulator.step(COAST)
    assert (bool(terminal[0]), bool(simulator.crashes[0]), bool(timeout[0])) == (hit, hit, False)
    assert (reward[0] == -100.0) == hit
    if hit:
        before = simulator.state()
        _, reward, terminal, timeout = simulator.step(np.ones((1, 2)))
        assert (reward[0], terminal[0], timeout[0]) == (0.0, False, False)
        after = simulator.state()
        assert all(np.array_equal(after[name], column) for name, column in before.items())


@pytest.mark.parametrize(("offset", "off"), [(-1.8, True), (-1.7, False), (5.2, False), (5.3, True)])
def test_who_leaves_the_road_pays(offset, off):
    _, reward, terminal, _ = placed(offset=offset).step(COAST)
    assert (reward[0], bool(terminal[0])) == (-100.0 * off, off)


@pytest.mark.parametrize(("colour", "ends"), [(GREEN, False), (YELLOW, False), (RED, True)])
def test_passing_a_red_light_ends_the_episode_without_a_reward(colour, ends):
    lane = street()
    simulator = placed(lane, along=TABLE.line[lane] - LENGTH / 2 - 0.3, speed=4.0)
    show(simulator, colour)
    _, reward, terminal, _ = simulator.step(COAST)  # 0.2 m
    assert (bool(terminal[0]), bool(simulator.reds[0])) == (False, False)
    assert reward[0] > 3.9
    _, reward, terminal, _ = simulator.step(COAST)
    assert (bool(terminal[0]), bool(simulator.reds[0]), bool(simulator.crashes[0])) == (ends, ends, False)
    assert (reward[0] == 0.0) == ends
    if not ends:  # who is over the line when it turns red goes on
        show(simulator, RED)
        assert not any(simulator.step(COAST)[2][0] for _ in range(5))


def test_others_stop_for_the_learners_car():
    lane = street()
    simulator = placed(lane, along=25.0)
    simulator.traffic.way[0, 7] = [lane, *simulator.route[0, :4]]
    simulator.traffic.along[0, 7], simulator.traffic.speed[0, 7] = 4.0, 8.0
    for _ in range(200):
        assert not simulator.step(np.array([[-1.0, 0.0]]))[2][0]
    gap = 25.0 - simulator.traffic.along[0, 7] - LENGTH
    assert gap == pytest.approx(traffic.STANDSTILL, abs=0.1)


@pytest.mark.parametrize("there", [True, False])
def test_others_wait_while_the_learners_car_is_in_the_junction(there):
    lane = street()
    other = next(
        i
        for i in np.flatnonzero(TABLE.junction[TABLE.following[:, 0]] == TABLE.junction[TABLE.following[lane, 0]])
        if i != lane
    )
    through = TABLE.following[lane, 0] if there else lane
    simulator = placed(through, along=3.0)
    simulator.traffic.way[0, 7] = [other, *TABLE.ways(np.array([other]), np.full((1, 3), 0.1))[0]]
    simulator.traffic.along[0, 7] = TABLE.line[other] - LENGTH
    junction, turn, _ = TABLE.switched[:, TABLE.light[other]]
    simulator.clock[0, junction] = turn * PHASE
    for _ in range(80):
        simulator.step(np.array([[-1.0, 0.0]]))
    assert bool(simulator.traffic.way[0, 7, 1] == other) == there


@pytest.mark.slow
def test_the_controller_drives_without_harm_and_progress_is_continuous():
    """1,000 steps, through several junctions each."""
    copies = 4
    simulator = TASK.simulate(range(40, 40 + copies))
    seen = simulator.reset()
    begun, begins, returns = simulator.distance.copy(), simulator.distance.copy(), np.zeros(copies)
    for step in range(1000):
        seen, rewards, terminals, timeouts = simulator.step(drive(seen))
        assert not terminals.any()
        assert (timeouts == (step == 999)).all()
        moved = simulator.distance - begun
        assert (moved > -1e-3).all()
        assert (moved < 0.4).all()
        assert (np.abs(seen[:, town.OFFSET]) < 1.0).all()
        begun, returns = simulator.distance.copy(), returns + rewards
    way = simulator.distance - begins
    assert (way > 60.0).all()
    # What it earns is the way that it drives, but for what is cut and added in bends.
    np.testing.assert_allclose(returns * car.STEP, way, rtol=0.1)
    on = simulator._on()
    assert (np.array([(TABLE.junction[simulator.route[i, : on[i]]] != NONE).sum() for i in range(copies)]) >= 2).all()


def test_the_controller_sees_its_route():
    lane = street()
    simulator = placed(lane, along=25.0, offset=0.4, heading=0.2)
    way = route_ahead(simulator._observe().astype(np.float64))[0]
    x, y, yaw = simulator.cars[0, :3]
    at = 25.0 + np.arange(len(way))
    lanes = simulator.route[0, (at >= TABLE.length[lane]).astype(int)]
    pose = TABLE.pose(lanes, np.where(at >= TABLE.length[lane], at - TABLE.length[lane], at))
    right, up = pose.x - x, pose.y - y
    expected = np.stack([right * np.cos(yaw) + up * np.sin(yaw), up * np.cos(yaw) - right * np.sin(yaw)], 1)
    np.testing.assert_allclose(way[:11], expected[:11], atol=1e-5)
    assert np.abs(way[:20] - expected[:20]).max() < 0.5  # it sees the curvature every few metres only


def test_copies_depend_on_their_own_seed_and_go_on_where_they_were():
    short = replace(TASK, horizon=40)
    rng = np.random.default_rng(0)
    many, few = short.simulate(range(8)), short.simulate([3])
    np.testing.assert_array_equal(many.reset()[[3]], few.reset())
    for _ in range(30):
        actions = rng.uniform((-0.5, -1.0), (1.0, 1.0), (8, 2))
        for ours, theirs in zip(many.step(actions), few.step(actions[[3]])):
            np.testing.assert_array_equal(ours[[3]], theirs)
    many.reset(np.array([1, 6]))  # so that copies are of different ages
    kept, other = many.state(), short.simulate(range(9, 17))
    other.reset()
    other.restore(kept)
    again = short.simulate(range(8))
    again.restore(kept)
    for _ in range(20):
        actions = rng.uniform(-1, 1, (8, 2))
        for ours, theirs, third in zip(many.step(actions), other.step(actions), again.step(actions)):
            np.testing.assert_array_equal(ours, theirs)
            np.testing.assert_array_equal(ours, third)
        over = np.flatnonzero(~many._alive)
        if len(over):
            np.testing.assert_array_equal(many.reset(over), other.reset(over))
            again.reset(over)
    assert all(np.array_equal(column, other.state()[name]) for name, column in many.state().items())


def test_gymnasiums_checks():
    check_env(gymnasium.make(TASK.gym_id).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_short_log(kind, tmp_path):
    name = f"carla-town-state{'' if kind == 'controller' else f'-{kind}'}-v0"
    assert (recipe(name).task, recipe(name).steps) == (TASK.name, 100_000)
    assert recipe(name).make.keywords == {"act": drive, "noise": NOISE}
    make = lambda at: collect_driving(  # noqa: E731
        replace(TASK, horizon=60), kind, act=drive, noise=NOISE, name=name, steps=300, scratch=tmp_path / at
    )
    log = make("first")
    assert log.fingerprint == make("second").fingerprint
    assert log.observations.shape == (300, 46)
    assert log.episodes == 5
    off = np.abs(log.actions - drive(log.observations))
    assert (off.max() == 0.0) == (kind == "controller")
    if kind == "noisy":
        assert 0.5 * NOISE < off.std() < NOISE


@pytest.mark.slow
def test_the_controller_scores_100_and_uniform_actions_0():
    assert measure(TASK) == pytest.approx((TASK.reference.random, TASK.reference.expert), abs=1e-3)
