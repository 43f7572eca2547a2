"""Robots whose bodies are built from a vector: an ant of 60 numbers and a kitty of 56, each four legs (thesis 6.5).

The bodies are our own, of MuJoCo's simple shapes; what a leg's numbers mean, their bounds, the default designs and the
rewards follow Design-Bench's. Every episode builds a body anew. A policy sees the design beside the robot's state, so that
one policy can move all bodies.
"""

import importlib
import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.tasks.task import Starts, Task, checked_actions, thread_count

LEGS = 4
HORIZON = 100


@dataclass(frozen=True)
class Morphology(Task):
    """A robot that is built from a design. Subclasses say of what, what it sees and what it earns.

    Attributes:
        numbers: names of a leg's numbers.
        low, high: their bounds.
        default: (legs, numbers) the usual body.
        spread: deviation of the designs of training episodes around the default, in ranges of each number.
        frame_skip: physics steps an environment step.
        timestep: of an environment step, in s.
        broken: reward of a step in which the simulation breaks, which ends the episode.
    """

    revision: ClassVar[int] = 1

    numbers: tuple[str, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    default: tuple[tuple[float, ...], ...] = ()
    spread: float = 0.1
    frame_skip: int = 1
    timestep: float = 1.0
    broken: float = 0.0

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(size,) least and greatest numbers of a design."""
        return np.tile(self.low, LEGS), np.tile(self.high, LEGS)

    @property
    def usual(self) -> np.ndarray:
        """(size,) the default design."""
        return np.concatenate(self.default)

    def unit(self, design: np.ndarray) -> np.ndarray:
        """(..., size) numbers in [-1, 1] within their bounds; 0 where there is one value only."""
        low, high = self.bounds
        return np.where(high > low, 2 * (design - low) / np.where(high > low, high - low, 1.0) - 1, 0.0)

    def simulate(
        self, seeds: Sequence[int], threads: int | None = None, designs: np.ndarray | None = None
    ) -> "MorphologySimulator":
        """One robot for each seed; see `Task.simulate`.

        Args:
            seeds: one a copy; nothing but the design is random.
            threads: to step with.
            designs: (copies, size) bodies; None: every episode draws one around the default.
        """
        return MorphologySimulator(self, seeds, threads, designs)

    def build(self, design: np.ndarray) -> Any:
        """The compiled MuJoCo model of a design (size,)."""
        raise NotImplementedError

    def posture(self, model: Any) -> np.ndarray:
        """(joints,) angles at the start, before they are brought within their ranges."""
        raise NotImplementedError

    def observe(self, data: Any, last: np.ndarray) -> np.ndarray:
        """(n,) what is seen of the robot, whose last action was `last`."""
        raise NotImplementedError

    def reward(self, data: Any, before: np.ndarray, action: np.ndarray) -> tuple[float, bool]:
        """Reward of a step from torso position `before`, and whether the episode ends."""
        raise NotImplementedError

    def control(self, model: Any, action: np.ndarray) -> np.ndarray:
        """Of the motors, from an action in [-1, 1]."""
        low, high = model.actuator_ctrlrange.T
        return (low + high) / 2 + action * (high - low) / 2


class MorphologySimulator:
    """Robots side by side, each with a body of its own.

    Attributes:
        designs: (copies, size) their bodies; before the first reset the usual ones.
    """

    def __init__(self, task: Morphology, seeds: Sequence[int], threads: int | None, designs: np.ndarray | None):
        self.task, copies = task, len(seeds)
        self._fixed = designs is not None
        self.designs = np.tile(task.usual, (copies, 1)) if designs is None else np.array(designs, np.float64)
        if self.designs.shape != (copies, len(task.usual)):
            raise UserError(f"{task.name}: designs must have shape {(copies, len(task.usual))}, got {self.designs.shape}")
        self._starts = Starts(seeds, self._draw)
        self._mujoco = importlib.import_module("mujoco")
        self._models: list[Any] = [None] * copies
        self._data: list[Any] = [None] * copies
        threads = min(thread_count(threads, task.name), copies)
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._last = np.zeros((copies, task.action_space.size))
        self._age = np.zeros(copies, int)
        self._alive = np.zeros(copies, bool)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`."""
        which, drawn = self._starts.begun(which, seeds)
        if not self._fixed:
            self.designs[which] = drawn
        self._map(self._begin, which)
        self._age[which], self._last[which], self._alive[which] = 0, 0.0, True
        return self._observe(which)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) actions; see `Simulator.step`. A copy whose episode has ended rests until its `reset`."""
        running = np.flatnonzero(self._alive)
        actions = checked_actions(actions, self._last.shape, self.task.name, running)
        rewards, terminals = np.zeros(len(self._age), np.float32), np.zeros(len(self._age), bool)

        def advance(i: int) -> None:
            model, data, action = self._models[i], self._data[i], np.clip(actions[i].astype(np.float64), -1.0, 1.0)
            before = data.xpos[1].copy()
            data.ctrl[:] = self.task.control(model, action)
            self._mujoco.mj_step(model, data, self.task.frame_skip)
            # MuJoCo restarts a state that diverged and counts it as a warning.
            bad = any(warning.number for warning in data.warning) or not np.isfinite(data.qpos).all()
            self._mujoco.mj_forward(model, data)
            self._mujoco.mj_rnePostConstraint(model, data)  # contact forces
            self._last[i] = action
            rewards[i], terminals[i] = (self.task.broken, True) if bad else self.task.reward(data, before, action)

        self._map(advance, running)
        self._age[running] += 1
        timeouts = self._alive & ~terminals & (self._age >= self.task.horizon)
        self._alive &= ~(terminals | timeouts)
        return self._observe(np.arange(len(self._age))), rewards, terminals, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        physics = np.stack([self._physics(i) for i in range(len(self._age))])
        return {"designs": self.designs.copy(), "physics": physics, "last": self._last.copy(), "age": self._age.copy(),
                "alive": self._alive.copy(), **self._starts.state()}  # fmt: skip

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._starts.restore(state)
        self.designs[:], self._last[:], self._age[:] = state["designs"], state["last"], state["age"]
        self._alive[:] = state["alive"]
        for i, physics in enumerate(state["physics"]):
            self._begin(i)
            self._mujoco.mj_setState(self._models[i], self._data[i], physics, self._parts)
            self._mujoco.mj_forward(self._models[i], self._data[i])
            self._mujoco.mj_setState(self._models[i], self._data[i], physics, self._parts)  # the solver's warm start, too

    @property
    def _parts(self) -> int:
        kinds = self._mujoco.mjtState
        return int(kinds.mjSTATE_FULLPHYSICS.value) | int(kinds.mjSTATE_WARMSTART.value)

    def _physics(self, i: int) -> np.ndarray:
        if self._models[i] is None:
            self._begin(i)
        out = np.zeros(self._mujoco.mj_stateSize(self._models[i], self._parts))
        self._mujoco.mj_getState(self._models[i], self._data[i], out, self._parts)
        return out

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        low, high = self.task.bounds
        return np.clip(self.task.usual + self.task.spread * (high - low) * generator.standard_normal(len(low)), low, high)

    def _map(self, act: Callable[[int], None], which: np.ndarray) -> None:
        if self._pool is None:
            for i in which:
                act(int(i))
        else:
            for _ in self._pool.map(act, which.tolist()):
                pass

    def _begin(self, i: int) -> None:
        """Builds the body and lifts it where some of it would begin below the floor."""
        mujoco, task = self._mujoco, self.task
        model = self._models[i] = task.build(self.designs[i])
        data = self._data[i] = mujoco.MjData(model)
        data.qpos[7:] = np.clip(task.posture(model), *model.jnt_range[1:].T)
        mujoco.mj_kinematics(model, data)
        data.qpos[2] += max(0.0, -_lowest(model, data))
        mujoco.mj_forward(model, data)

    def _observe(self, which: np.ndarray) -> np.ndarray:
        out = np.zeros((len(which), *self.task.observation_shape), np.float32)
        own = out.shape[1] - self.designs.shape[1]
        for row, i in enumerate(which):
            if self._data[i] is not None:
                out[row, :own] = np.clip(self.task.observe(self._data[i], self._last[i]), -100.0, 100.0)
        out[:, own:] = self.task.unit(self.designs[which])
        return out


def _lowest(model: Any, data: Any) -> float:
    """Height of the lowest point of capsules, spheres and boxes above the floor, which is the first geom."""
    kinds = importlib.import_module("mujoco").mjtGeom
    size, upright = model.geom_size[1:], data.geom_xmat[1:].reshape(-1, 3, 3)[:, 2]
    reach = size[:, 0] + np.where(model.geom_type[1:] == int(kinds.mjGEOM_CAPSULE), np.abs(upright[:, 2]) * size[:, 1], 0.0)
    reach = np.where(model.geom_type[1:] == int(kinds.mjGEOM_BOX), (np.abs(upright) * size).sum(1), reach)
    return float((data.geom_xpos[1:, 2] - reach).min())


class _Body:
    """A model under construction: a floor, a torso that moves freely, and hinges with a motor each. Angles are in radians."""

    def __init__(self, timestep: float, height: float):
        self.kinds = mujoco = importlib.import_module("mujoco")
        self.spec = mujoco.MjSpec()
        self.spec.compiler.degree = False
        self.spec.option.timestep = timestep
        # Legs touch the floor, and nothing else.
        self.spec.default.geom.contype, self.spec.default.geom.conaffinity = 1, 0
        self.spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[40, 40, 1], conaffinity=1)
        self.torso = self.spec.worldbody.add_body(pos=[0, 0, height])
        self.torso.add_freejoint()

    def capsule(self, body: Any, end: Sequence[float], radius: float, mass: float | None = None) -> None:
        """From the body's origin."""
        more = {} if mass is None else {"mass": mass}
        body.add_geom(type=self.kinds.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *end], size=[radius, 0, 0], **more)

    def hinge(self, body: Any, axis: Sequence[float], middle: float, half: float) -> Any:
        """A joint at the body's origin with a motor, which is given back; half of its range on either side of the middle."""
        name = f"joint{len(self.spec.actuators)}"
        body.add_joint(name=name, type=self.kinds.mjtJoint.mjJNT_HINGE, axis=axis, range=[middle - half, middle + half])
        return self.spec.add_actuator(trntype=self.kinds.mjtTrn.mjTRN_JOINT, target=name)


