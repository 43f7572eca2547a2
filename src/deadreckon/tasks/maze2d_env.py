"""The Gymnasium face of Maze2D, apart because it alone needs gymnasium."""

from typing import Any

import gymnasium
import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks import registry
from deadreckon.tasks.copies import bindings
from deadreckon.tasks.maze2d import MAX_SPEED, Maze2D, model


class Maze2DEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One maze, step by step equal to `Maze2D.simulate([seed])`. The horizon is kept by Gymnasium's `TimeLimit`.

    `render()` draws the maze from above without OpenGL, (rows, columns, 3) uint8 with 24 pixels a cell.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012 (Gymnasium's own protocol)

    def __init__(self, task: str | Maze2D = "maze2d-umaze", render_mode: str | None = None):
        found = registry.task(task) if isinstance(task, str) else task
        if not isinstance(found, Maze2D):
            raise UserError(f"{found.name} is no Maze2D task")
        self.task = found
        self.render_mode = render_mode
        # Wider than the ball can go: nothing observed is ever outside.
        low, high = np.array([-1, -1, -10, -10]), np.array([*self.task.grid.shape, 10, 10])
        self.observation_space = gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._model = model(self.task.layout)
        self._mujoco = bindings()
        self._data = self._mujoco.MjData(self._model)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode; `options={"state": [x, y, vx, vy]}` starts it there."""
        super().reset(seed=seed)
        start = self.task.start(self.np_random) if not options or "state" not in options else options["state"]
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = start[:2], start[2:]
        return self._observe()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Applies two forces, clipped to ±1."""
        data = self._data
        data.ctrl[:] = np.clip(np.asarray(action, np.float32), -1, 1)
        np.clip(data.qvel, -MAX_SPEED, MAX_SPEED, out=data.qvel)
        self._mujoco.mj_step(self._model, data)
        observation, info = self._observe()
        return observation, float(self.task.rewards(observation[None])[0]), False, False, info

    def _observe(self) -> tuple[np.ndarray, dict[str, Any]]:
        observation = np.concatenate([self._data.qpos, self._data.qvel]).astype(np.float32)
        return observation, {"goal": self.task.goal.copy()}

    def render(self) -> np.ndarray:
        """The maze from above: walls dark, goal green, ball red; x runs down, y to the right, as in the layout."""
        scale = 24
        picture = np.where(self.task.grid[..., None], (245, 245, 245), (70, 70, 90)).astype(np.uint8)
        picture = picture.repeat(scale, 0).repeat(scale, 1)
        # The box of cell (r, c) spans r - 0.7 .. r + 0.3 in observed coordinates; pixels start at -0.7.
        x, y = ((np.indices(picture.shape[:2]) + 0.5) / scale) - 0.7
        for point, radius, colour in ((self.task.goal, 0.15, (40, 170, 80)), (self._data.qpos, 0.1, (210, 50, 50))):
            picture[np.square(x - point[0]) + np.square(y - point[1]) <= radius**2] = colour
        return picture
