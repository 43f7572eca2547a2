"""What is driven in a CARLA server, what it pays, and when it ends: a lane of our own, and CARLA's town.

Rewards and ends are those of D4RL's code. Positions there have y to the right of x, ours to the left.
"""

import math
from typing import Any, Protocol

import numpy as np

from deadreckon.tasks.car import off_the_road
from deadreckon.tasks.carla_server import Server
from deadreckon.tasks.driving import LEFT_THE_ROAD, MOST, TASK
from deadreckon.tasks.opendrive_text import to_xodr

ABOVE = 0.3  # m, from which a car is set down
TOWN = "Town01"
OTHERS, SLOWER = 20, 30.0  # cars beside the own one, and percent by which they stay below the limit: D4RL's
DRIVEN = (-1, 1)  # ids of lanes that may be driven on, D4RL's rule; Town01 has no others


class Scene(Protocol):
    """What is driven in one server."""

    def load(self, server: Server) -> Any:
        """The world in which is driven."""
        ...

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """All that is random at the start of an episode."""
        ...

    def begin(self, server: Server, start: np.ndarray) -> None:
        """Puts everything in its place for an episode."""
        ...

    def judge(self, server: Server) -> tuple[float, bool]:
        """What the last step pays, and whether the episode ends with it."""
        ...


class Lane:
    """The right lane of the figure eight, by our own geometry: the road, starts and reward of `carla-lane-state`."""

    def __init__(self):
        self.route, self.width = TASK.route, TASK.width
        self.distance = 0.0

    def load(self, server: Server) -> Any:
        """See `Scene.load`."""
        xodr, carla = to_xodr(self.route.network), server.carla
        if server.world.get_map().to_opendrive().strip() == xodr.strip():
            return server.world
        # Without walls: where the road ends is told by its geometry, for which a wall beside it would be too early.
        return server.client.generate_opendrive_world(xodr, carla.OpendriveGenerationParameters(wall_height=0.0))

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """See `Scene.draw`: distance along the lane, offset and heading."""
        return TASK.start(generator)

    def begin(self, server: Server, start: np.ndarray) -> None:
        """See `Scene.begin`."""
        self.distance, offset, heading = (float(each) for each in start)
        pose, carla = self.route.pose(self.distance), server.carla
        x, y = float(pose.x - offset * np.sin(pose.heading)), float(pose.y + offset * np.cos(pose.heading))
        yaw = -math.degrees(float(pose.heading) + heading)
        server.begin([carla.Transform(carla.Location(x=x, y=-y, z=ABOVE), carla.Rotation(yaw=yaw))])

    def judge(self, server: Server) -> tuple[float, bool]:
        """See `Scene.judge`: clip(v_s - 5 |v_perp|, -5, 5), and -100 for who leaves the road or bumps into something."""
        with server.talking("look where the car is"):
            place, velocity = server.car.get_location(), server.car.get_velocity()
        found = self.route.project(np.array([[place.x, -place.y]]), near=self.distance)
        self.distance, lateral, heading = (float(each[0]) for each in (found.distance, found.lateral, found.heading))
        along = velocity.x * math.cos(heading) - velocity.y * math.sin(heading)
        across = abs(velocity.x * math.sin(heading) + velocity.y * math.cos(heading))
        over = server.bumped or off_the_road(lateral, self.width)
        return float(np.clip(along - 5.0 * across, -MOST, MOST)) - LEFT_THE_ROAD * over, over


class Town:
    """CARLA's Town01 with other cars and its traffic lights. Any way along its lanes is a right one."""

    def __init__(self):
        self._map: Any = None
        self._places: list[Any] = []
        self._before: Any = None  # the place on a lane that was passed last before a junction
        self._since = 0.0  # m from there
        self._last: Any = None  # the place of the car a step ago
        self._crossing = False  # whether that was in a junction
        self._light: Any = None  # that holds for the lane on which the car is

    def load(self, server: Server) -> Any:
        """See `Scene.load`."""
        there = server.world.get_map().name.rpartition("/")[2] == TOWN
        world = server.world if there else server.client.load_world(TOWN)
        self._map = world.get_map()
        self._places = list(self._map.get_spawn_points())
        return world

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """See `Scene.draw`: a number from which places, cars and the traffic manager's draws follow."""
        return generator.integers(0, 2**31, 1)

    def begin(self, server: Server, start: np.ndarray) -> None:
        """See `Scene.begin`."""
        generator = np.random.default_rng(int(start[0]))
        places = [self._places[i] for i in generator.permutation(len(self._places))]
        port = server.traffic(int(start[0]), SLOWER)
        taken = server.begin(places)
        server.add_cars([each for each in places if each is not taken], OTHERS, port, generator)
        with server.talking("restart its lights"):
            server.world.reset_all_traffic_lights()
        self._last, self._light = taken.location, None
        self._crossing, self._before, self._since = True, None, 0.0  # nobody has passed a light before the first step

    def judge(self, server: Server) -> tuple[float, bool]:
        """See `Scene.judge`: the speed along the lane, -100 for who leaves the lanes or bumps into something.

        Who drives into a junction at a red light ends the episode, which costs nothing.
        """
        with server.talking("look where the car is"):
            place, velocity, light = server.car.get_location(), server.car.get_velocity(), server.car.get_traffic_light()
            lane = self._map.get_waypoint(place)
            beside = not lane.is_junction and self._map.get_waypoint(place, project_to_road=False) is None
            ahead = self._followed(lane, place).transform.get_forward_vector()
            entered, self._crossing = lane.is_junction and not self._crossing, lane.is_junction
            red = entered and self._light is not None and self._light.state == server.carla.TrafficLightState.Red
        self._light = None if lane.is_junction else light or self._light
        costs = beside or lane.lane_id not in DRIVEN or server.bumped
        return velocity.x * ahead.x + velocity.y * ahead.y - LEFT_THE_ROAD * costs, costs or red

    def _followed(self, lane: Any, place: Any) -> Any:
        """The place on the lane of the car: in a junction, where lanes cross, on the nearest of those that lead on."""
        moved, self._last = math.hypot(place.x - self._last.x, place.y - self._last.y), place
        if not lane.is_junction:
            self._before, self._since = lane, 0.0
            return lane
        self._since += moved
        ways = [] if self._before is None else self._before.next(max(self._since, 0.1))
        return min(ways, key=lambda way: _apart(way, place), default=lane)


def _apart(way: Any, place: Any) -> float:
    """m between a place on a lane and another one."""
    return math.hypot(way.transform.location.x - place.x, way.transform.location.y - place.y)


SCENES: dict[str, type[Lane] | type[Town]] = {"lane": Lane, "town": Town}
