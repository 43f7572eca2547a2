"""Roads as MuJoCo draws them: asphalt, its marks, grass, traffic lights and other cars, seen from a car.

Nothing in the scene moves or touches by itself: cars are simulated elsewhere, and a picture is told where they are.
"""

from collections.abc import Sequence

import numpy as np

from deadreckon.tasks.copies import bindings
from deadreckon.tasks.road_network import Network
from deadreckon.tasks.road_props import LAMPS, lamp_names, lights, other_cars, shades, stop_lines
from deadreckon.tasks.roads import Road

PLACE = (1.6, 1.7)  # m before the middle of the car and above the ground, where D4RL's camera is
COARSE = ' numslices="10" numstacks="3" numquads="1"'  # parts of round things and boxes, whose number is what drawing takes
VIEW = 48.0  # degrees, of its field of view
SPAN = 1.0  # m of a road between two cross-sections
MARK, DASH = 0.15, 3.0  # m, width of marks, and length of dashes and of the gaps between them
ROAD_HIGH, MARK_HIGH = 0.02, 0.04  # m above the grass, so that what lies above is drawn
COLOURS = {"road": "0.30 0.30 0.32 1", "edge": "0.92 0.92 0.92 1", "middle": "0.95 0.80 0.20 1"}


class Camera:
    """A camera that is put where a car is.

    Args:
        network: that is seen, with its traffic lights.
        size: height and width of pictures in pixels.
        others: how many other cars there are.

    Raises:
        ImportError: MuJoCo finds no OpenGL to draw with.
    """

    def __init__(self, network: Network, size: tuple[int, int], others: int = 0):
        self._mujoco = bindings()
        self._model = self._mujoco.MjModel.from_xml_string(mjcf(network, size, others))
        self._data = self._mujoco.MjData(self._model)
        self._renderer = self._mujoco.Renderer(self._model, *size)
        lamps = [[self._model.geom(name).id for name in lamp_names(signal.id)] for signal in network.signals]
        self._lamps = np.array(lamps, int).reshape(-1, len(LAMPS))

    def picture(
        self, x: float, y: float, heading: float, others: np.ndarray | None = None, shown: Sequence[int] = ()
    ) -> np.ndarray:
        """(height, width, 3) uint8, from a car whose middle is at x and y (m), and whose front points to `heading` (rad).

        Args:
            x: m.
            y: m.
            heading: rad.
            others: (others, 3) x and y (m) and heading (rad) of the other cars.
            shown: what each of the network's lights shows: 0 for green, 1 for yellow, 2 for red.
        """
        ahead, above = PLACE
        self._data.mocap_pos[0] = x + ahead * np.cos(heading), y + ahead * np.sin(heading), above
        self._data.mocap_quat[0] = np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)
        if others is not None:
            self._data.mocap_pos[1:, :2] = others[:, :2]
            self._data.mocap_quat[1:, 0], self._data.mocap_quat[1:, 3] = np.cos(others[:, 2] / 2), np.sin(others[:, 2] / 2)
        for lamps, colour in zip(self._lamps, shown):
            self._model.geom_rgba[lamps] = shades(colour)
        self._mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, "driver")
        return self._renderer.render()

    def close(self) -> None:
        """Gives the OpenGL context back."""
        self._renderer.close()


def mjcf(network: Network, size: tuple[int, int], others: int = 0) -> str:
    """The scene as MuJoCo's XML: a mesh for the asphalt of all roads, one for each colour of marks, lights, and other cars.

    Args:
        network: of roads.
        size: height and width of pictures in pixels.
        others: number of other cars.
    """
    meshes = {"road": [_strip(road, *_sides(road), ROAD_HIGH) for road in network.roads], "edge": [], "middle": []}
    for road in network.roads:
        if road.junction != -1:
            continue  # ways through a junction cross one another, so none has marks
        left, right = _sides(road)
        meshes["edge"] += [_strip(road, left, left - MARK, MARK_HIGH), _strip(road, right + MARK, right, MARK_HIGH)]
        dashes = np.arange(0.0, road.length - DASH, 2 * DASH)
        meshes["middle"] += [_strip(road, MARK / 2, -MARK / 2, MARK_HIGH, s, s + DASH) for s in dashes]
        meshes["edge"] += [_strip(road, *sides, MARK_HIGH, *span) for sides, span in stop_lines(network, road)]
    assets = "\n".join(_mesh(name, strips) for name, strips in meshes.items() if strips)
    geoms = "\n".join(
        f'    <geom type="mesh" mesh="{name}" rgba="{COLOURS[name]}" contype="0" conaffinity="0"/>'
        for name, strips in meshes.items()
        if strips
    )
    return f"""<mujoco model="roads">
  <visual>
    <headlight ambient="0.9 0.9 0.9" diffuse="0.1 0.1 0.1" specular="0 0 0"/>
    <map znear="0.001" zfar="2"/>
    <global offheight="{size[0]}" offwidth="{size[1]}"/>
    <quality shadowsize="0"{COARSE if others else ""}/>
  </visual>
  <statistic extent="150" center="0 0 0"/>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.55 0.70 0.90" rgb2="0.80 0.88 0.95" width="64" height="64"/>
{assets}
  </asset>
  <worldbody>
    <geom type="plane" size="500 500 1000" rgba="0.35 0.50 0.25 1" contype="0" conaffinity="0"/>
{geoms}
{lights(network)}    <body name="car" mocap="true">
      <camera name="driver" mode="fixed" xyaxes="0 -1 0 0 0 1" fovy="{VIEW}"/>
    </body>
{other_cars(others)}  </worldbody>
</mujoco>"""


def _sides(road: Road) -> tuple[float, float]:
    """The left and the right edge of a road, in m to the left of its reference line."""
    return sum(lane.width for lane in road.lanes if lane.id > 0), -sum(lane.width for lane in road.lanes if lane.id < 0)


def _strip(road: Road, left: float, right: float, high: float, start: float = 0.0, end: float | None = None) -> np.ndarray:
    """(sections, 2, 3) the left and the right end of cross-sections of a strip of a road, in m.

    Args:
        road: along which it lies.
        left: m to the left of the reference line, where it begins.
        right: likewise, where it ends.
        high: m above the ground.
        start: m along the road.
        end: likewise; None: its end.
    """
    end = road.length if end is None else end
    s = np.linspace(start, end, max(2, int(np.ceil((end - start) / SPAN)) + 1))
    sides = [road.pose(s, side) for side in (left, right)]
    return np.stack([np.stack([pose.x, pose.y, np.full(len(s), high)], -1) for pose in sides], 1)


def _mesh(name: str, strips: list[np.ndarray]) -> str:
    """Strips as one mesh of triangles that face upwards."""
    points, faces, first = [], [], 0
    for strip in strips:
        points.append(strip.reshape(-1, 3))
        at = first + 2 * np.arange(len(strip) - 1)[:, None]
        faces += [at + np.array(corners) for corners in ((0, 1, 2), (1, 3, 2))]
        first += 2 * len(strip)
    vertices = " ".join(f"{number:.4f}" for number in np.concatenate(points).ravel())
    triangles = " ".join(map(str, np.concatenate(faces).ravel()))
    return f'    <mesh name="{name}" inertia="shell" vertex="{vertices}" face="{triangles}"/>'
