"""Flow: learners among drivers, who are to keep traffic flowing on a ring and past an on-ramp (thesis 7.3), on SUMO.

SUMO is no part of the default install; it runs in processes of its own (`tasks/flow_roads.py`), which end when their
simulator does. There are no servers, no ports and no windows.
"""

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import IO

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.tasks.flow_roads import ROADS, STEP, Road, read, write
from deadreckon.tasks.task import Reference, Simulator, Starts, Task, checked_actions, thread_count

FEW = 8  # copies that are not worth a second process


@dataclass(frozen=True)
class Flow(Task):
    """A Flow task. Actions are accelerations in m/s^2; a crash is terminal and pays nothing.

    Attributes:
        road: `ring` or `merge`.
        guarded: SUMO brakes for learners, and holds them back where they would not have the right of way, as in D4RL, so that
            they cannot crash. Without it they can.
    """

    road: str = ""
    guarded: bool = True

    @property
    def kind(self) -> type[Road]:
        """What is simulated."""
        return ROADS[self.road]

    def start(self, generator: np.random.Generator) -> np.ndarray:
        """All that is random about a new episode."""
        return self.kind.start(generator, self.horizon)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "FlowSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return FlowSimulator(self, seeds, threads)

    def shown(self, simulator: Simulator, observations: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(which, cars, 2) position in m and speed in m/s of all cars by number; see `Task.shown`."""
        assert isinstance(simulator, FlowSimulator)
        out = np.full((len(which), self.cars, 2), np.nan, np.float32)
        rows = simulator.traffic(which)
        out[rows[:, 0].astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
        return out

    @property
    def cars(self) -> int:
        """That take part in an episode."""
        return self.kind.count(self.horizon)

    @property
    def learners(self) -> list[int]:
        """Their numbers among the cars."""
        return self.kind.learners(self.horizon)

    @property
    def seconds(self) -> float:
        """Of a step."""
        return STEP * self.kind.substeps


def sumo_version(task: str) -> str:
    """Of the SUMO that is installed.

    Raises:
        UserError: none is, and `task` needs it.
    """
    if importlib.util.find_spec("libsumo") is None:
        raise UserError(f"{task} needs SUMO, which is not installed: pip install 'deadreckon[flow]'")
    return metadata.version("libsumo")


class Sumo:
    """A process with copies of a road; it ends with this object.

    Args:
        task: what is simulated.
        copies: of it.

    Raises:
        UserError: SUMO is not installed, or the process ends by itself.
    """

    def __init__(self, task: Flow, copies: int):
        sumo_version(task.name)
        self.task = task
        self.errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)
        what = f"from deadreckon.tasks.flow_roads import serve; serve{(task.road, copies, task.horizon, task.guarded)}"
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

    def __init__(self, task: Flow, copies: int, processes: int = 1):
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


class FlowSimulator:
    """Copies of one environment; an episode follows from its start and the actions alone, to the last bit."""

    def __init__(self, task: Flow, seeds: Sequence[int], threads: int | None = None):
        self.task, copies = task, len(seeds)
        self._starts = Starts(seeds, task.start)
        processes = min(thread_count(threads, task.name), max(1, copies // FEW))
        self._traffic = Traffic(task, copies, processes)
        size = len(task.start(np.random.default_rng(0)))
        self._begun = np.zeros((copies, size))
        self._taken = np.zeros((copies, task.horizon, task.kind.action_size), np.float32)
        self._age = np.zeros(copies, int)
        self._alive = np.zeros(copies, bool)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`."""
        which = np.arange(len(self._age)) if which is None else np.asarray(which)
        if seeds is not None:
            self._starts.begin(which, seeds)
        self._begun[which] = [self._starts.next(i) for i in which]
        self._age[which], self._alive[which] = 0, True
        return self._traffic.begin(which, self._begun[which])

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) accelerations, clipped to the bounds; gives observations, rewards, terminals and timeouts.

        A copy whose episode has ended rests until its `reset`: no reward, nothing ends.
        """
        running = np.flatnonzero(self._alive)
        actions = checked_actions(actions, (len(self._age), self.task.kind.action_size), self.task.name, running)
        actions = np.where(self._alive[:, None], actions, np.float32(0.0))
        self._taken[running, self._age[running]] = actions[running]
        seen, rewards, crashed = self._traffic.step(actions)
        self._age += self._alive
        timeouts = self._alive & ~crashed & (self._age >= self.task.horizon)
        over = np.flatnonzero(crashed | timeouts)
        self._alive[over] = False
        if len(over):
            self._traffic.end(over)
        return seen, rewards, crashed, timeouts

    def traffic(self, which: np.ndarray) -> np.ndarray:
        """See `Traffic.look`."""
        return self._traffic.look(which)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`. SUMO's own state is left out: it follows from these."""
        return {"begun": self._begun.copy(), "taken": self._taken.copy(), "age": self._age.copy(), "alive": self._alive.copy(),
                **self._starts.state()}  # fmt: skip

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`. The episodes under way are played again, at most a horizon of steps."""
        self._begun[:], self._taken[:] = state["begun"], state["taken"]
        self._age[:], self._alive[:] = state["age"], state["alive"]
        self._starts.restore(state)
        self._traffic.end(np.arange(len(self._age)))
        ages = np.where(self._alive, self._age, -1)
        for left in range(ages.max(), -1, -1):
            which = np.flatnonzero(ages == left)
            if len(which):
                self._traffic.begin(which, self._begun[which])
            if left:
                running = np.flatnonzero(ages >= left)
                actions = np.zeros((len(ages), self.task.kind.action_size), np.float32)
                actions[running] = self._taken[running, ages[running] - left]
                self._traffic.step(actions)

    def close(self) -> None:
        """Ends SUMO's processes, as losing the simulator does."""
        self._traffic.close()


# ---- the tasks --------------------------------------------------------------------------------------------------------

# Measured on this simulator (SUMO 1.28.0, seed 0): mean returns of 100 episodes of uniform actions (thesis 7.3), and of 100 of
# a controller that calms traffic (Stern et al. 2018). Made by `python -m deadreckon.collect.references`.
_MEASURED = {"flow-ring": (-173.1227, 13.0242), "flow-merge": (116.2687, 271.1366)}
_PUBLISHED = {"flow-ring": (-165.22, 24.42), "flow-merge": (118.67993, 330.03179)}


def _make(road: str, horizon: int, bound: float, summary: str) -> Flow:
    name, kind = f"flow-{road}", ROADS[road]
    random, expert = _MEASURED[name]
    return Flow(
        name=name, domain="flow", horizon=horizon, observation_shape=(kind.observation_size,),
        action_space=Box((-bound,) * kind.action_size, (bound,) * kind.action_size),
        gym_id=f"deadreckon/Flow-{road.title()}-v0",
        reference=Reference(random, expert, "measured on this simulator: uniform actions, a controller that calms traffic"),
        published=Reference(*_PUBLISHED[name], "D4RL"), summary=summary, road=road,
        properties=("non-representable policies", "realistic"), source="Wu et al. 2017",
    )  # fmt: skip


TASKS = (
    _make("ring", 100, 1.0, "drive one of 22 cars on a ring so that all flow; the learner sees only the car ahead"),
    _make("merge", 750, 1.5, "drive five of the cars on a highway past an on-ramp so that all flow"),
)
