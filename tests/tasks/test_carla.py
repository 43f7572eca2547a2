"""Driving in CARLA servers, against a stand-in for the client package: what is called in which order, paid, ended and left."""

import gc
import importlib
import sys

import numpy as np
import pytest
from fake_carla import Fake, Vector

import deadreckon as dr
from deadreckon.errors import UserError
from deadreckon.policies import BlackBoxPolicy
from deadreckon.tasks import carla_server, carla_task, registry
from deadreckon.tasks.driving import TASK

LANE, TOWN = "carla:localhost:2000/lane", "carla:localhost:2000/town"
AHEAD = np.array([[0.3, 0.0]])


@pytest.fixture
def fake(monkeypatch):
    made = Fake()
    monkeypatch.setitem(sys.modules, "carla", made)
    monkeypatch.setattr(carla_server, "PATIENCE", 0.0)
    return made


def left_as_found(fake):
    """Nothing is left in the server, and its settings are the first; in the order in which that is done."""
    assert fake.actors == {}
    assert fake.named("settings")[-1] == (False, None)
    assert fake.world.settings.synchronous_mode is False
    assert fake.world.weather == "clouds"
    order = fake.order()
    at = {
        name: len(order) - 1 - order[::-1].index(name) for name in ("stop", "destroy", "weather", "settings") if name in order
    }
    assert list(at.values()) == sorted(at.values())
    return True


def test_names():
    task = registry.task("carla:localhost:2000,gpu-1.lab:65535/town?timeout=60")
    assert isinstance(task, carla_task.CarlaTask)
    assert (task.servers, task.scene, task.timeout) == ((("localhost", 2000), ("gpu-1.lab", 65535)), "town", 60.0)
    assert (task.horizon, task.observation_shape, task.observation_dtype) == (1000, (48, 48, 3), "uint8")
    assert task.most_copies == 2
    assert registry.task(LANE).horizon == 250
    assert registry.task(LANE).published.expert == pytest.approx(1023.58, abs=0.01)
    assert registry.task(LANE).reference is None


@pytest.mark.parametrize(("name", "words"), [
    ("carla:localhost:2000", "write carla:HOST:PORT/lane or carla:HOST:PORT/town"),
    ("carla:localhost:2000/", "unknown scene of a CARLA server ''"),
    ("carla:localhost:2000/twon", "did you mean town"), ("carla:localhost:0/lane", "a number from 1 to 65535, got '0'"),
    ("carla:localhost:65536/lane", "got '65536'"), ("carla:localhost:20x0/lane", "got '20x0'"),
    ("carla:localhost:/lane", "got ''"),
    ("carla:localhost/lane", "a host or a port is missing"), ("carla::2000/lane", "a host or a port is missing"),
    ("carla:../etc:2000/lane", "unknown scene"), ("carla:..:2000/lane", "'..' is no host"),
    ("carla:a b:2000/lane", "'a b' is no host"),
    ("carla:a\x1b[2J:2000/lane", "no host"), ("carla:a\n:2000/lane", "no host"), ("carla:-rf:2000/lane", "'-rf' is no host"),
    ("carla:localhost:２000/lane", "the port must be"), ("carla:h:1,h:1/lane", "named twice"),
    ("carla:h:1,/lane", "is missing"),
    ("carla:h:1/lane?timeout=0", "timeout must be 0.1 to 3600 seconds, got 0"), ("carla:h:1/lane?timeout=x", "got x"),
    ("carla:h:1/lane?weather=1", "unknown option of a CARLA server 'weather'"),
])  # fmt: skip
def test_names_that_cannot_be_are_refused(name, words):
    with pytest.raises(UserError, match=words) as error:
        registry.task(name)
    assert "\x1b" not in str(error.value)
    assert "\n" not in str(error.value)


def test_a_run_from_elsewhere_names_no_server():
    with pytest.raises(UserError, match="the run's task is in a CARLA server, carla:evil:1/lane: name it"):
        registry.of_run("carla:evil:1/lane")
    with pytest.raises(UserError, match="has a horizon of its own, 250 steps"):
        registry.task(LANE, horizon=5)


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "carla", None)
    with pytest.raises(
        UserError, match=r"`carla` is not installed .*: install deadreckon\[carla\], which needs Python 3.11 or 3.12"
    ):
        registry.task(LANE).simulate([0])


