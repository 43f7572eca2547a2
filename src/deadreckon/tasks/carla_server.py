"""A CARLA server: its clock, what is put into its world, what its camera and its bumper tell, and how it is left again.

Time stands still there between steps (synchronous mode). Whatever is changed is put back in the order opposite to that in which
it was changed: see `Server.close`.
"""

import contextlib
import importlib
import queue
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from deadreckon.errors import UserError, as_one_line

STEP = 0.05  # s
SIZE, VIEW = 48, 48  # pixels a side, and degrees: D4RL's
CAMERA = {"x": 1.6, "z": 1.7}  # m from the middle of the car
CAR = "vehicle.audi.a2"  # D4RL's
SETTLE = 10  # steps with the brake on in which a car that was set down comes to rest
NOON = 90.0  # degrees, of the sun in D4RL's weather
PARTING = 5.0  # s that each call gets when a server is left, and 1 s where it has not answered before
PATIENCE = 2.0  # s in which cars that another client has removed may still be told

_EXTRA = "install deadreckon[carla], which needs Python 3.11 or 3.12: there is no client package for 3.13"


def client_package() -> Any:
    """CARLA's client package.

    Raises:
        UserError: it is not installed, or not to be loaded here.
    """
    try:
        return importlib.import_module("carla")
    except ImportError as error:
        here = f"{sys.version_info.major}.{sys.version_info.minor}"
        said = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be loaded ({as_one_line(error)})"
        raise UserError(f"CARLA's client package `carla` {said} (this is Python {here}): {_EXTRA}") from error


