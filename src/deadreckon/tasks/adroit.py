"""Adroit: a hand with 24 joints turns a pen, hammers a nail, opens a door or moves a ball (thesis 7.3; Rajeswaran et al. 2018).

Bodies and physics are gymnasium-robotics' `AdroitHand*-v1`; rewards, ends and time limits are D4RL's, whose reference scores
the tasks have. What differs between the two is written down in the docs (`tasks/adroit.md`).
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.copies import MujocoCopies, load_model
from deadreckon.tasks.task import Reference, Task
from deadreckon.versions import installed

FRAME_SKIP = 5
_ROOM = np.finfo(np.float64).eps * 4.0  # what counts as zero: below it, two of Euler's angles cannot be told apart


class Scene(NamedTuple):
    """What is measured of `n` copies. As in MuJoCo, places and turns are those at the beginning of the last physics step.

    Attributes:
        positions, velocities: (n, joints) of the hand and of what it handles.
        sites: (n, sites, 3) places of `Adroit.sites`, m.
        thing: (n, 3) place of the body `Adroit.thing`, m; zeros without one.
        turn: (n, 3, 3) its rotation.
        touch: (n,) what the sensor `Adroit.sensor` says, zeros without one.
    """

    positions: np.ndarray
    velocities: np.ndarray
    sites: np.ndarray
    thing: np.ndarray
    turn: np.ndarray
    touch: np.ndarray


@dataclass(frozen=True)
class Adroit(Task):
    """An Adroit task. Actions in ±1 are joint positions between their bounds, which position controllers steer to.

    Attributes:
        xml: the hand and its scene, among gymnasium-robotics' assets.
        sites: whose places are measured.
        thing: the body that is handled, whose place and turn are measured; empty for none.
        sensor: that is read; empty for none.
        moved: (array of the model, name of the body or site) of what an episode puts elsewhere.
        draw: a generator to the new rows of `moved`, given the old.
        observe: (n, size) observations.
        reward: (n,) rewards of the steps that led to a scene.
        achieved: (n,) bool, whether the goal is reached.
        dropped: (n,) bool, whether a state is terminal; None: none is.
        enough: an episode is a success if the goal is reached in more than so many steps (D4RL's `evaluate_success`).
    """

    revision: ClassVar[int] = 1

    xml: str = ""
    sites: tuple[str, ...] = ()
    thing: str = "Object"
    sensor: str = ""
    moved: tuple[tuple[str, str], ...] = ()
    draw: Callable[[np.random.Generator, list[np.ndarray]], list[np.ndarray]] = lambda generator, old: old
    observe: Callable[[Scene], np.ndarray] = lambda scene: scene.positions
    reward: Callable[[Scene], np.ndarray] = lambda scene: np.zeros(len(scene.positions))
    achieved: Callable[[Scene], np.ndarray] = lambda scene: np.zeros(len(scene.positions), bool)
    dropped: Callable[[Scene], np.ndarray] | None = None
    enough: int = 25

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "AdroitSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return AdroitSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of the package that the hand is from."""
        return installed("gymnasium-robotics")


class AdroitSimulator(MujocoCopies[Adroit]):
    """Copies of one environment; see `MujocoCopies`.

    Copy `i` does what gymnasium-robotics' environment does after `reset(seed=seeds[i])`, episode after episode.
    """

    def __init__(self, task: Adroit, seeds: Sequence[int], threads: int | None = None):
        model = hand(task.xml)
        self._rows = [(field, _id(model, field, name)) for field, name in task.moved]
        self._old = [getattr(model, field)[row].copy() for field, row in self._rows]
        self._sizes = np.cumsum([len(old) for old in self._old])
        super().__init__(task, model, seeds, threads, frame_skip=FRAME_SKIP)
        self._sites = [model.site(name).id for name in task.sites]
        self._thing = model.body(task.thing).id if task.thing else None
        self._sensor = model.sensor(task.sensor).id if task.sensor else None
        self._middle = model.actuator_ctrlrange.mean(1)
        self._range = 0.5 * np.diff(model.actuator_ctrlrange, axis=1)[:, 0]
        self._layout = np.zeros((len(seeds), self._sizes[-1]))  # where each copy's episode has put what is moved
        self._seen = np.zeros((len(seeds), 3 * len(self._sites) + 3 + 9 + 1))

    @property
    def achieved(self) -> np.ndarray:
        """(copies,) bool, whether each copy's goal is reached."""
        return self.task.achieved(self._scene(slice(None)))

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "layout": self._layout.copy(), "seen": self._seen.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self._layout[:], self._seen[:] = state["layout"], state["seen"]

    def _own(self, model: Any) -> Any:
        return copy.copy(model)  # each episode writes into its thread's

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        return np.concatenate(self.task.draw(generator, self._old))

    def _begin(self, data: Any, copy: int, start: np.ndarray) -> None:
        self._layout[copy], posture = np.split(start, [self._sizes[-1]])
        if len(posture):
            super()._begin(data, copy, posture)

    def _settle(self, model: Any, copy: int) -> None:
        for (field, row), part in zip(self._rows, np.split(self._layout[copy], self._sizes[:-1])):
            getattr(model, field)[row] = part

    def _control(self, data: Any, copy: int, action: np.ndarray) -> None:
        data.ctrl[:] = self._middle + np.clip(action, -1.0, 1.0) * self._range

    def _measure(self, data: Any, copy: int) -> None:
        seen, sites = self._seen[copy], 3 * len(self._sites)
        seen[:sites] = data.site_xpos[self._sites].ravel()
        if self._thing is not None:
            seen[sites : sites + 3], seen[sites + 3 : sites + 12] = data.xpos[self._thing], data.xmat[self._thing]
        if self._sensor is not None:
            seen[-1] = data.sensordata[self._sensor]

    def _scene(self, which: Any) -> Scene:
        moving, seen = self._moving[which], self._seen[which]
        sites, joints = 3 * len(self._sites), self._model.nq
        return Scene(
            moving[:, :joints], moving[:, joints:], seen[:, :sites].reshape(len(seen), -1, 3), seen[:, sites : sites + 3],
            seen[:, sites + 3 : sites + 12].reshape(-1, 3, 3), seen[:, -1],
        )  # fmt: skip

    def _observe(self, which: Any) -> np.ndarray:
        return self.task.observe(self._scene(which)).astype(np.float32)

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scene = self._scene(slice(None))
        over = np.zeros(len(actions), bool) if self.task.dropped is None else self.task.dropped(scene)
        return self.task.reward(scene), over


@lru_cache
def hand(xml: str) -> Any:
    """The compiled model of a scene, with the weaker motors that the environments give the wrist and the fingers."""
    model = copy.copy(load_model("gymnasium_robotics", f"envs/assets/adroit_hand/{xml}"))
    for first, last, gain in (("A_WRJ1", "A_WRJ0", 10.0), ("A_FFJ3", "A_THJ0", 1.0)):
        motors = slice(model.actuator(first).id, model.actuator(last).id + 1)
        model.actuator_gainprm[motors, :3] = gain, 0.0, 0.0
        model.actuator_biasprm[motors, :3] = 0.0, -gain, 0.0
    return model


def _id(model: Any, field: str, name: str) -> int:
    return (model.site if field.startswith("site") else model.body)(name).id


# ---- the door: handle and palm ------------------------------------------------------------------------------------------


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=1)


