"""Copies of one MuJoCo environment, stepped side by side: what all robots' simulators have in common.

Each copy has its own integration state, so that a step is a pure function of it and the action: nothing depends on the number
of copies, on threads or on interruptions.
"""

import importlib
import importlib.util
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.task import Starts, Task, checked_actions, thread_count

Own = TypeVar("Own", bound=Task)


class MujocoCopies(Generic[Own]):
    """A `Simulator` of one compiled model. Domains subclass it and say how episodes begin, what is measured and what is paid.

    Attributes:
        task: whose environment it is.
    """

    def __init__(self, task: Own, model: Any, seeds: Sequence[int], threads: int | None = None, *, frame_skip: int):
        """Sets up the copies.

        Args:
            task: whose environment it is.
            model: compiled, shared by everybody who only reads it.
            seeds: one a copy.
            threads: to step with; all cores if None.
            frame_skip: physics steps an environment step.
        """
        self.task, copies = task, len(seeds)
        self._starts = Starts(seeds, self._draw, self._generator)
        self._mujoco = mujoco = bindings()
        # Waking a thread costs more than a copy or two take.
        threads = min(thread_count(threads, task.name), max(1, copies // 4))
        self._model, self._skip = model, frame_skip
        self._models = [self._own(model) for _ in range(threads)]
        self._data = [mujoco.MjData(each) for each in self._models]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        kinds = mujoco.mjtState
        parts = kinds.mjSTATE_TIME, kinds.mjSTATE_QPOS, kinds.mjSTATE_QVEL, kinds.mjSTATE_ACT, kinds.mjSTATE_WARMSTART
        self._parts = sum(int(part.value) for part in parts)
        self._state = np.zeros((copies, mujoco.mj_stateSize(model, self._parts)))
        self._moving = self._state[:, 1 : 1 + model.nq + model.nv]  # MuJoCo puts the time first
        self._age = np.zeros(copies, int)
        self._alive = np.zeros(copies, bool)
        self._first = np.array(self._data[0].qpos)  # the body's own first posture
        self._dt = model.opt.timestep * frame_skip

    # ---- what a domain says -----------------------------------------------------------------------------------------

    def _own(self, model: Any) -> Any:
        """The model for one thread: the shared one, or a copy where episodes change it."""
        return model

    @staticmethod
    def _generator(seed: int) -> Any:
        """The random numbers of a copy."""
        return np.random.default_rng(seed)

    def _draw(self, generator: Any) -> np.ndarray:
        """What is drawn for a new episode."""
        raise NotImplementedError

    def _begin(self, data: Any, copy: int, start: np.ndarray) -> None:
        """Puts positions and velocities of a new episode into `data`, which has just been reset."""
        data.qpos[:], data.qvel[:] = start[: self._model.nq], start[self._model.nq :]

    def _settle(self, model: Any, copy: int) -> None:
        """Makes a thread's own model that of a copy's episode."""

    def _control(self, data: Any, copy: int, action: np.ndarray) -> None:
        """Sets the motors."""
        data.ctrl[:] = action

    def _measure(self, data: Any, copy: int) -> None:
        """Keeps what the integration state does not hold, after a reset and after every step."""

    def _observe(self, which: Any) -> np.ndarray:
        """Float32 observations of the copies `which` (indices or a slice)."""
        raise NotImplementedError

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rewards (copies,) of the step just done, and whether each copy's state is terminal."""
        raise NotImplementedError

    # ---- what all share ---------------------------------------------------------------------------------------------

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`."""
        return self._start(*self._starts.begun(which, seeds))

    def picture(self, copy: int, size: tuple[int, int], renderer: Any = None) -> tuple[Any, np.ndarray]:
        """What the task's camera sees of a copy.

        Args:
            copy: which.
            size: height and width in pixels.
            renderer: one that an earlier call gave; None makes one.

        Returns:
            The renderer, and (height, width, 3) uint8.
        """
        model, data = self._models[0], self._data[0]
        self._mujoco.mj_setState(model, data, self._state[copy], self._parts)
        self._settle(model, copy)
        self._mujoco.mj_forward(model, data)
        renderer = renderer or self.renderer(size)
        renderer.update_scene(data, self._camera())
        return renderer, renderer.render()

    def renderer(self, size: tuple[int, int], plain: bool = False) -> Any:
        """What draws pictures of copies.

        Args:
            size: height and width in pixels.
            plain: without smoothed edges, shadows and reflections, which take a CPU a hundred times as long.
        """
        model, flags = self._models[0], self._mujoco.mjtRndFlag
        buffer, samples = model.vis.global_, model.vis.quality.offsamples
        height, width = buffer.offheight, buffer.offwidth
        buffer.offheight, buffer.offwidth = max(height, size[0]), max(width, size[1])  # which pictures must not exceed
        model.vis.quality.offsamples = 0 if plain else samples
        try:
            found = self._mujoco.Renderer(model, *size)
        finally:  # the model is shared
            buffer.offheight, buffer.offwidth, model.vis.quality.offsamples = height, width, samples
        for flag in (flags.mjRND_SHADOW, flags.mjRND_REFLECTION) if plain else ():
            found.scene.flags[flag] = 0
        return found

    def _camera(self) -> Any:
        """What sees the task: the model's camera that goes with the robot, or the free one, where MuJoCo puts it."""
        followed = self._mujoco.mj_name2id(self._models[0], self._mujoco.mjtObj.mjOBJ_CAMERA, "track")
        return followed if followed >= 0 else -1

    def _start(self, which: Any, starts: Any) -> np.ndarray:
        """Starts an episode of each of the copies `which` with what was drawn for it; gives their observations."""
        model, data = self._models[0], self._data[0]
        for i, start in zip(which, starts):
            self._mujoco.mj_resetData(model, data)
            self._begin(data, i, start)
            self._settle(model, i)
            self._mujoco.mj_forward(model, data)  # leaves a warm start for the solver behind, as in Gymnasium
            self._mujoco.mj_getState(model, data, self._state[i], self._parts)
            self._measure(data, i)
        self._age[which] = 0
        self._alive[which] = True
        return self._observe(which)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) actions; gives observations, rewards, terminals and timeouts.

        A copy whose episode has ended rests until its `reset`: no reward, nothing ends.
        """
        running = np.flatnonzero(self._alive)
        actions = checked_actions(actions, (len(self._state), self._model.nu), self.task.name, running)
        self._advance(running, actions)
        rewards, over = self._outcome(actions)
        self._age += self._alive
        terminals = self._alive & over
        timeouts = self._alive & ~over & (self._age >= self.task.horizon)
        rewards = np.where(self._alive, rewards, 0.0).astype(np.float32)
        self._alive &= ~(terminals | timeouts)
        return self._observe(slice(None)), rewards, terminals, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {"physics": self._state.copy(), "age": self._age.copy(), "alive": self._alive.copy(), **self._starts.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._state[:], self._age[:], self._alive[:] = state["physics"], state["age"], state["alive"]
        self._starts.restore(state)

    def _advance(self, running: np.ndarray, actions: np.ndarray) -> None:
        if self._pool is None or len(running) < 2 * len(self._data):
            self._walk(self._models[0], self._data[0], running, actions)
            return
        parts = np.array_split(running, len(self._data))
        for _ in self._pool.map(self._walk, self._models, self._data, parts, [actions] * len(parts)):
            pass

    def _walk(self, model: Any, data: Any, copies: np.ndarray, actions: np.ndarray) -> None:
        # MuJoCo's calls let other threads run; what Python does in between is small beside them.
        parts, skip = self._parts, self._skip
        load, save, step = self._mujoco.mj_setState, self._mujoco.mj_getState, self._mujoco.mj_step
        for i in copies.tolist():
            state = self._state[i]
            load(model, data, state, parts)
            self._settle(model, i)
            self._control(data, i, actions[i])
            step(model, data, skip)
            save(model, data, state, parts)
            self._measure(data, i)


@lru_cache
def load_model(package: str, file: str) -> Any:
    """The compiled MuJoCo model in a file of an installed package, shared by all who step it (they never write to it).

    Args:
        package: such as `gymnasium`.
        file: below the package's folder.

    Raises:
        UserError: the package is not installed.
    """
    return bindings().MjModel.from_xml_path(str(asset(package, file)))


def asset(package: str, file: str) -> Path:
    """Where a file of an installed package lies.

    Args:
        package: such as `gymnasium`.
        file: below the package's folder.

    Raises:
        UserError: the package is not installed.
    """
    # The assets lie beside the package's code; the code itself is not loaded, it would cost every command 150 ms and more.
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise UserError(f"{package.replace('_', '-')} is not installed; it holds the bodies of these robots")
    return Path(found.submodule_search_locations[0]) / file


def bindings() -> Any:
    """The module `mujoco`, loaded when first needed; untyped, because type checkers cannot see into its compiled part."""
    return importlib.import_module("mujoco")