class Server:
    """One server and the one car that is driven there.

    Args:
        host: name or address.
        port: that it listens to.
        timeout: s that a call may take.

    Attributes:
        where: its name in messages.
        carla: the client package.
        car: that is driven, from `begin` on.
        frame: number of the last step.
    """

    def __init__(self, host: str, port: int, timeout: float):
        self.address, self.timeout = (host, port), timeout
        self.where = f"CARLA server {host}:{port}"
        self.carla: Any = None
        self.client: Any = None
        self.world: Any = None
        self.car: Any = None
        self.frame = 0
        self._undo: list[Callable[[], Any]] = []
        self._sensors: list[Any] = []
        self._actors: list[Any] = []
        self._images: queue.SimpleQueue = queue.SimpleQueue()
        self._bumps: list[Any] = []
        self._begun = 0
        self._traffic: Any = None
        self._silent = False

    @contextlib.contextmanager
    def talking(self, what: str) -> Iterator[None]:
        """Errors of the client become one line that names the server and what was to be done."""
        try:
            yield
        except (RuntimeError, IndexError, OSError) as error:  # time-outs, refused actors and unknown names; unknown blueprints
            self._silent = self._silent or "time-out" in str(error)
            raise UserError(f"{self.where}: cannot {what}: {as_one_line(error)}") from error

    def open(self, load: Callable[["Server"], Any]) -> None:
        """Connects, loads a map, stops the clock.

        Args:
            load: gives the world in which is driven; it may be the one that is there.

        Raises:
            UserError: there is no server, it has another version, or cars are in its world already.
        """
        self.carla = client_package()
        with self.talking("reach it"):
            self.client = self.carla.Client(*self.address)
            self.client.set_timeout(self.timeout)
            versions = self.client.get_client_version(), self.client.get_server_version()
        if _release(versions[0]) != _release(versions[1]):
            raise UserError(f"{self.where} has version {versions[1]}, the client package {versions[0]}: they must be the same")
        with self.talking("look at its world"):
            self.world = self.client.get_world()
            self._refuse_guests()
            settings, weather = self.world.get_settings(), self.world.get_weather()
        # From the last to the first. The world is another object once a map has been loaded.
        self._undo += [
            lambda: self.world.apply_settings(settings),
            lambda: self.world.set_weather(weather),
            self._let_traffic_go,
            self._clear,
        ]
        with self.talking("load its map"):
            self.world = load(self)
        with self.talking("set its clock"):
            own = self.world.get_settings()
            own.synchronous_mode, own.fixed_delta_seconds, own.no_rendering_mode = True, STEP, False
            self.world.apply_settings(own)
            self.world.set_weather(self.carla.WeatherParameters(sun_altitude_angle=NOON))

    def _refuse_guests(self) -> None:
        """Another client's cars would be in the way, and loading a map would take them from it."""
        until = time.monotonic() + PATIENCE
        while found := len(self.world.get_actors().filter("vehicle.*")):
            if time.monotonic() > until:
                what = "another client is at work there, or one was killed: end it, or start the server again"
                raise UserError(f"{self.where}: its world has {found} vehicles already; {what}")
            time.sleep(0.05)

    def traffic(self, seed: int, slower: float) -> int:
        """Begins the traffic manager's draws anew, which steers other cars; gives its port.

        Args:
            seed: of its draws.
            slower: percent below the speed limit that its cars keep.
        """
        port = self.address[1]
        # Its usual port, 8000, for the usual server, and another one for each server beside it.
        port = port + 6000 if port + 6000 < 2**16 else port - 6000
        with self.talking("start its traffic manager"):
            if self._traffic is None:
                self._traffic = self.client.get_trafficmanager(port)
                self._traffic.set_synchronous_mode(True)
                self._traffic.set_global_distance_to_leading_vehicle(2.0)
                self._traffic.global_percentage_speed_difference(slower)
            self._traffic.set_random_device_seed(seed)
        return port

    def _let_traffic_go(self) -> None:
        if self._traffic is not None:
            self._traffic.set_synchronous_mode(False)  # else it waits for steps that nobody makes

    def begin(self, places: Sequence[Any]) -> Any:
        """Sets the car down in the first of these places that is free, with its sensors, in place of an earlier one.

        Returns:
            The place.
        """
        with self.talking("take away the last episode's actors"):
            self._clear()
        blueprints = self.world.get_blueprint_library()
        with self.talking("set the car down"):
            kind = blueprints.find(CAR)
            for place in places:
                if (car := self.world.try_spawn_actor(kind, place)) is not None:
                    self._actors.append(car)
                    self.car = car
                    break
            else:
                raise UserError(f"{self.where}: there is no place for the car")
        self._images, self._bumps = queue.SimpleQueue(), []
        camera = blueprints.find("sensor.camera.rgb")
        for name, value in {"image_size_x": SIZE, "image_size_y": SIZE, "fov": VIEW}.items():
            camera.set_attribute(name, str(value))
        self._sense(camera, self._images.put, **CAMERA)
        self._sense(blueprints.find("sensor.other.collision"), self._bumps.append)
        return place

    def _sense(self, blueprint: Any, take: Callable[[Any], Any], **where: float) -> None:
        carla = self.carla
        with self.talking("attach a sensor"):
            place = carla.Transform(carla.Location(**where), carla.Rotation())
            sensor = self.world.spawn_actor(blueprint, place, attach_to=self.car)
            self._sensors.append(sensor)
            sensor.listen(take)

    def add_cars(self, places: Sequence[Any], count: int, port: int, generator: np.random.Generator) -> None:
        """Sets other cars down, as many of them as find a place, and gives them to the traffic manager at `port`."""
        with self.talking("set other cars down"):
            found = self.world.get_blueprint_library().filter("vehicle.*")
            kinds = [each for each in found if int(each.get_attribute("number_of_wheels")) == 4]
            kinds.sort(key=lambda kind: kind.id)
            for place in places:
                if len(self._actors) > count or not kinds:  # the own car is among them
                    break
                car = self.world.try_spawn_actor(kinds[int(generator.integers(len(kinds)))], place)
                if car is not None:
                    self._actors.append(car)
                    car.set_autopilot(True, port)

    def settle(self) -> np.ndarray:
        """Lets the car come to rest; gives the first picture. Bumps up to here do not count."""
        self.act(-1.0, 0.0)
        for _ in range(SETTLE - 1):
            self._tick()
        picture = self.step()
        self._begun = self.frame
        return picture

    def act(self, pedal: float, wheel: float) -> None:
        """What the car does in the next steps: throttle, or brake where negative, and steering to the right, in ±1."""
        with self.talking("steer the car"):
            control = self.carla.VehicleControl(throttle=max(pedal, 0.0), brake=max(-pedal, 0.0), steer=wheel)
            self.car.apply_control(control)

    def step(self) -> np.ndarray:
        """A step of the world; gives (48, 48, 3) uint8, what the camera sees after it: red, green, blue.

        Raises:
            UserError: the server does not answer, sends no picture of this step, or is stepped by others too.
        """
        self._tick()
        until = time.monotonic() + self.timeout
        while True:
            try:
                image = self._images.get(timeout=max(until - time.monotonic(), 0.0))
            except queue.Empty:
                self._silent = True
                seen = f"no image of step {self.frame} came within {self.timeout:g} s"
                raise UserError(f"{self.where}: {seen}; a server without a renderer (-nullrhi) has no camera") from None
            if image.frame > self.frame:
                seen = f"an image of step {image.frame} came at step {self.frame}"
                raise UserError(f"{self.where}: {seen}; another client makes steps there")
            if image.frame == self.frame:  # those before it come late, which happens
                break
        if (image.height, image.width) != (SIZE, SIZE):
            seen = f"an image has {image.height} x {image.width} pixels"
            raise UserError(f"{self.where}: {seen}, {SIZE} x {SIZE} were asked for")
        blue_first = np.frombuffer(image.raw_data, np.uint8).reshape(SIZE, SIZE, 4)
        return blue_first[:, :, 2::-1].copy()

    def _tick(self) -> None:
        with self.talking("make a step"):
            self.frame = int(self.world.tick(self.timeout))

    @property
    def bumped(self) -> bool:
        """Whether the car has touched anything since `settle`."""
        return any(each.frame > self._begun for each in list(self._bumps))

    def _clear(self) -> None:
        """Removes sensors and cars; they are forgotten only then, so that `close` takes up what was interrupted."""
        if not self._sensors and not self._actors:
            return
        try:
            for sensor in self._sensors:
                sensor.stop()
        finally:
            destroy = self.carla.command.DestroyActor
            self.client.apply_batch_sync([destroy(each.id) for each in (*self._sensors, *self._actors)], False)
        self._sensors, self._actors, self.car = [], [], None
        self.world.tick(self.timeout)  # the server tells of it with its next step

    def close(self) -> None:
        """Removes what was put into the world, and gives back traffic manager, weather and settings, in this order.

        What fails does not keep the rest from being tried: the server may be gone. The map stays.
        """
        self.timeout = min(self.timeout, 1.0 if self._silent else PARTING)
        try:
            if self._undo:
                self.client.set_timeout(self.timeout)
                self._undo.pop()()
        except RuntimeError as error:
            self._silent = self._silent or "time-out" in str(error)
        finally:  # after an interrupt, too
            if self._undo:
                self.close()
        self.world = self.car = self._traffic = None


def _release(version: str) -> str:
    """`0.9.15` of `0.9.15-12-g1a2b3c`."""
    return ".".join(version.split("-")[0].split(".")[:3])