def _within(generator: np.random.Generator, *bounds: tuple[float, float]) -> list[float]:
    return [generator.uniform(low, high) for low, high in bounds]


def _draw_door(generator: np.random.Generator, old: list[np.ndarray]) -> list[np.ndarray]:
    return [np.array(_within(generator, (-0.3, -0.2), (0.25, 0.35), (0.252, 0.35)))]


def _see_door(scene: Scene) -> np.ndarray:
    hinge, latch = scene.positions[:, -2:].T
    palm, handle = scene.sites[:, 0], scene.sites[:, 1]
    is_open = np.where(hinge > 1.0, 1.0, -1.0)
    return np.column_stack([scene.positions[:, 1:-2], latch, hinge, palm, handle, palm - handle, is_open])


def _pay_door(scene: Scene) -> np.ndarray:
    hinge = scene.positions[:, -2]
    shaped = -0.1 * _distance(scene.sites[:, 0], scene.sites[:, 1]) - 0.1 * (hinge - 1.57) ** 2
    shaped -= 1e-5 * np.square(scene.velocities).sum(1)
    return shaped + 2.0 * (hinge > 0.2) + 8.0 * (hinge > 1.0) + 10.0 * (hinge > 1.35)


def _door_is_open(scene: Scene) -> np.ndarray:
    return scene.positions[:, -2] >= 1.35