def _turned(*angles: float) -> np.ndarray:
    """Quaternion of angles about x, then the new y, then the new z, in radians."""
    return Rotation.from_euler("XYZ", angles).as_quat(scalar_first=True)


class AntMorphology(Morphology):
    """An ant that is to run along x: lengths in m, angles in degrees.

    Masses, friction and motors are those of Gymnasium's Ant; a leg has three joints. Falling ends nothing.
    """

    revision: ClassVar[int] = 1

    def build(self, design):
        """See `Morphology.build`."""
        body = _Body(self.timestep / self.frame_skip, 0.75)
        mujoco, default = body.kinds, body.spec.default
        body.spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        default.geom.friction, default.geom.margin, default.geom.density = [1, 0.5, 0.5], 0.01, 5.0
        default.joint.armature, default.joint.damping = 1.0, [1, 0, 0]
        body.torso.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.25, 0, 0])
        for leg in np.asarray(design, np.float64).reshape(LEGS, -1):
            part = body.torso.add_body(pos=leg[:3], quat=_turned(*np.deg2rad(leg[3:6])))
            ranges, sizes = np.deg2rad(leg[6:12].reshape(3, 2)), leg[12:]
            body.capsule(part, [sizes[0], sizes[0], 0], 0.08)
            # Two joints where the hip ends, one where the thigh does.
            for axes, (before, after) in zip((((-1, 1, 0), (0, 0, 1)), ((-1, 1, 0),)), itertools.pairwise(sizes)):
                part = part.add_body(pos=[before, before, 0])
                for axis in axes:
                    motor = body.hinge(part, axis, *ranges[0])
                    motor.gear[0], motor.ctrlrange = 150, [-1, 1]
                    ranges = ranges[1:]
                body.capsule(part, [after, after, 0], 0.08)
        return body.spec.compile()

    def posture(self, model):
        """See `Morphology.posture`."""
        return np.zeros(3 * LEGS)

    def observe(self, data, last):
        """(35,) height, rotation and joints, then their velocities."""
        return np.concatenate([data.qpos[2:], data.qvel])

    def reward(self, data, before, action):
        """Speed along x and 1, less what actions and contacts cost."""
        contact = 0.5e-3 * np.square(np.clip(data.cfrc_ext, -1, 1)).sum()
        speed = (data.xpos[1, 0] - before[0]) / self.timestep
        return float(speed + 1.0 - 0.5 * np.square(action).sum() - contact), False


