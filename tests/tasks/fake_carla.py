"""A stand-in for CARLA's client package: it records what is called, in order, and moves one car in the simplest way.

Use `Fake(...)` as the module `carla`. A test checks that the real package, where it is installed, has what is called.
"""

import math
import types

import numpy as np


class Vector:
    def __init__(self, x=0.0, y=0.0, z=0.0):
        self.x, self.y, self.z = x, y, z


class Rotation:
    def __init__(self, pitch=0.0, yaw=0.0, roll=0.0):
        self.pitch, self.yaw, self.roll = pitch, yaw, roll


class Transform:
    def __init__(self, location=None, rotation=None):
        self.location, self.rotation = location or Vector(), rotation or Rotation()

    def get_forward_vector(self):
        return Vector(math.cos(math.radians(self.rotation.yaw)), math.sin(math.radians(self.rotation.yaw)))


class Settings:
    def __init__(self, synchronous_mode=False, fixed_delta_seconds=None, no_rendering_mode=False):
        self.synchronous_mode, self.fixed_delta_seconds = synchronous_mode, fixed_delta_seconds
        self.no_rendering_mode = no_rendering_mode


class Blueprint:
    def __init__(self, id, wheels=4):
        self.id, self.attributes = id, {"number_of_wheels": str(wheels)}

    def set_attribute(self, name, value):
        assert isinstance(value, str)
        self.attributes[name] = value

    def get_attribute(self, name):
        return self.attributes[name]


class Blueprints(list):
    def find(self, id):
        for each in self:
            if each.id == id:
                return each
        raise IndexError(f"blueprint '{id}' not found")

    def filter(self, pattern):
        return Blueprints(each for each in self if each.id.startswith(pattern.rstrip("*")))


class Actors(list):
    def filter(self, pattern):
        return Actors(each for each in self if each.type_id.startswith(pattern.rstrip("*")))


class Actor:
    """A car or a sensor. A car drives at `throttle` times 10 m/s in the direction that it has, and turns by its steering."""

    def __init__(self, fake, blueprint, place, parent):
        self.fake, self.type_id, self.parent = fake, blueprint.id, parent
        self.attributes = dict(blueprint.attributes)
        self.place = Transform(Vector(**vars(place.location)), Rotation(**vars(place.rotation)))
        self.id = next(fake.ids)
        self.take = self.control = self.light = None
        self.speed, self.port = 0.0, None

    def listen(self, take):
        self.fake.call("listen", self.type_id)
        self.take = take

    def stop(self):
        self.fake.call("stop", self.type_id)
        self.take = None

    def set_autopilot(self, on, port):
        self.port = port

    def apply_control(self, control):
        self.fake.call("control", (control.throttle, control.brake, control.steer))
        self.control = control

    def get_location(self):
        return self.place.location

    def get_velocity(self):
        ahead = self.place.get_forward_vector()
        return Vector(self.speed * ahead.x, self.speed * ahead.y)

    def get_traffic_light(self):
        return self.light

    def move(self):
        if self.control is None:
            return
        self.speed = 0.0 if self.control.brake else 10.0 * self.control.throttle
        self.place.rotation.yaw += 10.0 * self.control.steer
        ahead = self.place.get_forward_vector()
        self.place.location.x += 0.05 * self.speed * ahead.x
        self.place.location.y += 0.05 * self.speed * ahead.y


class Waypoint:
    def __init__(self, x, y, lane_id=-1, is_junction=False, yaw=0.0, ways=()):
        self.transform = Transform(Vector(x, y), Rotation(yaw=yaw))
        self.lane_id, self.is_junction, self.ways = lane_id, is_junction, ways

    def next(self, distance):
        x, y = self.transform.location.x, self.transform.location.y
        turned = [(math.cos(math.radians(yaw)), math.sin(math.radians(yaw)), yaw) for yaw in self.ways]
        return [Waypoint(x + distance * cos, y + distance * sin, -1, True, yaw) for cos, sin, yaw in turned]


class Map:
    """A street along x, 4 m wide either side of y = 0, a junction from x = 20 to 30, and places each 4 m."""

    def __init__(self, fake, name="Carla/Maps/Town10HD", xodr=""):
        self.fake, self.name, self.xodr = fake, name, xodr

    def to_opendrive(self):
        return self.xodr

    def get_spawn_points(self):
        return [Transform(Vector(4.0 * i, 0.0, 0.0)) for i in range(-30, 4)]

    def get_waypoint(self, place, project_to_road=True):
        inside = 20.0 <= place.x <= 30.0
        if not project_to_road and (abs(place.y) > 4.0 or inside):
            return None
        lane = self.fake.lane_id
        return Waypoint(place.x, 0.0, lane, inside, 180.0 if inside else 0.0, ways=(-90.0, 0.0))


