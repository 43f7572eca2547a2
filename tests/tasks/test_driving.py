"""Driving along a lane: the car by closed forms, the reward by hand, what every simulator promises, and what is drawn."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon.collect import generate
from deadreckon.collect.driving import CRUISE, pursue
from deadreckon.collect.references import controlled_returns, measure
from deadreckon.tasks import driving, road_scene
from deadreckon.tasks.car import AXLE, BRAKE, DRAG, DRIVE, GRIP, ROLL, STEER, STEP, course, moved
from deadreckon.tasks.driving import TASK


def car(speed=0.0, wheel=0.0, x=0.0, y=0.0, yaw=0.0):
    return np.array([[x, y, yaw, speed, wheel]])


def after(cars, pedal, steer, steps):
    for _ in range(steps):
        cars = moved(cars, np.array([[pedal, steer]]))
    return cars


def test_a_car_gathers_speed_to_where_resistance_is_as_great():
    x, _, _, speed, _ = after(car(), 1.0, 0.0, 20)[0]
    # dv/dt = a - c v²: v = sqrt(a / c) tanh(sqrt(a c) t), x = log(cosh(sqrt(a c) t)) / c.
    a, c = DRIVE - ROLL, DRAG
    assert speed == pytest.approx(np.sqrt(a / c) * np.tanh(np.sqrt(a * c)), rel=2e-3)
    assert x == pytest.approx(np.log(np.cosh(np.sqrt(a * c))) / c, rel=1e-3)
    assert after(car(), 1.0, 0.0, 4000)[0, 3] == pytest.approx(np.sqrt(a / c), rel=1e-4)


def test_brakes_stop_it_and_drive_it_no_further():
    stopped = after(car(speed=2.0), -1.0, 0.0, 10)[0]
    assert stopped[3] == 0.0
    assert stopped[0] == pytest.approx(2.0**2 / (2 * (BRAKE + ROLL)), rel=0.02)
    np.testing.assert_array_equal(after(stopped[None], -1.0, 1.0, 5)[0, :4], stopped[:4])


@pytest.mark.parametrize("steer", [-0.5, 0.2, 1.0])
def test_it_goes_round_in_the_circle_of_its_wheels_and_positive_is_to_the_right(steer):
    wheel = -STEER * steer
    slip = np.arctan(np.tan(wheel) / 2)
    radius = AXLE / np.sin(slip)
    speed = 1.0
    start = car(speed=speed, wheel=wheel)
    # So much throttle that the speed is kept.
    pedal = (ROLL + DRAG * speed**2) / DRIVE
    end = after(start, pedal, steer, 100)[0]
    assert end[2] == pytest.approx(speed * 100 * STEP / radius, rel=1e-6)
    assert np.sign(end[2]) == -np.sign(steer)
    centre = radius * np.array([-np.sin(slip), np.cos(slip)])
    assert np.hypot(*(end[:2] - centre)) == pytest.approx(abs(radius), rel=1e-4)
    np.testing.assert_allclose(course(end[None]), end[2] + slip)


def test_tyres_bear_no_more_than_their_grip():
    fast = car(speed=20.0, wheel=-STEER)
    turned = moved(fast, np.array([[0.0, 1.0]]))[0, 2]
    assert turned == pytest.approx(-GRIP / 20.0 * STEP, rel=5e-3)


def test_a_sliding_car_moves_along_its_course():
    speed = 12.0
    fast = car(speed=speed, wheel=-STEER)
    end = moved(fast, np.array([[(ROLL + DRAG * speed**2) / DRIVE, 1.0]]))
    along = np.arctan2(end[0, 1] - fast[0, 1], end[0, 0] - fast[0, 0])
    assert along == pytest.approx(course(fast)[0] + (end[0, 2] - fast[0, 2]) / 2, rel=1e-3)


def placed(offset=0.0, heading=0.0, speed=0.0, distance=30.0, task=TASK):
    """A simulator of one car in a given place beside the middle of its lane."""
    simulator = task.simulate([0])
    simulator.reset()
    pose = task.route.pose(np.array(distance))
    x, y = pose.x - offset * np.sin(pose.heading), pose.y + offset * np.cos(pose.heading)
    simulator.cars[0], simulator.distance[0] = [x, y, pose.heading + heading, speed, 0.0], distance
    return simulator


def test_observations_and_reward_by_hand():
    simulator = placed(offset=0.5, heading=0.1, speed=4.0, distance=25.0)
    seen = simulator._observe()[0]
    np.testing.assert_allclose(seen[:4], [4.0, 0.5, 0.1, 0.0], atol=1e-6)
    np.testing.assert_allclose(seen[4:], TASK.route.pose(25.0 + driving.AHEAD).curvature, atol=1e-6)
    pedal = (ROLL + DRAG * 16.0) / DRIVE
    seen, reward, terminal, timeout = simulator.step(np.array([[pedal, 0.0]]))
    angle = seen[0, driving.HEADING]
    assert reward[0] == pytest.approx(4.0 * np.cos(angle) - 5 * 4.0 * abs(np.sin(angle)), rel=1e-4)
    assert not terminal[0]
    assert not timeout[0]
    # It is at most 5 either way: straight along the lane, and straight across it.
    assert placed(speed=9.0).step(np.zeros((1, 2)))[1][0] == 5.0
    assert placed(heading=1.5, speed=9.0).step(np.zeros((1, 2)))[1][0] == -5.0


@pytest.mark.parametrize(("offset", "off"), [(-1.8, True), (-1.7, False), (5.2, False), (5.3, True)])
def test_who_leaves_the_road_pays_and_rests(offset, off):
    """The right edge is half a lane away, the left one a lane and a half."""
    simulator = placed(offset=offset)
    seen, reward, terminal, _ = simulator.step(np.zeros((1, 2)))
    assert terminal[0] == off
    assert reward[0] == -100.0 * off
    assert bool(TASK.ends(seen)[0]) == off
    if off:
        before = simulator.cars.copy()
        _, reward, terminal, timeout = simulator.step(np.ones((1, 2)))
        np.testing.assert_array_equal(simulator.cars, before)
        assert (reward[0], terminal[0], timeout[0]) == (0.0, False, False)


def test_the_lane_is_closed_and_progress_does_not_jump_at_the_crossing():
    total = TASK.route.total
    simulator = TASK.simulate([3])
    seen, begun = simulator.reset(), None
    for _ in range(1200):  # more than once round
        simulator._age[:] = 0
        seen, _, terminal, _ = simulator.step(pursue(seen))
        assert not terminal[0]
        begun = simulator.distance[0] if begun is None else begun
        moved_by = simulator.distance[0] - begun
        assert 0.0 <= moved_by < 0.5
        begun = simulator.distance[0]
    assert simulator.distance[0] > total
    assert abs(seen[0, driving.SPEED] - CRUISE) < 0.2


def test_the_controller_scores_100_and_uniform_actions_0():
    assert measure(TASK) == pytest.approx((TASK.reference.random, TASK.reference.expert), abs=1e-3)
    returns = controlled_returns(TASK, pursue, range(500, 540))
    scores = TASK.scores(returns)
    assert abs(scores.mean() - 100.0) < 4 * scores.std() / np.sqrt(len(scores)) + 0.5


def test_copies_depend_on_their_own_seed_and_go_on_where_they_were():
    rng = np.random.default_rng(0)
    many, few = TASK.simulate(range(5)), TASK.simulate([3])
    np.testing.assert_array_equal(many.reset()[[3]], few.reset())
    for _ in range(7):
        actions = rng.uniform(-1, 1, (5, 2))
        np.testing.assert_array_equal(many.step(actions)[0][[3]], few.step(actions[[3]])[0])
    kept, other = many.state(), TASK.simulate(range(9, 14))
    other.reset()
    other.restore(kept)
    actions = rng.uniform(-1, 1, (5, 2))
    for ours, theirs in zip(many.step(actions), other.step(actions)):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(many.reset(), other.reset())


def test_an_episode_of_250_steps_times_out():
    simulator = TASK.simulate([0])
    simulator.reset()
    ends = [simulator.step(np.zeros((1, 2)))[2:] for _ in range(250)]
    assert not any(terminal[0] for terminal, _ in ends)
    assert [bool(timeout[0]) for _, timeout in ends] == [False] * 249 + [True]


def test_gymnasiums_checks():
    check_env(gymnasium.make(TASK.gym_id).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("kind", ["", "-noisy", "-uniform"])
def test_a_short_log(kind):
    log, again = (generate(f"carla-lane-state{kind}-v0", steps=400) for _ in range(2))
    assert log.fingerprint == again.fingerprint
    assert log.episodes >= 2
    assert (np.abs(log.actions) <= 1.0).all()
    off = np.abs(log.actions - pursue(log.observations)).max()
    assert (off == 0.0) == (kind == "")
    if kind != "-uniform":
        assert log.observations[200:250, driving.SPEED].mean() > 4.0


def test_the_scene_is_of_all_roads_and_its_camera_where_the_driver_is():
    import mujoco

    network = replace(TASK, radius=30.0).route.network
    model = mujoco.MjModel.from_xml_string(road_scene.mjcf(network, (48, 48)))
    data = mujoco.MjData(model)
    data.mocap_pos[0], data.mocap_quat[0] = (1.0, 2.0, 3.0), (np.cos(0.5), 0.0, 0.0, np.sin(0.5))
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.cam_xpos[0], [1.0, 2.0, 3.0])
    # A camera looks along its -z, which is where the car's x points to; up is up.
    np.testing.assert_allclose(-data.cam_xmat[0].reshape(3, 3)[:, 2], [np.cos(1.0), np.sin(1.0), 0.0], atol=1e-9)
    np.testing.assert_allclose(data.cam_xmat[0].reshape(3, 3)[:, 1], [0.0, 0.0, 1.0], atol=1e-9)
    # The asphalt has the area of its roads, the crossing counted once for each way.
    area = sum(road.length * sum(lane.width for lane in road.lanes) for road in network.roads)
    mesh, geom = model.mesh("road"), next(i for i in range(model.ngeom) if model.geom_dataid[i] == model.mesh("road").id)
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    corners = data.geom_xpos[geom] + vertices @ data.geom_xmat[geom].reshape(3, 3).T
    a, b, c = (corners[model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0], k]] for k in range(3))
    up = np.cross(b - a, c - a)[:, 2] / 2
    assert (up > 0.0).all()
    assert up.sum() == pytest.approx(area, rel=0.02)  # inside of bends less, outside more
    np.testing.assert_allclose(corners[:, 2], road_scene.ROAD_HIGH, atol=1e-4)


class Drawn:
    """In place of MuJoCo's renderer, which needs OpenGL: keeps what it was asked to show."""

    def __init__(self, model, height, width):
        self.size = height, width

    def update_scene(self, data, camera):
        self.place, self.camera = data.mocap_pos[0].copy(), camera

    def render(self):
        return np.zeros((*self.size, 3), np.uint8)


def test_pictures_are_seen_from_the_place_of_the_camera(monkeypatch):
    import mujoco

    monkeypatch.setattr(mujoco, "Renderer", Drawn)
    env = gymnasium.make(TASK.gym_id, render_mode="rgb_array", width=48, height=48).unwrapped
    env.reset(seed=0)
    assert env.render().shape == (48, 48, 3)
    x, y, yaw = env.simulator.cars[0, :3]
    drawn = env._renderer._renderer
    np.testing.assert_allclose(drawn.place, [x + 1.6 * np.cos(yaw), y + 1.6 * np.sin(yaw), 1.7])
    assert drawn.camera == "driver"