def test_more_copies_than_servers(fake):
    with pytest.raises(UserError, match=r"2 copies are asked for, and its server is one; name as many, carla:HOST:PORT,HOST"):
        registry.task(LANE).simulate([0, 1])
    assert fake.calls == []


def test_the_order_of_an_episode(fake):
    simulator = registry.task(LANE).simulate([3])
    order = fake.order()
    assert order == ["client", "version", "generate", "settings", "weather"]
    assert fake.named("client") == [("localhost", 2000)]
    assert fake.timeout == 20.0
    assert fake.named("settings") == [(True, 0.05)]
    assert fake.named("generate") == [{"wall_height": 0.0}]
    seen = simulator.reset()
    order = fake.order()[len(order) :]
    assert order[:5] == ["spawn", "spawn", "listen", "spawn", "listen"]
    assert order[5:] == ["control", *["tick"] * carla_server.SETTLE]
    camera = next(each for each in fake.actors.values() if each.type_id == "sensor.camera.rgb")
    assert camera.attributes["image_size_x"] == camera.attributes["image_size_y"] == camera.attributes["fov"] == "48"
    assert vars(camera.place.location) == {"x": 1.6, "y": 0.0, "z": 1.7}
    assert camera.parent is fake.car
    assert seen.dtype == np.uint8
    assert seen.shape == (1, 48, 48, 3)
    assert seen[0, 5, 7].tolist() == [fake.frame, 5, 7]  # red, green, blue
    observations, rewards, terminals, timeouts = simulator.step(np.array([[0.4, -0.2]]))
    assert fake.named("control")[-1] == (pytest.approx(0.4), 0.0, pytest.approx(-0.2))
    assert observations[0, 0, 0, 0] == fake.frame
    simulator.step(np.array([[-0.5, 7.0]]))
    assert fake.named("control")[-1] == (0.0, 0.5, 1.0)
    first = fake.car
    simulator.reset()
    assert fake.car is not first
    assert len(fake.actors) == 3
    simulator.close()
    assert left_as_found(fake)
    with pytest.raises(UserError, match="the simulator has been closed"):
        simulator.reset()


def test_a_map_that_is_there_is_not_loaded_again(fake):
    for name, what in ((LANE, "generate"), (TOWN, "load")):
        for _ in range(2):
            registry.task(name).simulate([0]).close()
        assert len(fake.named(what)) == 1


def test_pictures_that_come_late_are_dropped(fake):
    simulator = registry.task(LANE).simulate([3])
    fake.late = 2
    assert simulator.reset()[0, 0, 0, 0] == fake.frame
    for _ in range(3):
        assert simulator.step(AHEAD)[0][0, 0, 0, 0] == fake.frame


@pytest.mark.parametrize(("change", "words"), [
    ({"silent": True}, r"no image of step \d+ came within 0.1 s"),
    ({"ahead": 1}, r"an image of step \d+ came at step \d+; another client makes steps there"),
    ({"size": 32}, "an image has 32 x 32 pixels, 48 x 48 were asked for"),
    ({"fail": {"tick": (0, RuntimeError("time-out of 20000ms while waiting\nfor the simulator"))}},
     "localhost:2000: cannot make a step: time-out of 20000ms while waiting for the simulator"),
    ({"fail": {"control": (0, RuntimeError("actor is dead"))}}, "cannot steer the car: actor is dead"),
])  # fmt: skip
def test_what_goes_wrong_in_a_step_is_one_line_and_nothing_is_left(fake, change, words):
    simulator = registry.task(f"{LANE}?timeout=0.1").simulate([3])
    simulator.reset()
    for name, value in change.items():
        setattr(fake, name, value)
    with pytest.raises(UserError, match=words) as error:
        simulator.step(AHEAD)
    assert "\n" not in str(error.value)
    assert left_as_found(fake)


