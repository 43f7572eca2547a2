"""The Gymnasium face of Flow, apart because it alone needs gymnasium."""

from typing import Any

import gymnasium
import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.tasks import registry
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.flow_roads import CAR
from deadreckon.tasks.sumo import Traffic

ONE = np.zeros(1, np.int64)


class FlowEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One road, step by step equal to `Flow.simulate([seed])`. The horizon is kept by Gymnasium's `TimeLimit`.

    SUMO runs in a process that ends with `close()`, or with this object or Python. `render()` draws the road as a straight
    line, one pixel a metre of the way along it, (24, 1024, 3) uint8: learners red, other cars blue. Cars on the merge's ramp,
    which have no place along the highway, are left out.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's own protocol)

    def __init__(self, task: str | Flow = "flow-ring", render_mode: str | None = None):
        found = registry.task(task) if isinstance(task, str) else task
        if not isinstance(found, Flow):
            raise UserError(f"{found.name} is no Flow task")
        self.task, self.render_mode = found, render_mode
        assert isinstance(found.action_space, Box)
        low, high = np.array(found.action_space.low, np.float32), np.array(found.action_space.high, np.float32)
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        # Wider than what is seen: speeds and gaps, in units of the greatest.
        self.observation_space = gymnasium.spaces.Box(-3.0, 3.0, found.observation_shape, np.float32)
        self._traffic = Traffic(found, 1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode."""
        super().reset(seed=seed)
        return self._traffic.begin(ONE, self.task.start(self.np_random)[None])[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Applies accelerations, clipped to the bounds; a crash ends the episode."""
        seen, rewards, crashed = self._traffic.step(np.asarray(action, np.float32)[None])
        return seen[0], float(rewards[0]), bool(crashed[0]), False, {}

    def traffic(self) -> np.ndarray:
        """(cars, 3) number, position in m and speed in m/s of each car that is on the road; positions on a ramp are NaN."""
        return self._traffic.look(ONE)[:, 1:]

    def render(self) -> np.ndarray | None:
        """The cars on the road; None where no render mode was asked for."""
        if self.render_mode is None:
            return None
        picture = np.full((24, 1024, 3), 225, np.uint8)
        for number, place, _ in self.traffic():
            if np.isnan(place):
                continue
            front = int(np.clip(place, 0, picture.shape[1] - 1))
            colour = (210, 50, 50) if int(number) in self.task.learners else (50, 90, 190)
            picture[8:16, max(front - int(CAR), 0) : front + 1] = colour
        return picture

    def close(self) -> None:
        """Ends SUMO's process."""
        self._traffic.close()
