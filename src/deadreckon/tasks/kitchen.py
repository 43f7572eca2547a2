"""FrankaKitchen: an arm in a kitchen, which has four things to do in an episode (thesis 7.3; Gupta et al. 2020).

The kitchen and the arm are gymnasium-robotics' `FrankaKitchen-v1`; observations, noise, reward and ends are D4RL's. What
differs between the two is written down in the docs (`tasks/kitchen.md`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from deadreckon.data.kitchen import ELEMENTS, JOINTS, KITCHENS, kitchen_goal
from deadreckon.data.spec import Box
from deadreckon.tasks.copies import MujocoCopies, load_model
from deadreckon.tasks.task import Reference, Task
from deadreckon.versions import installed

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset

FRAME_SKIP = 40
ARM = 9  # numbers of a posture that are the arm's
SPEED = 2.0  # rad/s (of the fingers m/s) that an action of 1 asks for
NEAR = 0.3  # a sub-task is done within this distance of its goal
# The posture that episodes begin in, D4RL's.
_FIRST = np.array([
    1.48388023e-01, -1.76848573e00, 1.84390296e00, -2.47685760e00, 2.60252026e-01, 7.12533105e-01, 1.59515394e00,
    4.79267505e-02, 3.71350919e-02, -2.66279850e-04, -5.18043486e-05, 3.12877220e-05, -4.51199853e-05, -3.90842156e-06,
    -4.22629655e-05, 6.28065475e-05, 4.04984708e-05, 4.62730939e-04, -2.26906415e-04, -4.65501369e-04, -6.44129196e-03,
    -1.77048263e-03, 1.08009684e-03, -2.69397440e-01, 3.50383255e-01, 1.61944683e00, 1.00618764e00, 4.06395120e-03,
    -6.62095997e-03, -2.68278933e-04,
])  # fmt: skip
# Limits of the arm's joints, and how wrong each position of a posture is read at most, before `noise`; of D4RL's robot.
_LOW = np.array([-2.9, -1.8, -2.9, -3.1, -2.9, 0.0, -2.9, 0.0, 0.0])
_HIGH = np.array([2.9, 1.8, 2.9, 0.0, 2.9, 3.8, 2.9, 0.04, 0.04])
_ERRORS = np.repeat([0.1, 0.005, 0.0005, 0.005, 0.1, 0.005, 0.1, 0.005], [9, 2, 6, 3, 3, 3, 3, 1])


@dataclass(frozen=True)
class Kitchen(Task):
    """A kitchen task. Observations are the posture as the robot reads it (30), and the goal (30), zeros where there is none.

    Actions in ±1 are joint speeds. A sub-task that is done for the first time earns 1; when all are, the episode ends.

    Attributes:
        elements: what is to be done, among `ELEMENTS`.
        noise: share of the robot's reading errors, uniform, that the arm's joints are seen with. The arm is steered from what
            is seen.
        object_noise: likewise of the kitchen's joints.
    """

    revision: ClassVar[int] = 1

    elements: tuple[str, ...] = ()
    noise: float = 0.1
    object_noise: float = 0.1

    @cached_property
    def goal(self) -> np.ndarray:
        """(30,) the posture's numbers that are wanted, zeros elsewhere."""
        return np.array(kitchen_goal(self.elements))

    def done(self, postures: np.ndarray, elements: Sequence[str] | None = None) -> np.ndarray:
        """(n, elements) bool, which sub-tasks' goals postures (n, 30) are near, in the order of `elements` or of the task's."""
        found = [ELEMENTS[name] for name in (self.elements if elements is None else elements)]
        away = [np.linalg.norm(postures[:, where] - np.array(wanted), axis=1) for where, wanted in found]
        return np.asarray(np.stack(away, 1) < NEAR)

    @property
    def logs_pay_alike(self) -> bool:
        """See `Task.logs_pay_alike`: they pay in each row for all that is done, as D4RL's."""
        return False

    def logged_returns(self, log: "Dataset") -> np.ndarray:
        """See `Task.logged_returns`: how many of the sub-tasks are done somewhere in each episode, whatever the log pays."""
        done = self.done(np.asarray(log.observations[:, :JOINTS], np.float64))
        last = self.done(np.asarray(log.final_observations[:, :JOINTS], np.float64)) & log.final_known[:, None]
        return (np.logical_or.reduceat(done, log.starts) | last).sum(1).astype(np.float64)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "KitchenSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return KitchenSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of the package that the kitchen is from."""
        return installed("gymnasium-robotics")


