"""The Gymnasium faces of `ant` and `humanoid`, apart because they alone need gymnasium. The other robots' are its own.

Both are Gymnasium's v5 with the observations of v2, and take its options. Step by step they equal the tasks' simulators. The
horizon is kept by Gymnasium's `TimeLimit`.
"""

from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.mujoco.ant_v5 import AntEnv
from gymnasium.envs.mujoco.humanoid_v5 import HumanoidEnv
from gymnasium.utils import EzPickle

from deadreckon.tasks import registry

_WITHOUT_CONTACTS = {"contact_cost_weight": 0.0, "include_cfrc_ext_in_observation": False}


class _Padded(MujocoEnv, EzPickle):
    """What both have in common: contact forces cost nothing, and are zeros."""

    task: ClassVar[str]
    fixed: ClassVar[dict[str, Any]] = _WITHOUT_CONTACTS

    def __init__(self, **options: Any):
        super().__init__(**options, **self.fixed)
        EzPickle.__init__(self, **options)  # the parent's would unpickle with arguments that we set
        shape = registry.task(self.task).observation_shape
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, Any, bool, Literal[False], dict[str, Any]]:
        """Applies torques; see the task for what they bring."""
        # Actions are float32, as in logs; their cost is summed in float64, as in our simulator.
        action = np.asarray(action, np.float32).astype(np.float64)
        observation, reward, terminated, _, info = super().step(action)  # pyrefly: ignore[bad-argument-type]
        return observation, float(np.float32(reward)), bool(terminated), False, info

    def _get_obs(self) -> np.ndarray:
        seen = np.concatenate([super()._get_obs(), *self._inner()])  # pyrefly: ignore[missing-attribute]
        out = np.zeros(registry.task(self.task).observation_shape, np.float32)
        out[: len(seen)] = seen
        return out

    def _inner(self) -> list[np.ndarray]:
        """What is seen between velocities and zeros."""
        return []


class PaddedAntEnv(_Padded, AntEnv):
    """Ant-v5, whose 84 contact forces are zeros and cost nothing."""

    task = "ant"


class PaddedHumanoidEnv(_Padded, HumanoidEnv):
    """Humanoid-v5, whose 84 contact forces are zeros and cost nothing.

    As in v2, the world is one of the bodies whose inertias and velocities are observed, and the motor forces begin with six
    zeros for the root.
    """

    task = "humanoid"
    fixed: ClassVar[dict[str, Any]] = _WITHOUT_CONTACTS | {
        f"include_{part}_in_observation": False for part in ("cinert", "cvel", "qfrc_actuator")
    }

    def _inner(self) -> list[np.ndarray]:
        return [self.data.cinert.ravel(), self.data.cvel.ravel(), self.data.qfrc_actuator]
