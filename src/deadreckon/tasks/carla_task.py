"""Driving in CARLA servers as a task: `carla:HOST:PORT/lane` and `carla:HOST:PORT/town`, with D4RL's pictures, actions and pay.

One server steps one world, in which one car is judged: so it is one copy. As many servers as are named, as in
`carla:HOST:PORT,HOST:PORT/lane`, are copies that are stepped side by side, and episodes beyond run in turns.
"""

import re
import weakref
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError, unknown
from deadreckon.tasks.carla_scenes import SCENES
from deadreckon.tasks.carla_server import SIZE, Server
from deadreckon.tasks.gymnasium_names import options_of
from deadreckon.tasks.task import Reference, Starts, Task, checked_actions
from deadreckon.versions import installed

PREFIX = "carla:"
TIMEOUT = 20.0  # s that a server may take for an answer; loading a map can take most of it
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]{0,251}[A-Za-z0-9])?")
_HOW = "write carla:HOST:PORT/lane or carla:HOST:PORT/town, such as carla:localhost:2000/lane"
_HORIZONS = {"lane": 250, "town": 1000}  # steps: D4RL's
_SAID = {"lane": "drive by a camera along a figure eight", "town": "drive by a camera through a town with other cars"}
# d4rl/carla/__init__.py: what random actions and the log's policy gave in its own servers.
_PUBLISHED = {"lane": (-0.8503839912088142, 1023.5784385429523), "town": (-114.81579500772153, 2440.1772022247314)}


@dataclass(frozen=True, kw_only=True)
class CarlaTask(Task):
    """A task whose simulator is CARLA servers.

    Attributes:
        servers: host and port of each, all different.
        scene: `lane` or `town`.
        timeout: s that a server may take for an answer.
    """

    servers: tuple[tuple[str, int], ...]
    scene: str
    timeout: float = TIMEOUT

    @property
    def most_copies(self) -> int:
        """See `Task.most_copies`: one a server."""
        return len(self.servers)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "CarlaCopies":
        """One server for each seed; see `Task.simulate`.

        Raises:
            UserError: there are more seeds than servers, or a server cannot be used.
        """
        return CarlaCopies(self, seeds)

    @property
    def versions(self) -> Mapping[str, str]:
        """See `Task.versions`: of the client, which a server's is the same as."""
        return installed("carla")


def named(name: str) -> CarlaTask:
    """The task of a name; nothing is asked of its servers yet.

    Raises:
        UserError: it is not written so, or a host or port cannot be one.
    """
    path, _, text = name.partition("?")
    servers, slash, scene = path.removeprefix(PREFIX).partition("/")
    if not slash:
        raise UserError(f"task {name}: {_HOW}")
    if scene not in SCENES:
        raise unknown("scene of a CARLA server", scene, SCENES)
    found = tuple(_server(name, each) for each in servers.split(","))
    if len(set(found)) < len(found):
        raise UserError(f"task {name}: a server is named twice, and each is one copy")
    options = options_of(name, text)
    timeout = options.pop("timeout", TIMEOUT)
    if options:
        raise unknown("option of a CARLA server", next(iter(options)), ["timeout"])
    if isinstance(timeout, bool) or not isinstance(timeout, int | float) or not 0.1 <= timeout <= 3600:
        raise UserError(f"task {name}: timeout must be 0.1 to 3600 seconds, got {timeout}")
    return CarlaTask(
        name=name, domain="carla", horizon=_HORIZONS[scene], observation_shape=(SIZE, SIZE, 3), observation_dtype="uint8",
        places_matter=True,
        action_space=Box((-1.0, -1.0), (1.0, 1.0)), gym_id="", reference=None,
        published=Reference(*_PUBLISHED[scene], "D4RL's, measured in its own servers"), summary=_SAID[scene],
        properties=("realistic", "partial observability", "high-dimensional"), servers=found,
        scene=scene, timeout=float(timeout),
    )  # fmt: skip


