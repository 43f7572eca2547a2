"""The Gymnasium face of the Ant that D4RL logged, apart because it alone needs gymnasium. The other three are Gymnasium's."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.mujoco.ant_v5 import AntEnv

from deadreckon.tasks import registry


class PaddedAntEnv(AntEnv):
    """Gymnasium's Ant-v5 in the layout of v2: contact forces are not felt, do not cost, and are 84 zeros.

    Step by step equal to `task("ant").simulate([seed])`. The horizon is kept by Gymnasium's `TimeLimit`.
    """

    def __init__(self, **options: Any):
        # Set beforehand: the parent's initialiser may observe.
        self._shape = registry.task("ant").observation_shape
        super().__init__(**options, contact_cost_weight=0.0, include_cfrc_ext_in_observation=False)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, self._shape, np.float32)
        self.observation_structure["padding"] = self._shape[0] - sum(
            self.observation_structure[part] for part in ("qpos", "qvel", "cfrc_ext")
        )

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Applies eight torques. Actions and rewards are rounded to float32, as in logs."""
        # Costs are summed in float64, as the simulator does.
        observation, reward, terminal, truncated, info = super().step(np.asarray(action, np.float32).astype(np.float64))
        return observation, float(np.float32(reward)), bool(terminal), truncated, info

    def _get_obs(self) -> np.ndarray:
        seen = super()._get_obs()
        out = np.zeros(self._shape, np.float32)
        out[: len(seen)] = seen
        return out
