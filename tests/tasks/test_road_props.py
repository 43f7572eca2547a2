"""What stands and drives on roads, as it is drawn."""

import numpy as np
import pytest

from deadreckon.collect.town import drive
from deadreckon.tasks import road_props, road_scene
from deadreckon.tasks.town import TASK
from deadreckon.tasks.traffic import GREEN, RED, colours

TABLE = TASK.table


def test_the_scene_has_lights_behind_junctions_and_cars_where_they_are_put():
    import mujoco

    network = TABLE.network
    model = mujoco.MjModel.from_xml_string(road_scene.mjcf(network, (48, 48), others=20))
    data = mujoco.MjData(model)
    assert model.nmocap == 21
    assert model.body("car").mocapid[0] == 0
    mujoco.mj_forward(model, data)
    for signal in network.signals:
        lane = (signal.road, -1 if signal.orientation == "+" else 1)
        path = network.lane_path(lane)
        end = path.pose(path.total)
        pole = data.xpos[model.body(f"light_{signal.id}").id][:2] - [end.x, end.y]
        ahead = pole @ [np.cos(end.heading), np.sin(end.heading)]
        left = pole @ [-np.sin(end.heading), np.cos(end.heading)]
        assert 10.0 < ahead < 25.0
        assert left == pytest.approx(-2.75, abs=1e-3)  # half a lane and a metre
        lamps = [data.geom_xpos[model.geom(name).id] for name in road_props.lamp_names(signal.id)]
        assert [lamp[2] for lamp in lamps] == sorted(lamp[2] for lamp in lamps)  # green below, red above
        # On the side from which cars come.
        assert (lamps[0][:2] - [end.x, end.y]) @ [np.cos(end.heading), np.sin(end.heading)] < ahead
    lit = road_props.shades(RED)
    assert lit[RED, 0] > 0.9
    assert lit[GREEN].max() == 1.0  # opaque
    assert lit[GREEN, :3].max() < 0.2


class Drawn:
    """In place of MuJoCo's renderer, which needs OpenGL: keeps what it was asked to show."""

    def __init__(self, model, height, width):
        self.model, self.size = model, (height, width)

    def update_scene(self, data, camera):
        self.place, self.turn, self.camera = data.mocap_pos.copy(), data.mocap_quat.copy(), camera

    def render(self):
        return np.zeros((*self.size, 3), np.uint8)


def test_pictures_show_cars_where_they_are_and_lights_as_they_are(monkeypatch):
    import mujoco

    monkeypatch.setattr(mujoco, "Renderer", Drawn)
    simulator = TASK.simulate([0, 1])
    seen = simulator.reset()
    for _ in range(20):
        seen, *_ = simulator.step(drive(seen))
    camera, picture = simulator.picture(1, (32, 48))
    assert picture.shape == (32, 48, 3)
    drawn = camera._renderer
    x, y, yaw = simulator.cars[1, :3]
    np.testing.assert_allclose(drawn.place[0], [x + 1.6 * np.cos(yaw), y + 1.6 * np.sin(yaw), 1.7])
    x, y, heading = (column[1] for column in simulator.traffic.pose())
    np.testing.assert_allclose(drawn.place[1:, :2], np.stack([x, y], 1))
    np.testing.assert_allclose(np.cos(2 * np.arctan2(drawn.turn[1:, 3], drawn.turn[1:, 0]) - heading), 1.0)
    shown = colours(TABLE, simulator.clock)[1]
    for controller, colour in zip(TABLE.network.controllers, shown):
        lamps = [drawn.model.geom(name).rgba for name in road_props.lamp_names(controller.signals[0])]
        np.testing.assert_allclose(lamps, road_props.shades(colour), atol=1e-6)
    assert simulator.picture(0, (32, 48), camera)[0] is camera
