"""What demonstrates the kitchen's errands: waypoints for the hand, and the joint speeds that lead there."""

import importlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from deadreckon.tasks.kitchen import SPEED, Kitchen, kitchen

KNOWN = ("microwave", "kettle", "bottom burner", "top burner", "light switch", "slide cabinet")  # what the demonstrator can do
SHAKE = 0.008  # standard deviation of a waypoint's place, m
HASTE = (0.7, 1.0)  # m/s of the hand at most, drawn once per episode
MOST = 0.9  # of an action: at the bounds themselves, policies that are squashed by a tanh have nothing to say
_ARM = 7  # joints without the fingers
_MARGIN = 0.03  # rad before a joint's limit at which it is no longer driven on


class Waypoint(NamedTuple):
    """Where the hand goes: x, y, z in m, whether the fingers are open, how the hand is rolled (rad), and steps at most."""

    place: tuple[float, float, float]
    open: bool = False
    roll: float = 0.0
    steps: int = 12


def _door(angle: float) -> tuple[float, float, float]:
    """Where the microwave's handle is when its door is open by this angle."""
    return -1.128 + 0.487 * np.cos(0.078 - angle), 0.455 + 0.487 * np.sin(0.078 - angle), 1.80


def _knob(height: float) -> list[Waypoint]:
    near, at = (-0.256, 0.50, height), (-0.256, 0.61, height)
    return [
        Waypoint(near, True), Waypoint(at, True, steps=16), Waypoint(at), Waypoint(at, False, 0.5), Waypoint(at, False, 1.3),
        Waypoint(at, True, 0.8), Waypoint((-0.256, 0.42, height), True),
    ]  # fmt: skip


# The last waypoint of each takes the hand away from the thing; it is headed for as soon as the sub-task is done.
PLANS: dict[str, list[Waypoint]] = {
    "microwave": [
        Waypoint((-0.62, 0.30, 1.80), True, steps=20), Waypoint((-0.642, 0.49, 1.80), True, steps=16), Waypoint(_door(0.0)),
        Waypoint(_door(0.3)), Waypoint(_door(0.6)), Waypoint(_door(0.8)), Waypoint((-0.62, 0.03, 1.88), True, steps=16),
    ],
    # The hand goes under the handle, and its palm pushes.
    "kettle": [
        Waypoint((-0.27, 0.06, 1.85), steps=20), Waypoint((-0.27, 0.75, 1.83), steps=50),
        Waypoint((-0.27, 0.30, 1.95), steps=25),
    ],
    "bottom burner": _knob(2.226),
    "top burner": _knob(2.34),
    # Rolled, the hand fits between knobs and switch.
    "light switch": [
        Waypoint((-0.32, 0.45, 2.29), roll=1.57, steps=20), Waypoint((-0.32, 0.60, 2.29), roll=1.57, steps=16),
        Waypoint((-0.57, 0.61, 2.32), roll=1.57, steps=25), Waypoint((-0.40, 0.35, 2.35), steps=20),
    ],
    "slide cabinet": [
        Waypoint((-0.25, 0.40, 2.50), steps=25), Waypoint((-0.22, 0.50, 2.57), steps=16),
        Waypoint((-0.22, 0.60, 2.55), steps=16), Waypoint((0.10, 0.60, 2.57), steps=20), Waypoint((0.0, 0.42, 2.45)),
    ],
}  # fmt: skip