class KittyMorphology(Morphology):
    """A kitty that is to walk two metres along y: lengths in m, angles in radians.

    Size, weight and position control are near those of ROBEL's D'Kitty (Ahn et al. 2020), whose meshes it does without. Falling
    over ends an episode.
    """

    revision: ClassVar[int] = 1

    target = (0.0, 2.0)

    def build(self, design):
        """See `Morphology.build`."""
        body = _Body(self.timestep / self.frame_skip, 0.0)
        mujoco, default = body.kinds, body.spec.default
        body.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        default.joint.armature, default.joint.damping, default.joint.frictionloss = 1e-3, [0.15, 0, 0], 3e-3
        body.torso.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.115, 0.025], mass=0.9)
        for leg in np.asarray(design, np.float64).reshape(LEGS, -1):
            part = body.torso.add_body(pos=leg[:3], quat=_turned(*leg[3:6]))
            ranges, (thigh, ankle) = leg[6:12].reshape(3, 2), leg[12:]
            for k, (axis, length, radius, mass) in enumerate(
                [((0, 1, 0), thigh, 0.018, 0.09), ((1, 0, 0), ankle, 0.018, 0.08), ((1, 0, 0), 0.11, 0.014, 0.05)]
            ):
                part = part if k == 0 else part.add_body(pos=[0, 0, (thigh, ankle)[k - 1]])
                motor = body.hinge(part, axis, *ranges[k])
                motor.set_to_position(kp=3.0)
                motor.ctrlrange = [ranges[k, 0] - ranges[k, 1], ranges[k, 0] + ranges[k, 1]]
                body.capsule(part, [0, 0, length], radius, mass)
        return body.spec.compile()

    def posture(self, model):
        """See `Morphology.posture`."""
        return np.tile([0.0, math.pi / 4, -math.pi / 2], LEGS)

    def observe(self, data, last):
        """(53,) position, rotation and joints, their velocities, the last action, how upright, the heading, way to the goal."""
        upright, heading, way = self._stance(data)
        return np.concatenate([data.qpos, data.qvel, last, [upright, heading], way])

    def reward(self, data, before, action):
        """Nearness of the goal, heading and standing upright; -500 and the end where it falls."""
        upright, heading, way = self._stance(data)
        distance = float(np.hypot(*way))
        near, ahead, fallen = distance < 0.5, heading > 0.9, upright < 0.9
        reward = (upright - 0.9) / 0.1 - 500.0 * fallen - 4.0 * distance + 2.0 * (heading - 0.9) / 0.1
        return float(reward + 5.0 * (int(near) + int(ahead)) + 10.0 * (near and ahead)), bool(fallen)

    def _stance(self, data: Any) -> tuple[float, float, np.ndarray]:
        """Cosine of the torso with the vertical, of its y axis with the way to the goal, and that way (2,)."""
        turned = data.xmat[1].reshape(3, 3)
        way = np.array(self.target) - data.xpos[1, :2]
        size = np.linalg.norm(way) * np.linalg.norm(turned[:2, 1])
        return float(turned[2, 2]), float(turned[:2, 1] @ way / max(size, 1e-9)), way