@pytest.mark.parametrize("what", ["settings", "weather", "generate", "spawn", "listen", "control", "tick"])
def test_an_interrupt_anywhere_leaves_nothing(fake, what):
    fake.fail[what] = (0, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        registry.task(LANE).simulate([3]).reset()
    assert left_as_found(fake)


def test_an_interrupt_while_leaving_does_not_keep_the_rest_from_being_put_back(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    fake.fail["weather"] = (0, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        simulator.close()
    assert fake.actors == {}
    assert fake.world.settings.synchronous_mode is False


def test_losing_the_simulator_leaves_the_server(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    del simulator
    gc.collect()
    assert left_as_found(fake)


def test_a_server_that_is_gone_is_left_soon(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    gone = RuntimeError("time-out of 20000ms while waiting for the simulator")
    fake.fail = {name: (0, gone) for name in ("tick", "destroy", "settings", "weather", "stop")}
    with pytest.raises(UserError, match="cannot make a step: time-out"):
        simulator.step(AHEAD)
    assert fake.timeout == 1.0


@pytest.mark.parametrize(("change", "words"), [
    ({"versions": ("0.9.15", "0.9.16")}, "has version 0.9.16, the client package 0.9.15: they must be the same"),
    ({"fail": {"version": (0, RuntimeError("time-out of 20000ms"))}}, "localhost:2000: cannot reach it: time-out of 20000ms"),
    ({"fail": {"client": (0, RuntimeError("resolve: Host not found"))}}, "cannot reach it: resolve: Host not found"),
    ({"fail": {"generate": (0, RuntimeError("failed"))}}, "cannot load its map: failed"),
])  # fmt: skip
def test_a_server_that_cannot_be_used(fake, change, words):
    for name, value in change.items():
        setattr(fake, name, value)
    with pytest.raises(UserError, match=words):
        registry.task(LANE).simulate([0])
    assert fake.actors == {}
    assert fake.world.settings.synchronous_mode is False


def test_a_world_with_others_in_it_is_left_alone(fake):
    guest = fake.world.spawn_actor(fake.world.get_blueprint_library()[0], fake.world.get_map().get_spawn_points()[0])
    with pytest.raises(UserError, match="its world has 1 vehicles already; another client is at work there, or one was killed"):
        registry.task(LANE).simulate([0])
    assert list(fake.actors.values()) == [guest]
    assert not {"generate", "settings", "destroy"} & set(fake.order())


def test_no_place_for_the_car(fake):
    fake.full = True
    with pytest.raises(UserError, match="there is no place for the car"):
        registry.task(LANE).simulate([0]).reset()
    assert left_as_found(fake)


def test_the_lane_pays_by_our_own_geometry(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    theirs = TASK.simulate([3])
    theirs.reset()
    place = fake.car.place
    np.testing.assert_allclose([place.location.x, -place.location.y], theirs.cars[0, :2])
    np.testing.assert_allclose(-place.rotation.yaw, np.degrees(theirs.cars[0, 2]))
    pose = TASK.route.pose(theirs.distance[0])
    place.location.x, place.location.y = float(pose.x), -float(pose.y)
    # 3 m/s, 0.05 rad to the left of the lane: it pays 3 cos 0.05 - 15 sin 0.05, but for the bend of 0.15 m
    place.rotation.yaw = -np.degrees(float(pose.heading) + 0.05)
    reward = simulator.step(AHEAD)[1][0]
    assert reward == pytest.approx(3 * np.cos(0.05) - 15 * np.sin(0.05), abs=0.15)
    place.rotation.yaw += 90.0
    assert simulator.step(AHEAD)[1][0] == -5.0
    side = TASK.route.pose(theirs.distance[0])
    for offset, over in ((-1.7, False), (5.2, False), (5.3, True)):
        simulator.reset(seeds=[3])
        place = fake.car.place.location
        place.x, place.y = float(side.x - offset * np.sin(side.heading)), -float(side.y + offset * np.cos(side.heading))
        _, rewards, terminals, timeouts = simulator.step(np.array([[0.0, 0.0]]))
        assert (bool(terminals[0]), bool(timeouts[0])) == (over, False)
        assert rewards[0] == (-100.0 if over else 0.0)
    count = len(fake.named("tick"))
    simulator.step(AHEAD)  # rests until its reset
    assert len(fake.named("tick")) == count


def test_a_collision_ends_the_episode(fake):
    simulator = registry.task(LANE).simulate([3])
    fake.on_tick = lambda fake: fake.bump()  # while it settles, which does not count
    simulator.reset()
    fake.on_tick = lambda fake: None
    _, rewards, terminals, _ = simulator.step(np.array([[-1.0, 0.0]]))
    assert (rewards[0], terminals[0]) == (0.0, False)
    fake.on_tick = lambda fake: fake.bump()
    _, rewards, terminals, _ = simulator.step(np.array([[-1.0, 0.0]]))
    assert (rewards[0], terminals[0]) == (-100.0, True)
    fake.on_tick = lambda fake: None
    simulator.reset()
    assert not simulator.step(np.array([[-1.0, 0.0]]))[2][0]


def test_time_limits(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    ends = [simulator.step(np.array([[-1.0, 0.0]]))[2:] for _ in range(250)]
    assert not np.any([terminal for terminal, _ in ends])
    assert [bool(timeout[0]) for _, timeout in ends] == [False] * 249 + [True]


def in_town(fake, x=0.0, y=0.0):
    simulator = registry.task(TOWN).simulate([3])
    simulator.reset()
    fake.car.place.location.x, fake.car.place.location.y = x, y
    return simulator


def test_the_town_has_other_cars_and_a_traffic_manager(fake):
    simulator = in_town(fake)
    cars = [each for each in fake.actors.values() if each.type_id.startswith("vehicle")]
    assert len(cars) == 21
    assert {each.type_id for each in cars} == {"vehicle.audi.a2"}  # of four wheels
    assert {each.port for each in cars} == {None, 8000}
    assert fake.named("load") == ["Town01"]
    assert fake.named("manager synchronous") == [True]
    assert fake.named("slower") == [30.0]
    order = fake.order()
    assert order.index("manager synchronous") < order.index("spawn")
    assert order.index("lights") < order.index("tick")
    seeds = fake.named("manager seed")
    places = [each.place.location.x for each in cars]
    simulator.reset(seeds=[3])
    assert fake.named("manager seed") == seeds * 2
    again = [each.place.location.x for each in fake.actors.values() if each.type_id.startswith("vehicle")]
    assert again[1:] == places[1:]
    simulator.reset()
    assert fake.named("manager seed")[2] != seeds[0]
    simulator.close()
    assert fake.named("manager synchronous") == [True, False]
    assert left_as_found(fake)


def test_the_town_pays_speed_along_the_lane(fake):
    simulator = in_town(fake)
    fake.car.place.rotation.yaw = 60.0
    assert simulator.step(np.array([[0.8, 0.0]]))[1][0] == pytest.approx(8.0 * 0.5)
    fake.lane_id = -2
    _, rewards, terminals, _ = simulator.step(np.array([[-1.0, 0.0]]))
    assert (rewards[0], terminals[0]) == (-100.0, True)
    simulator.close()
    fake.lane_id = 1
    assert in_town(fake, y=4.5).step(np.array([[-1.0, 0.0]]))[2][0]


def test_in_a_junction_the_nearest_way_on_counts(fake):
    simulator = in_town(fake, x=19.8)
    simulator.step(np.array([[0.2, 0.0]]))  # at 19.9, before the junction, whose own waypoints lead against it
    fake.car.place.rotation.yaw = -90.0
    place = fake.car.place.location
    simulator.step(np.array([[0.2, 0.0]]))
    place.x, place.y = 20.0, -2.0  # turned into the way to the left
    assert simulator.step(np.array([[0.5, 0.0]]))[1][0] == pytest.approx(5.0)


@pytest.mark.parametrize(("state", "over"), [("red", True), ("green", False), (None, False)])
def test_a_red_light_ends_the_episode_and_costs_nothing(fake, state, over):
    simulator = in_town(fake, x=19.0)
    light = None if state is None else type("Light", (), {"state": state})()
    fake.car.light = light
    assert not simulator.step(np.array([[0.2, 0.0]]))[2][0]
    fake.car.light = None  # the place where it is told from ends before the junction
    fake.car.place.location.x = 20.5
    _, rewards, terminals, _ = simulator.step(np.array([[0.1, 0.0]]))
    assert bool(terminals[0]) is over
    assert rewards[0] > -100.0


def test_states_hold_what_follows_from_seeds_alone(fake):
    simulator = registry.task(LANE).simulate([3])
    simulator.reset()
    simulator.step(AHEAD)
    state = simulator.state()
    simulator.reset()
    place = Vector(**vars(fake.car.place.location))
    simulator.close()
    other = registry.task(LANE).simulate([9])
    assert other.restore(state).tolist() == [0]
    other.reset(np.array([0]))
    assert (fake.car.place.location.x, fake.car.place.location.y) == (place.x, place.y)
    other.close()
    assert registry.task(LANE).simulate([9]).restore(state | {"alive": np.array([False])}) is None


def test_several_servers_are_stepped_together(monkeypatch, fake):
    second = Fake()
    clients = {2000: fake.Client, 2003: second.Client}
    fake.Client = lambda host, port: clients[port](host, port)
    simulator = registry.task("carla:localhost:2000,localhost:2003/town").simulate([3, 4])
    simulator.reset()
    assert {each.port for each in second.actors.values()} == {None, 8003}
    assert simulator.step(np.array([[0.3, 0.0], [-1.0, 0.0]]))[1].tolist() == pytest.approx([3.0, 0.0])
    simulator.reset(np.array([1]))
    assert (len(fake.named("destroy")), len(second.named("destroy"))) == (0, 1)
    second.fail["tick"] = (0, RuntimeError("time-out"))
    with pytest.raises(UserError, match="localhost:2003: cannot make a step"):
        simulator.step(np.array([[0.3, 0.0], [-1.0, 0.0]]))
    assert left_as_found(fake)
    assert second.actors == {}


def test_policies_are_evaluated_in_turns(fake):
    policy = BlackBoxPolicy(lambda seen, rng: np.tile([1.0, 0.6], (len(seen), 1)))
    result = dr.evaluate(policy, LANE, episodes=3)
    assert (result.lengths < 250).all()  # in circles it leaves the road
    assert result.returns.shape == (1, 3)
    assert "by D4RL's references" in str(result)
    assert left_as_found(fake)
    assert len(fake.named("client")) == 1


def test_the_stand_in_has_nothing_that_carla_has_not(fake, monkeypatch):
    monkeypatch.delitem(sys.modules, "carla")
    try:
        real = importlib.import_module("carla")
    except ImportError:
        pytest.skip("CARLA's client package is not installed")
    for theirs, calls in {
        "Client": "set_timeout get_client_version get_server_version get_world generate_opendrive_world load_world "
        "get_trafficmanager apply_batch_sync",
        "World": "get_map get_settings apply_settings get_weather set_weather get_actors get_blueprint_library spawn_actor "
        "try_spawn_actor reset_all_traffic_lights tick",
        "WorldSettings": "synchronous_mode fixed_delta_seconds no_rendering_mode",
        "Map": "to_opendrive get_spawn_points get_waypoint name",
        "Waypoint": "next is_junction lane_id transform",
        "Vehicle": "set_autopilot apply_control get_location get_velocity get_traffic_light id",
        "Sensor": "listen stop id",
        "TrafficLight": "state",
        "TrafficManager": "set_synchronous_mode set_random_device_seed set_global_distance_to_leading_vehicle "
        "global_percentage_speed_difference",
        "Image": "frame width height raw_data",
        "CollisionEvent": "frame",
        "Transform": "location rotation get_forward_vector",
        "ActorBlueprint": "id set_attribute get_attribute",
        "BlueprintLibrary": "find filter",
        "ActorList": "filter",
        "command": "DestroyActor",
        "TrafficLightState": "Red",
    }.items():
        assert [name for name in calls.split() if not hasattr(getattr(real, theirs), name)] == [], theirs
    real.Transform(real.Location(x=1.6, z=1.7), real.Rotation(yaw=1.0))
    real.VehicleControl(throttle=0.5, brake=0.0, steer=-1.0)
    real.WeatherParameters(sun_altitude_angle=90.0)
    real.OpendriveGenerationParameters(wall_height=0.0)
    with pytest.raises(UserError, match="CARLA server localhost:9: cannot reach it: .*time-out of 500ms"):
        registry.task("carla:localhost:9/lane?timeout=0.5").simulate([0])