class KitchenSimulator(MujocoCopies[Kitchen]):
    """Copies of one environment; see `MujocoCopies`.

    Episodes begin alike. What a copy's seed decides is what the robot reads, step by step, episode after episode.
    """

    def __init__(self, task: Kitchen, seeds: Sequence[int], threads: int | None = None):
        super().__init__(task, kitchen(), seeds, threads, frame_skip=FRAME_SKIP)
        self._scale = _ERRORS * np.repeat([task.noise, task.object_noise], [ARM, JOINTS - ARM])
        self._read = np.zeros((len(seeds), JOINTS))  # each copy's posture as it is seen
        self._left = np.ones((len(seeds), len(task.elements)), bool)  # what each copy has not done yet

    @property
    def achieved(self) -> np.ndarray:
        """(copies,) bool, whether all is done."""
        return np.logical_not(self._left.any(1))

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "read": self._read.copy(), "left": self._left.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self._read[:], self._left[:] = state["read"], state["left"]

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        # The environments draw errors of the velocities, too, and show them (gymnasium-robotics) or not (D4RL).
        drawn = generator.uniform(-1.0, 1.0, 2 * JOINTS - 1)
        return np.concatenate([drawn[:ARM], drawn[2 * ARM : ARM + JOINTS]])

    def _begin(self, data: Any, copy: int, start: np.ndarray) -> None:
        data.qpos[:] = _FIRST
        self._left[copy] = True
        self._read[copy] = self._scale * start

    def _measure(self, data: Any, copy: int) -> None:
        if data.time > 0.0:
            self._read[copy] = self._scale * self._starts.next(copy)
        self._read[copy] += data.qpos

    def _control(self, data: Any, copy: int, action: np.ndarray) -> None:
        speed = SPEED * np.clip(action, -1.0, 1.0)
        data.ctrl[:] = np.clip(self._read[copy, :ARM] + speed * self._dt, _LOW, _HIGH)

    def _observe(self, which: Any) -> np.ndarray:
        read = self._read[which]
        return np.hstack([read, np.broadcast_to(self.task.goal, read.shape)]).astype(np.float32)

    def _camera(self) -> Any:
        # That of `FrankaKitchen-v1`; MuJoCo's own place is outside the walls.
        camera = self._mujoco.MjvCamera()
        camera.distance, camera.azimuth, camera.elevation = 2.2, 70.0, -35.0
        camera.lookat[:] = -0.2, 0.5, 2.0
        return camera

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        now = self.task.done(self._read) & self._left & self._alive[:, None]
        self._left &= ~now
        return now.sum(1).astype(np.float64), self.achieved


def kitchen() -> Any:
    """The compiled model of arm and kitchen."""
    return load_model("gymnasium_robotics", "envs/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml")


# ---- the tasks ----------------------------------------------------------------------------------------------------------


def _make(name: str, elements: tuple[str, ...]) -> Kitchen:
    published = Reference(0.0, 4.0, "D4RL: nothing, and all four sub-tasks")
    return Kitchen(
        name=name, domain="kitchen", horizon=280, observation_shape=(2 * JOINTS,), reference=published,
        action_space=Box((-1.0,) * ARM, (1.0,) * ARM), gym_id=f"deadreckon/{name.title().replace('-', '')}-v0",
        published=published, summary=", ".join(elements), properties=("undirected data", "sparse rewards", "realistic"),
        elements=elements,
    )  # fmt: skip


# Table D.3 splits no kitchen tasks.
TASKS = tuple(_make(name, elements) for name, elements in KITCHENS.items())