# ---- the hammer: palm, tool, nail and where the nail belongs --------------------------------------------------------------


def _draw_board(generator: np.random.Generator, old: list[np.ndarray]) -> list[np.ndarray]:
    return [np.append(old[0][:2], _within(generator, (0.1, 0.25)))]


def _angles(turn: np.ndarray) -> np.ndarray:
    """(n, 3) Euler angles of rotations (n, 3, 3): about x, then the new y, then the new z."""
    flat = np.hypot(turn[:, 2, 2], turn[:, 1, 2])
    clear = flat > _ROOM
    x = np.where(clear, -np.arctan2(turn[:, 1, 2], turn[:, 2, 2]), 0.0)
    z = np.where(clear, -np.arctan2(turn[:, 0, 1], turn[:, 0, 0]), -np.arctan2(-turn[:, 1, 0], turn[:, 1, 1]))
    return np.column_stack([x, -np.arctan2(-turn[:, 0, 2], flat), z])


def _see_hammer(scene: Scene) -> np.ndarray:
    palm, nail = scene.sites[:, 0], scene.sites[:, 2]
    moving, impact = np.clip(scene.velocities[:, -6:], -1.0, 1.0), np.clip(scene.touch, -1.0, 1.0)
    return np.column_stack([scene.positions[:, :-6], moving, palm, scene.thing, _angles(scene.turn), nail, impact])


def _pay_hammer(scene: Scene) -> np.ndarray:
    palm, tool, nail, goal = np.moveaxis(scene.sites, 1, 0)
    left = _distance(nail, goal)
    shaped = -0.1 * _distance(palm, scene.thing) - _distance(tool, nail) - 10.0 * left
    shaped -= 1e-2 * np.linalg.norm(scene.velocities, axis=1)
    lifted = (scene.thing[:, 2] > 0.04) & (tool[:, 2] > 0.04)
    return shaped + 2.0 * lifted + 25.0 * (left < 0.02) + 75.0 * (left < 0.01)


def _nail_is_in(scene: Scene) -> np.ndarray:
    return _distance(scene.sites[:, 2], scene.sites[:, 3]) < 0.01


# ---- the pen: where it should be, its ends, and the ends of the one that shows how it should lie ---------------------------


def _draw_pen(generator: np.random.Generator, old: list[np.ndarray]) -> list[np.ndarray]:
    about_x, about_y = 0.5 * generator.uniform(-1.0, 1.0), 0.5 * generator.uniform(-1.0, 1.0)
    x, y = (np.cos(about_x), np.sin(about_x)), (np.cos(about_y), np.sin(about_y))
    return [np.array([x[0] * y[0], x[1] * y[0], x[0] * y[1], x[1] * y[1]])]


def _directions(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) unit vectors along the pen and along its target."""
    ends = scene.sites[:, 1:]
    along = ends[:, ::2] - ends[:, 1::2]
    lengths = np.linalg.norm(along, axis=2, keepdims=True)  # of copies that have not begun yet, 0
    pen, target = np.moveaxis(along / np.maximum(lengths, _ROOM), 1, 0)
    return pen, target


def _see_pen(scene: Scene) -> np.ndarray:
    pen, target = _directions(scene)
    away = scene.thing - scene.sites[:, 0]
    return np.column_stack([
        scene.positions[:, :-6], scene.thing, scene.velocities[:, -6:], pen, target, away, pen - target,
    ])  # fmt: skip


def _pen_off(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the pen from where it should be, and cosine between it and its target."""
    pen, target = _directions(scene)
    return _distance(scene.thing, scene.sites[:, 0]), (pen * target).sum(1)


