"""Any task's simulator as a Gymnasium environment, apart because it alone needs gymnasium."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle

from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.tasks import registry
from deadreckon.tasks.pixels import choose_opengl, needs_opengl


class SimulatorEnv(gymnasium.Env[np.ndarray, np.ndarray], EzPickle):
    """One copy of a task: step by step equal to `Task.simulate([seed])`. The horizon is kept by the simulator, and said by the
    registered id.

    `info["success"]` says whether the goal is reached, where the simulator knows (`achieved`). `render()` draws what a camera
    sees, (height, width, 3) uint8, where MuJoCo finds an OpenGL: without a screen EGL or OSMesa, unless `MUJOCO_GL` says which.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (Gymnasium's own protocol)

    def __init__(self, task: str, render_mode: str | None = None, width: int = 480, height: int = 480):
        EzPickle.__init__(self, task, render_mode, width, height)
        if render_mode is not None:
            choose_opengl()  # before MuJoCo is imported, which looks once
        self.task = registry.task(task)
        self.render_mode = render_mode
        space = self.task.action_space
        low, high = (0, 255) if self.task.observation_dtype == "uint8" else (-np.inf, np.inf)
        dtype: Any = np.dtype(self.task.observation_dtype)
        self.observation_space = gymnasium.spaces.Box(low, high, self.task.observation_shape, dtype)
        if isinstance(space, Discrete):
            self.action_space: Any = gymnasium.spaces.Discrete(space.n)
        else:
            low, high = (np.asarray(side, np.float32) for side in (space.low, space.high))
            self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.simulator: Any = None  # until the first reset, which gives it its seed
        self._size = height, width
        self._renderer: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode: the first of the seed's, or the one after the last."""
        super().reset(seed=seed)
        if self.simulator is None:
            first = int(self.np_random.integers(2**32)) if seed is None else seed
            self.simulator, seed = self.task.simulate([first], threads=1), None
        return self.simulator.reset(seeds=None if seed is None else [seed])[0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """See `Simulator.step`."""
        seen, rewards, terminals, timeouts = self.simulator.step(np.asarray(action)[None])
        return seen[0], float(rewards[0]), bool(terminals[0]), bool(timeouts[0]), self._info()

    def render(self) -> np.ndarray | None:
        """What the task's camera sees.

        Raises:
            UserError: no episode has begun, nothing draws this task, or MuJoCo finds no OpenGL.
        """
        if self.render_mode is None:
            return None
        if self.simulator is None:
            raise UserError(f"{self.task.name} cannot be rendered before its first episode; call reset first")
        if self._renderer is None:
            if not hasattr(self.simulator, "renderer"):
                raise UserError(f"{self.task.name} cannot be rendered; leave render_mode out")
            with needs_opengl(self.task.name):
                self._renderer = self.simulator.renderer(self._size)
        return self.simulator.picture(0, self._size, self._renderer)[1]

    def close(self) -> None:
        """Gives the OpenGL context back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _info(self) -> dict[str, Any]:
        return {"success": bool(self.simulator.achieved[0])} if hasattr(self.simulator, "achieved") else {}
