"""The Gymnasium face of the task `ant`, apart because it alone needs gymnasium. The other robots' are Gymnasium's own."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.mujoco.ant_v5 import AntEnv

from deadreckon.tasks import registry


class PaddedAntEnv(AntEnv):
    """Gymnasium's Ant-v5 with the observations of v2: contact forces cost nothing and are 84 zeros.

    Step by step equal to `task("ant").simulate([seed])`. The horizon is kept by Gymnasium's `TimeLimit`. Options are those
    of Gymnasium's environment.
    """

    def __init__(self, **options: Any):
        super().__init__(**options, contact_cost_weight=0.0, include_cfrc_ext_in_observation=False)
        gymnasium.utils.EzPickle.__init__(self, **options)  # the parent's would unpickle with arguments that we set
        shape = registry.task("ant").observation_shape
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Applies eight torques."""
        # Actions are float32, as in logs; their cost is summed in float64, as in our simulator.
        action = np.asarray(action, np.float32).astype(np.float64)
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(np.float32(reward)), bool(terminated), truncated, info

    def _get_obs(self) -> np.ndarray:
        seen = super()._get_obs()
        out = np.zeros(registry.task("ant").observation_shape, np.float32)
        out[: len(seen)] = seen
        return out