class World:
    def __init__(self, fake, map):
        self.fake, self.map, self.settings, self.weather = fake, map, Settings(), "clouds"

    def get_map(self):
        return self.map

    def get_settings(self):
        return Settings(**vars(self.settings))

    def apply_settings(self, settings):
        self.fake.call("settings", (settings.synchronous_mode, settings.fixed_delta_seconds))
        self.settings = settings

    def get_weather(self):
        return self.weather

    def set_weather(self, weather):
        self.fake.call("weather", weather)
        self.weather = weather

    def get_actors(self):
        return Actors(self.fake.actors.values())

    def get_blueprint_library(self):
        kinds = [("vehicle.audi.a2", 4), ("vehicle.yamaha.yzf", 2), ("sensor.camera.rgb", 0), ("sensor.other.collision", 0)]
        return Blueprints(Blueprint(id, wheels) for id, wheels in kinds)

    def spawn_actor(self, blueprint, place, attach_to=None):
        self.fake.call("spawn", blueprint.id)
        made = Actor(self.fake, blueprint, place, attach_to)
        self.fake.actors[made.id] = made
        return made

    def try_spawn_actor(self, blueprint, place):
        others = self.get_actors().filter("vehicle.*")
        near = [
            math.dist((each.place.location.x, each.place.location.y), (place.location.x, place.location.y)) for each in others
        ]
        if self.fake.full or min(near, default=9.0) < 1.0:
            return None
        return self.spawn_actor(blueprint, place)

    def reset_all_traffic_lights(self):
        self.fake.call("lights")

    def tick(self, seconds):
        self.fake.frame += 1
        self.fake.call("tick")
        for each in list(self.fake.actors.values()):
            each.move()
        self.fake.on_tick(self.fake)
        self.fake.send()
        return self.fake.frame


class Client:
    def __init__(self, fake, host, port):
        self.fake = fake
        fake.call("client", (host, port))

    def set_timeout(self, seconds):
        self.fake.timeout = seconds

    def get_client_version(self):
        return self.fake.versions[0]

    def get_server_version(self):
        self.fake.call("version")
        return self.fake.versions[1]

    def get_world(self):
        return self.fake.world

    def generate_opendrive_world(self, xodr, parameters):
        self.fake.call("generate", parameters)
        self.fake.world = World(self.fake, Map(self.fake, "OpenDriveMap", xodr))
        return self.fake.world

    def load_world(self, name):
        self.fake.call("load", name)
        self.fake.world = World(self.fake, Map(self.fake, f"Carla/Maps/{name}"))
        return self.fake.world

    def get_trafficmanager(self, port):
        self.fake.call("manager", port)
        return Manager(self.fake)

    def apply_batch_sync(self, commands, tick):
        self.fake.call("destroy", [self.fake.actors[id].type_id for id in commands])
        for id in commands:
            del self.fake.actors[id]


class Manager:
    def __init__(self, fake):
        self.fake = fake

    def set_synchronous_mode(self, on):
        self.fake.call("manager synchronous", on)

    def set_global_distance_to_leading_vehicle(self, distance):
        pass

    def global_percentage_speed_difference(self, percent):
        self.fake.call("slower", percent)

    def set_random_device_seed(self, seed):
        self.fake.call("manager seed", seed)


class Fake(types.ModuleType):
    """The module, its one server, and what tests change in it.

    Attributes:
        calls: (what, with what) in order.
        fail: {what: (calls that are let pass, the error that those behind them raise)}.
        late: steps by which pictures come late at first: each step sends the picture of that many steps ago before its own.
        silent: whether no pictures come.
        on_tick: called with each step.
    """

    def __init__(self, versions=("0.9.15", "0.9.15-3-gabc")):
        super().__init__("carla")
        self.versions, self.calls, self.actors, self.frame, self.timeout = versions, [], {}, 100, None
        self.ids = iter(range(1, 10**6))
        self.fail, self.late, self.silent, self.ahead, self.full, self.lane_id = {}, 0, False, 0, False, -1
        self.size = 48
        self.on_tick = lambda fake: None
        self.world = self.first = World(self, Map(self))
        self.Location, self.Transform, self.Rotation = Vector, Transform, Rotation
        self.OpendriveGenerationParameters = lambda **given: given
        self.WeatherParameters = lambda **given: given
        self.VehicleControl = lambda **given: types.SimpleNamespace(**given)
        self.command = types.SimpleNamespace(DestroyActor=lambda id: id)
        self.TrafficLightState = types.SimpleNamespace(Red="red", Green="green")
        self.Client = lambda host, port: Client(self, host, port)

    def call(self, what, given=None):
        self.calls.append((what, given))
        if what in self.fail:
            after, error = self.fail[what]
            if after:
                self.fail[what] = after - 1, error
            else:
                if isinstance(error, KeyboardInterrupt):
                    del self.fail[what]  # which comes once
                raise error

    def named(self, what):
        return [given for name, given in self.calls if name == what]

    def order(self):
        return [name for name, _ in self.calls]

    @property
    def car(self):
        return next(each for each in self.actors.values() if each.port is None and each.type_id.startswith("vehicle"))

    def send(self):
        for sensor in list(self.actors.values()):
            if sensor.type_id == "sensor.camera.rgb" and sensor.take is not None and not self.silent:
                for frame in [self.frame - self.late, self.frame + self.ahead] if self.late else [self.frame + self.ahead]:
                    sensor.take(picture(frame, self.size))

    def bump(self):
        for sensor in self.actors.values():
            if sensor.type_id == "sensor.other.collision" and sensor.take is not None:
                sensor.take(types.SimpleNamespace(frame=self.frame))


def picture(frame, size=48):
    """Blue is the column, green the row, red the frame's number, alpha 255."""
    data = np.empty((size, size, 4), np.uint8)
    data[..., 0], data[..., 1] = np.arange(size), np.arange(size)[:, None]
    data[..., 2], data[..., 3] = frame % 256, 255
    return types.SimpleNamespace(frame=frame, width=size, height=size, raw_data=data.tobytes())
