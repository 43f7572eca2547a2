"""Any task whose simulator draws pictures, seen by its camera: `walker2d:pixels`, and `carla-lane`.

What acts sees the last frames alone; all else, from starts to rewards and ends, is the task's own.
"""

import contextlib
import ctypes
import dataclasses
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.task import Task

SUFFIX = ":pixels"  # of the name of a task that is seen
SIDE, FRAMES = 84, 3  # pixels of height and width, and frames, as in visual control (Yarats et al. 2022)


@dataclass(frozen=True)
class Pixels(Task):
    """A task whose observations are the last frames of its camera, (height, width, 3 frames) uint8, the newest last.

    Attributes:
        base: the task that is seen.
        frames: that an observation holds; before an episode's first step all are of its start.
    """

    revision: ClassVar[int] = 1

    base: Task = dataclasses.field(kw_only=True)
    frames: int = 1

    @classmethod
    def of(cls, base: Task, size: tuple[int, int], frames: int, name: str, **changes: Any) -> "Pixels":
        """A task seen in frames of a size.

        Args:
            base: the task.
            size: height and width in pixels.
            frames: in an observation.
            name: of what it becomes.
            **changes: further fields that differ from the task's.
        """
        own = {field.name: getattr(base, field.name) for field in dataclasses.fields(Task)}
        own |= {"name": name, "observation_shape": (*size, 3 * frames), "observation_dtype": "uint8"} | changes
        return cls(**own, base=base, frames=frames)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "PixelSimulator":
        """See `Task.simulate`; pictures are drawn by one thread.

        Raises:
            UserError: nothing draws the task.
        """
        choose_opengl()
        base = self.base.simulate(seeds, threads)
        if not hasattr(base, "renderer"):
            raise UserError(f"{self.base.name} cannot be rendered, so it has no image observations; leave {SUFFIX} out")
        return PixelSimulator(self, base, len(seeds))

    def shown(self, simulator: Any, observations: np.ndarray, which: np.ndarray) -> np.ndarray:
        """See `Task.shown`: what the task itself would show."""
        return self.base.shown(simulator.base, simulator.seen, which)

    @property
    def versions(self) -> Mapping[str, str]:
        """See `Task.versions`."""
        return self.base.versions

    @property
    def logs_pay_alike(self) -> bool:
        """See `Task.logs_pay_alike`."""
        return self.base.logs_pay_alike

    def logged_returns(self, log: Any) -> np.ndarray:
        """See `Task.logged_returns`."""
        return self.base.logged_returns(log)


class PixelSimulator:
    """Copies of a task, and what the camera saw of each.

    Attributes:
        base: simulator of the task itself.
        seen: (copies, *shape) the task's own observations, the last.
        frames: (copies, height, width, 3 frames) uint8.
    """

    def __init__(self, task: Pixels, base: Any, copies: int):
        self.task, self.base = task, base
        self.seen = np.zeros((copies, *task.base.observation_shape), np.float32)
        self.frames = np.zeros((copies, *task.observation_shape), np.uint8)
        self._alive = np.zeros(copies, bool)
        self._size = task.observation_shape[0], task.observation_shape[1]
        self._renderer: Any = None

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """See `Simulator.reset`."""
        which = np.arange(len(self.frames)) if which is None else np.asarray(which)
        self.seen[which] = self.base.reset(which, seeds)
        self._alive[which] = True
        for copy in which.tolist():
            self.frames[copy] = np.tile(self._drawn(copy), (1, 1, self.task.frames))
        return self.frames[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """See `Simulator.step`; a copy whose episode is over is not drawn again."""
        seen, rewards, terminals, timeouts = self.base.step(actions)
        self.seen = seen
        for copy in np.flatnonzero(self._alive).tolist():
            if self.task.frames > 1:
                self.frames[copy, :, :, :-3] = self.frames[copy, :, :, 3:].copy()
            self.frames[copy, :, :, -3:] = self._drawn(copy)
        self._alive &= ~(terminals | timeouts)
        return self.frames.copy(), rewards, terminals, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        own = {"pixels": self.frames.copy(), "seen": self.seen.copy(), "drawn": self._alive.copy()}
        return own | {f"base.{name}": column for name, column in self.base.state().items()}

    def restore(self, state: dict[str, np.ndarray]) -> np.ndarray | None:
        """See `Simulator.restore`."""
        self.frames, self.seen, self._alive = (state[name].copy() for name in ("pixels", "seen", "drawn"))
        named = {name.removeprefix("base."): column for name, column in state.items() if name.startswith("base.")}
        return self.base.restore(named)

    @property
    def achieved(self) -> Any:
        """(copies,) whether goals are reached, where the task knows."""
        return self.base.achieved

    def picture(self, copy: int, size: tuple[int, int], renderer: Any = None) -> tuple[Any, np.ndarray]:
        """What the task's camera sees of a copy, in any size; see the task's simulator."""
        return self.base.picture(copy, size, renderer)

    def renderer(self, size: tuple[int, int], plain: bool = False) -> Any:
        """What draws pictures in any size; see the task's simulator."""
        return self.base.renderer(size, plain)

    def close(self) -> None:
        """Gives the OpenGL context back; it is made anew when something is drawn."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _drawn(self, copy: int) -> np.ndarray:
        """(height, width, 3) uint8, what the camera sees now."""
        if self._renderer is None:
            self._renderer = self._begun()
        return self.base.picture(copy, self._size, self._renderer)[1]

    def _begun(self) -> Any:
        with needs_opengl(self.task.name):
            return self.base.renderer(self._size, plain=True)


REMEDY = (
    "without a screen set MUJOCO_GL=egl, or MUJOCO_GL=osmesa for a CPU alone (on Debian and Ubuntu the packages libegl1 and "
    "libosmesa6 have these), or use a task without images, such as carla-lane-state"
)


@contextlib.contextmanager
def needs_opengl(task: str) -> Iterator[None]:
    """For the first drawing of a task: says in one line that MuJoCo finds no OpenGL, whatever it raises.

    Raises:
        UserError: it does not.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{task} is drawn with OpenGL, which MuJoCo does not find; {REMEDY}") from error


def choose_opengl() -> None:
    """Where there is no screen, has MuJoCo draw on a GPU by EGL, or on the CPU by OSMesa, unless `MUJOCO_GL` says how.

    MuJoCo looks once, when it is loaded.
    """
    said = {"MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)
    if said or not sys.platform.startswith("linux") or "mujoco" in sys.modules:
        return
    card = Path("/dev/dri").exists() or Path("/dev/nvidiactl").exists()
    if card and _loads("libEGL.so.1"):
        os.environ["MUJOCO_GL"] = "egl"
    elif _loads("libOSMesa.so.8", "libOSMesa.so"):
        os.environ["MUJOCO_GL"] = "osmesa"


def _loads(*names: str) -> bool:
    for name in names:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


def of_pixels(base: Task) -> Pixels:
    """`NAME:pixels` of a task.

    Raises:
        UserError: it shows pictures already.
    """
    if isinstance(base, Pixels):
        raise UserError(f"{base.name} has image observations already; leave {SUFFIX} out")
    return Pixels.of(base, (SIDE, SIDE), FRAMES, f"{base.name}{SUFFIX}", gym_id="")
