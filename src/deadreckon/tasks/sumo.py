"""SUMO in processes of its own: the traffic of several copies of a road."""

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import weakref
from importlib import metadata
from typing import IO, TYPE_CHECKING

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError, extra
from deadreckon.tasks.flow_world import read, write

if TYPE_CHECKING:
    from deadreckon.tasks.flow import Flow

FEW = 8  # copies that are not worth a second process


def sumo_version(task: str) -> str:
    """Of the SUMO that is installed.

    Raises:
        UserError: none is, and `task` needs it.
    """
    if importlib.util.find_spec("libsumo") is None:
        raise UserError(f"{task} needs SUMO, which is not installed: {extra('flow')}")
    return metadata.version("libsumo")


class Sumo:
    """A process with copies of a road; it ends with this object.

    Args:
        task: what is simulated.
        copies: of it.

    Raises:
        UserError: SUMO is not installed, or the process ends by itself.
    """

    def __init__(self, task: "Flow", copies: int):
        sumo_version(task.name)
        self.task = task
        self.errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)
        what = f"from deadreckon.tasks.flow_world import serve; serve{(task.road, copies, task.horizon, task.guarded)}"
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self.process = subprocess.Popen(
            [sys.executable, "-c", what], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            env=os.environ | {"PYTHONPATH": paths},
        )  # fmt: skip
        self.close = weakref.finalize(self, _end, self.process, self.errors)

    def ask(self, letter: bytes, *arrays: np.ndarray) -> None:
        """Sends what `answer` then answers; the process works meanwhile."""
        assert self.process.stdin is not None
        try:
            write(self.process.stdin, letter, *arrays)
        except (BrokenPipeError, ValueError):
            raise self._gone() from None

    def answer(self) -> bytes:
        """What came of it."""
        assert self.process.stdout is not None
        message = read(self.process.stdout)
        if message is None:
            raise self._gone()
        return message[1]

    def _gone(self) -> UserError:
        if not self.close.alive:
            return UserError(f"{self.task.name}: the simulator has been closed")
        self.process.wait()
        self.errors.seek(0)
        last = self.errors.read().decode(errors="replace").strip().rpartition("\n")[2]
        return UserError(f"{self.task.name}: SUMO's process ended with {self.process.returncode}{last and f': {last}'}")


def _end(process: subprocess.Popen[bytes], errors: IO[bytes]) -> None:
    """Closes the pipes, which ends the process."""
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended already
            pipe.close()
    process.wait()
    errors.close()


class Traffic:
    """Copies of a road, stepped together, in one or more processes.

    Args:
        task: what is simulated.
        copies: of it.
        processes: that share them.
    """

    def __init__(self, task: "Flow", copies: int, processes: int = 1):
        self.task = task
        self._parts = np.array_split(np.arange(copies), processes)
        self._sumos = [Sumo(task, len(part)) for part in self._parts]

    def begin(self, which: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(which, observations) float32, of new episodes."""
        out = np.zeros((len(which), *self.task.observation_shape), np.float32)
        for mine, sumo, local in self._share(which):
            sumo.ask(b"B", np.array([len(local)], np.int64), local, starts[mine])
        for mine, sumo, local in self._share(which):
            out[mine] = np.frombuffer(sumo.answer(), np.float32).reshape(len(local), -1)
        return out

    def end(self, which: np.ndarray) -> None:
        """Takes cars away: a copy without cars costs nothing."""
        for _, sumo, local in self._share(which):
            sumo.ask(b"E", np.array([len(local)], np.int64), local)
        for _, sumo, _ in self._share(which):
            sumo.answer()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) float32 accelerations; gives observations, rewards and who has crashed."""
        space = self.task.action_space
        assert isinstance(space, Box)
        actions = np.clip(actions, np.array(space.low, np.float32), np.array(space.high, np.float32))
        for part, sumo in zip(self._parts, self._sumos):
            sumo.ask(b"S", actions[part])
        found = []
        for part, sumo in zip(self._parts, self._sumos):
            answer, numbers = sumo.answer(), len(part) * self.task.observation_shape[0]
            seen = np.frombuffer(answer, np.float32, numbers).reshape(len(part), -1)
            rewards = np.frombuffer(answer, np.float32, len(part), offset=4 * numbers)
            found.append((seen, rewards, np.frombuffer(answer, np.uint8, offset=4 * (numbers + len(part))).astype(bool)))
        seen, rewards, crashed = (np.concatenate(each) for each in zip(*found))
        return seen, rewards, crashed

    def look(self, which: np.ndarray) -> np.ndarray:
        """(cars, 4) place in `which`, number, position in m and speed in m/s of each car."""
        found = []
        for _, sumo, local in self._share(which):
            sumo.ask(b"T", np.array([len(local)], np.int64), local)
        for mine, sumo, _ in self._share(which):
            rows = np.frombuffer(sumo.answer(), np.float64).reshape(-1, 4).copy()
            rows[:, 0] = mine[rows[:, 0].astype(int)]
            found.append(rows)
        return np.concatenate(found)

    def close(self) -> None:
        """Ends the processes, as losing this object does."""
        for sumo in self._sumos:
            sumo.close()

    def _share(self, which: np.ndarray) -> list[tuple[np.ndarray, Sumo, np.ndarray]]:
        """Places in `which` of each process's copies, the process, and which of its own they are."""
        shares = []
        for part, sumo in zip(self._parts, self._sumos):
            mine = np.flatnonzero(np.isin(which, part))
            if len(mine):
                shares.append((mine, sumo, which[mine] - part[0]))
        return shares