def _pay_pen(scene: Scene) -> np.ndarray:
    away, alike = _pen_off(scene)
    near = away < 0.075
    return alike - away + 10.0 * (near & (alike > 0.9)) + 50.0 * (near & (alike > 0.95)) - 5.0 * _pen_fell(scene)


def _pen_lies_right(scene: Scene) -> np.ndarray:
    away, alike = _pen_off(scene)
    return (away < 0.075) & (alike > 0.95)


def _pen_fell(scene: Scene) -> np.ndarray:
    return scene.thing[:, 2] < 0.075


# ---- the ball: palm and target ------------------------------------------------------------------------------------------


def _draw_ball(generator: np.random.Generator, old: list[np.ndarray]) -> list[np.ndarray]:
    ball = np.append(_within(generator, (-0.15, 0.15), (-0.15, 0.3)), old[0][2])
    return [ball, np.array(_within(generator, (-0.2, 0.2), (-0.2, 0.2), (0.15, 0.35)))]


def _see_ball(scene: Scene) -> np.ndarray:
    palm, target, ball = scene.sites[:, 0], scene.sites[:, 1], scene.thing
    return np.column_stack([scene.positions[:, :-6], palm - ball, palm - target, ball - target])


def _pay_ball(scene: Scene) -> np.ndarray:
    palm, target, ball = scene.sites[:, 0], scene.sites[:, 1], scene.thing
    left = _distance(ball, target)
    lifted = ball[:, 2] > 0.04
    carried = lifted * (1.0 - 0.5 * _distance(palm, target) - 0.5 * left)
    return -0.1 * _distance(palm, ball) + carried + 10.0 * (left < 0.1) + 20.0 * (left < 0.05)


def _ball_is_there(scene: Scene) -> np.ndarray:
    return _distance(scene.thing, scene.sites[:, 1]) < 0.1


# ---- the tasks ----------------------------------------------------------------------------------------------------------

# D4RL's returns of uniform actions, and of the policies that DAPG fine-tuned. They define the scores here too.
_PUBLISHED = {
    "pen": (96.262799, 3076.8331017826877),
    "hammer": (-274.856578, 12794.134825156867),
    "door": (-56.512833, 2880.5693087298737),
    "relocate": (-6.425911, 4233.877797728884),
}


def _make(name: str, size: int, actions: int, split: str, summary: str, **fields: Any) -> Adroit:
    published = Reference(*_PUBLISHED[name], "D4RL")
    return Adroit(
        name=name, domain="adroit", horizon=100 if name == "pen" else 200, observation_shape=(size,), split=split,
        action_space=Box((-1.0,) * actions, (1.0,) * actions), gym_id=f"deadreckon/Adroit{name.title()}-v1",
        reference=published, published=published, summary=summary, xml=f"adroit_{name}.xml",
        properties=("non-representable policies", "narrow data", "sparse rewards", "realistic", "high-dimensional"), **fields,
    )  # fmt: skip


TASKS = (
    _make("pen", 45, 24, "training", "turn a pen in the hand until it lies as shown; a dropped pen ends the episode",
          sites=("eps_ball", "object_top", "object_bottom", "target_top", "target_bottom"), moved=(("body_quat", "target"),),
          draw=_draw_pen, observe=_see_pen, reward=_pay_pen, achieved=_pen_lies_right, dropped=_pen_fell, enough=20),
    _make("hammer", 46, 26, "evaluation", "grasp a hammer and drive a nail into a board", sensor="S_nail",
          sites=("S_grasp", "tool", "S_target", "nail_goal"), moved=(("body_pos", "nail_board"),),
          draw=_draw_board, observe=_see_hammer, reward=_pay_hammer, achieved=_nail_is_in),
    _make("door", 39, 28, "training", "undo the latch of a door and swing it open", sites=("S_grasp", "S_handle"), thing="",
          moved=(("body_pos", "frame"),), draw=_draw_door, observe=_see_door, reward=_pay_door, achieved=_door_is_open),
    _make("relocate", 39, 30, "evaluation", "grasp a ball and carry it to a place in the air", sites=("S_grasp", "target"),
          moved=(("body_pos", "Object"), ("site_pos", "target")),
          draw=_draw_ball, observe=_see_ball, reward=_pay_ball, achieved=_ball_is_there),
)  # fmt: skip