def _make(kind: type[Morphology], name: str, seen: int, summary: str, **fields: Any) -> Morphology:
    size = LEGS * len(fields["numbers"])
    return kind(
        name=name, domain="morphology", horizon=HORIZON, observation_shape=(seen + size,), gym_id="", reference=None,
        action_space=Box((-1.0,) * 3 * LEGS, (1.0,) * 3 * LEGS), summary=summary, **fields,
    )  # fmt: skip


_PLACE = ("x", "y", "z", "a", "b", "c")
_JOINTS = tuple(f"{joint}_{what}" for joint in ("hip", "thigh", "ankle") for what in ("center", "range"))

ANT = _make(
    AntMorphology, "ant-morphology", 35, "run along x with a body of 60 numbers", spread=0.03, frame_skip=5, timestep=0.05,
    numbers=(*_PLACE, *_JOINTS, "hip_size", "thigh_size", "ankle_size"),
    low=(-0.1,) * 3 + (-180.0,) * 3 + (-180.0, 5.0) * 3 + (0.1, 0.1, 0.2),
    high=(0.1,) * 3 + (180.0,) * 3 + (180.0, 45.0) * 3 + (0.4, 0.4, 0.8),
    default=tuple((0.0,) * 5 + (angle, 0.0, 5.0, 0.0, 30.0, 50.0, 20.0, 0.2, 0.2, 0.4) for angle in (0.0, 90.0, 180.0, -90.0)),
)  # fmt: skip

_PI = math.pi
KITTY = _make(
    KittyMorphology, "dkitty-morphology", 53, "walk two metres along y with a body of 56 numbers", spread=0.03, frame_skip=40,
    timestep=0.08, broken=-500.0,  # no better than a fall
    numbers=(*_PLACE, *_JOINTS, "thigh_size", "ankle_size"),
    low=(-0.09, -0.122, 0.0) + (-_PI,) * 3 + (-_PI, _PI / 35) * 3 + (0.0965, 0.0945),
    high=(0.09, 0.122, 0.0) + (_PI,) * 3 + (_PI, _PI / 4, _PI, _PI / 4, _PI, _PI / 2) + (0.1365, 0.1345),
    default=tuple(
        (x, y, 0.0, 0.0, side * _PI, 0.0, side * 0.1105, 0.3895, _PI / 4, _PI / 4, -1.0, 1.0, 0.0965, 0.0945)
        for side, x, y in ((-1, 0.09, 0.122), (1, -0.09, 0.122), (1, -0.09, -0.122), (-1, 0.09, -0.122))
    ),
)  # fmt: skip