def _server(name: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not _HOST.fullmatch(host):
        said = f"{host!r} is no host (letters, digits, dots and hyphens)" if host else "a host or a port is missing"
        raise UserError(f"task {name}: {said}; {_HOW}")
    if not re.fullmatch(r"[0-9]{1,5}", port) or not 1 <= int(port) <= 65535:
        raise UserError(f"task {name}: the port must be a number from 1 to 65535, got {port!r}; {_HOW}")
    return host, int(port)


class CarlaCopies:
    """A `Simulator` of servers. Whatever ends it, the servers are left as they were found, except for the map."""

    def __init__(self, task: CarlaTask, seeds: Sequence[int]):
        self.task, copies = task, len(seeds)
        if copies > len(task.servers):
            servers = "its server is one" if len(task.servers) == 1 else f"its {len(task.servers)} servers are one each"
            ways = "name as many, carla:HOST:PORT,HOST:PORT/..., or ask for fewer (evaluations run in turns)"
            raise UserError(f"{task.name}: {copies} copies are asked for, and {servers}; {ways}")
        self._scenes = [SCENES[task.scene]() for _ in seeds]
        self._starts = Starts(seeds, self._scenes[0].draw)
        self._seen = np.zeros((copies, *task.observation_shape), np.uint8)
        self._age, self._alive = np.zeros(copies, int), np.zeros(copies, bool)
        self._servers = [Server(host, port, task.timeout) for host, port in task.servers[:copies]]
        self._end = weakref.finalize(self, _close, self._servers)  # also when the process ends
        self._of_each(range(copies), lambda i: self._servers[i].open(self._scenes[i].load))

    def _of_each(self, which: Sequence[int], do: Callable[[int], Any]) -> list[Any]:
        """What `do` gives for each copy, of several servers at the same time; closes all servers where one fails."""
        if not self._end.alive:
            raise UserError(f"{self.task.name}: the simulator has been closed")
        try:
            if len(which) < 2:
                return [do(i) for i in which]
            with ThreadPoolExecutor(len(which)) as pool:
                return list(pool.map(do, which))
        except BaseException:
            self.close()
            raise

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`. Cars and sensors of the last ones are removed first."""
        which, drawn = self._starts.begun(which, seeds)
        starts = dict(zip(which.tolist(), drawn))

        def begin(i: int) -> np.ndarray:
            self._scenes[i].begin(self._servers[i], starts[i])
            return self._servers[i].settle()

        for i, picture in zip(starts, self._of_each(list(starts), begin)):
            self._seen[i] = picture
        self._age[which], self._alive[which] = 0, True
        return self._seen[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, 2) actions; see `Simulator.step`. The clock of a server whose episode is over stands still."""
        copies, running = len(self._age), np.flatnonzero(self._alive).tolist()
        actions = np.clip(checked_actions(actions, (copies, 2), self.task.name, np.flatnonzero(self._alive)), -1.0, 1.0)
        rewards, terminals = np.zeros(copies), np.zeros(copies, bool)

        def advance(i: int) -> tuple[np.ndarray, float, bool]:
            self._servers[i].act(float(actions[i, 0]), float(actions[i, 1]))
            return self._servers[i].step(), *self._scenes[i].judge(self._servers[i])

        for i, (picture, reward, over) in zip(running, self._of_each(running, advance)):
            self._seen[i], rewards[i], terminals[i] = picture, reward, over
        self._age += self._alive
        timeouts = self._alive & ~terminals & (self._age >= self.task.horizon)
        self._alive &= ~(terminals | timeouts)
        return self._seen.copy(), rewards, terminals, timeouts

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`. What a server holds is left out: nothing takes a world with its cars back to a moment."""
        return {"alive": self._alive.copy(), **self._starts.state()}

    def restore(self, state: dict[str, np.ndarray]) -> np.ndarray | None:
        """See `Simulator.restore`.

        Returns:
            Copies whose episode was under way: a server cannot take it up again.
        """
        self._starts.restore(state)
        self._alive[:] = False
        lost = np.flatnonzero(state["alive"])
        return lost if len(lost) else None

    def close(self) -> None:
        """Leaves the servers, as losing the simulator does."""
        self._end()


def _close(servers: Sequence[Server]) -> None:
    """Leaves all of them, also if leaving one fails."""
    if servers:
        try:
            servers[0].close()
        finally:
            _close(servers[1:])