class Demonstrator:
    """Leads the arms of several copies, each through a list of sub-tasks."""

    def __init__(self, copies: int):
        mujoco: Any = importlib.import_module("mujoco")
        self._mujoco, self._model = mujoco, kitchen()
        self._data = mujoco.MjData(self._model)
        self._site = self._model.site("end_effector").id
        self._hand = self._model.body("panda0_link7").id
        self._jacobian = np.zeros((6, self._model.nv))
        self._low, self._high = self._model.jnt_range[:_ARM].T + np.array([[_MARGIN], [-_MARGIN]])
        self._rest = np.array([0.148, -1.6, 1.844, -2.477, 0.260, 0.713, 1.595])  # where the arm is drawn when it has a choice
        self._axes: np.ndarray | None = None  # the hand's own forward and sideways, (2, 3)
        self._todo: list[list[str]] = [[] for _ in range(copies)]
        self._plan: list[list[Waypoint]] = [[] for _ in range(copies)]
        self._age = np.zeros(copies, int)  # steps towards the waypoint
        self._lag = np.zeros((copies, 3))  # how far beyond the waypoint one must aim to get there
        self._speed = np.zeros(copies)
        self._generators = [np.random.default_rng(0)] * copies

    def begin(self, copy: int, elements: Sequence[str], generator: np.random.Generator) -> None:
        """Gives a copy its sub-tasks, in this order; the generator shakes its hand."""
        self._todo[copy], self._generators[copy] = list(elements), generator
        self._plan[copy], self._age[copy], self._lag[copy] = [], 0, 0.0
        self._speed[copy] = generator.uniform(*HASTE)

    def finished(self, copy: int) -> bool:
        """Whether a copy has gone through its list, with success or without."""
        return not self._todo[copy] and not self._plan[copy]

    def act(self, copy: int, posture: np.ndarray, task: Kitchen) -> np.ndarray:
        """(9,) the next action of a copy, whose posture (30,) is seen."""
        place, axes = self._look(posture)
        self._go_on(copy, posture, place, axes[1], task)
        if not self._plan[copy]:
            return np.zeros(9, np.float32)
        goal = self._plan[copy][0]
        away = np.array(goal.place) - place
        # The arm is steered from where it is, so weight and resistance hold it back: what it lacks is added up.
        self._lag[copy] = np.clip(self._lag[copy] + 0.25 * np.clip(away, -0.05, 0.05), -0.12, 0.12)
        wanted = np.stack([[0.0, 1.0, 0.0], _sideways(goal.roll)])
        moving = _at_most(10.0 * (away + self._lag[copy]), self._speed[copy])
        turning = _at_most(6.0 * np.cross(axes, wanted).sum(0), 2.0)
        speeds = self._joint_speeds(posture[:_ARM], moving, turning)
        fingers = MOST if goal.open else -MOST
        return np.append(MOST * speeds / max(MOST * SPEED, np.abs(speeds).max()), [fingers, fingers]).astype(np.float32)

    def _look(self, posture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place of the hand (3,), and its forward and sideways directions (2, 3); the Jacobian is kept."""
        mujoco, data = self._mujoco, self._data
        data.qpos[:] = posture
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:], self._site)
        place, turn = data.site_xpos[self._site].copy(), data.xmat[self._hand].reshape(3, 3)
        if self._axes is None:
            forward = place - data.xpos[self._hand]
            forward /= np.linalg.norm(forward)
            sideways = data.body("panda0_leftfinger").xpos - data.body("panda0_rightfinger").xpos
            sideways = sideways - forward * (forward @ sideways)
            self._axes = np.stack([forward, sideways / np.linalg.norm(sideways)]) @ turn
        return place, self._axes @ turn.T

    def _go_on(self, copy: int, posture: np.ndarray, place: np.ndarray, sideways: np.ndarray, task: Kitchen) -> None:
        """The next waypoint, or sub-task, where the present one is reached, given up or done."""
        plan = self._plan[copy]
        self._age[copy] += 1
        if plan:
            done = len(plan) > 1 and bool(task.done(posture[None], self._todo[copy][:1])[0, 0])
            there = np.linalg.norm(np.array(plan[0].place) - place) < 0.03 and sideways @ _sideways(plan[0].roll) > 0.96
            if done:
                del plan[:-1]
                self._arrive(copy)
            elif (there and self._age[copy] > 4) or self._age[copy] > plan[0].steps:
                del plan[0]
                self._arrive(copy)
            if plan:
                return
            del self._todo[copy][0]
        # What was done on the way, or stays done, is not done again.
        while self._todo[copy] and task.done(posture[None], self._todo[copy][:1])[0, 0]:
            del self._todo[copy][0]
        if self._todo[copy]:
            shake = self._generators[copy].normal(0.0, SHAKE, 3)  # of all places alike: grips stay grips
            shaken = [each._replace(place=tuple(np.add(each.place, shake))) for each in PLANS[self._todo[copy][0]]]
            self._plan[copy] = shaken
            self._arrive(copy)

    def _arrive(self, copy: int) -> None:
        self._age[copy] = 0
        self._lag[copy] *= 0.5

    def _joint_speeds(self, joints: np.ndarray, moving: np.ndarray, turning: np.ndarray) -> np.ndarray:
        """(7,) rad/s that move and turn the hand so, damped least squares; joints at their limits are left out."""
        weights = np.repeat([1.0, 0.3], 3)
        wanted, free, speeds = weights * np.concatenate([moving, turning]), np.ones(_ARM), np.zeros(_ARM)
        for _ in range(_ARM):
            jacobian = weights[:, None] * self._jacobian[:, :_ARM] * free
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + 0.05**2 * np.eye(6))
            idle = free * 1.5 * (self._rest - joints)
            speeds = free * (inverse @ wanted + idle - inverse @ (jacobian @ idle))
            beyond = (joints < self._low) & (speeds < 0) | (joints > self._high) & (speeds > 0)
            if not beyond.any():
                break
            free *= ~beyond
        return speeds


def _sideways(roll: float) -> np.ndarray:
    """Where the fingers open when the hand points ahead and is rolled so."""
    return np.array([np.cos(roll), 0.0, -np.sin(roll)])


def _at_most(vector: np.ndarray, length: float) -> np.ndarray:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-9))
