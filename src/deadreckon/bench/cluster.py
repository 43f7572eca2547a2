"""Programs on a Ray cluster: tasks that hold cores of their own, and are given to another process where theirs is lost."""

import logging
import math
import os
import tempfile
import time
from collections import deque
from pathlib import Path
from typing import Any, BinaryIO

from deadreckon.bench.executor import Event, Work, attempt
from deadreckon.bench.jobs import Program
from deadreckon.bench.work import perform
from deadreckon.errors import UserError, extra

POLL = 0.2  # seconds between two looks at what tasks tell


class Cluster:
    """A Ray cluster, or a local one made for the purpose.

    Results come back to this process, so `path` need not be shared. Where all nodes see it under the same name, one whose
    node is lost goes on elsewhere from its last checkpoint, and pages can be made; otherwise it is begun anew there.

    Args:
        path: the store's folder; run folders lie in it on every node.
        address: of the cluster; None: `RAY_ADDRESS`, or the one that runs on this machine, else a new one.
        cpus: cores of a program, which it has for itself.
        gpus: of a program; a fraction where several share one.
        work: does a program.

    Raises:
        UserError: Ray is missing, there is no such cluster, or none of its nodes has as much.
    """

    def __init__(self, path: Path, address: str | None = None, cpus: int = 1, gpus: float = 0.0, work: Work = perform):
        try:
            import ray
        except ImportError as error:
            raise UserError(f"--executor ray needs Ray; {extra('ray')}") from error
        if cpus < 1 or gpus < 0:
            raise UserError(f"a job takes 1 or more cpus and 0 or more gpus, got {cpus} and {gpus:g}")
        self._ray: Any = ray  # most of its functions are made by decorators that types do not follow
        self._path, self._work = path.absolute(), work
        self.lanes = None if gpus else 1  # see `Local`
        self._news: deque[Event] = deque()
        self._running: dict[Any, Program] = {}
        self._names: dict[str, Program] = {}
        self._own = not ray.is_initialized()
        if self._own:
            try:
                self._ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
            except Exception as error:
                # Ray raises plain exceptions, too, as where a node does not start in time; other kinds are mistakes.
                if not isinstance(error, ConnectionError | ValueError | RuntimeError) and type(error) is not Exception:
                    raise
                where, (why, *_) = address or "this machine", str(error).strip().splitlines() or [type(error).__name__]
                raise UserError(f"cannot join a Ray cluster at {where}: {why}") from error
        try:
            self.workers = self._places(cpus, gpus)
        except UserError:
            self.close()
            raise
        self._inbox: Any = self._ray.remote(_Inbox).options(num_cpus=0, max_restarts=-1).remote()
        # Ray's own retries are off: `run` counts, so that a lost process is told of, and a program that kills it is given up.
        self._task = self._ray.remote(_task).options(num_cpus=cpus, num_gpus=gpus, max_retries=0)
        self._holds = cpus, gpus

    def _places(self, cpus: int, gpus: float) -> int:
        """How many programs fit side by side."""
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        asked = {what: count for what, count in (("CPU", cpus), ("GPU", gpus)) if count}
        fits = [int(min(node.get(what, 0.0) / count for what, count in asked.items())) for node in nodes]
        if not any(fits):
            has = ", ".join(f"{node.get('CPU', 0):g} and {node.get('GPU', 0):g}" for node in nodes)
            raise UserError(f"a job takes {cpus} cpus and {gpus:g} gpus, but no node of the cluster has them: they have {has}")
        return sum(fits)

    @property
    def room(self) -> bool:
        """Ray keeps what waits."""
        return True

    def begin(self, program: Program) -> None:
        """Hands the program to the cluster."""
        given = program, self._path, self._work, self._inbox, Path.cwd(), *self._holds
        self._running[self._task.remote(*given)] = program
        self._names[program.name] = program

    def wait(self, timeout: float | None = None) -> Event | None:
        """What tasks tell as they go, or the end of one; None where nothing happens for so many seconds."""
        end = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            if self._news:
                return self._news.popleft()
            if time.monotonic() >= end:
                return None
            ended, _ = self._ray.wait(list(self._running), timeout=POLL)
            self._news.extend(self._told())
            for task in ended:
                program = self._running.pop(task)
                del self._names[program.name]
                self._news.append(Event(*self._end(task, program)))

    def _told(self) -> list[Event]:
        try:
            said = self._ray.get(self._inbox.take.remote())
        except self._ray.exceptions.RayActorError:  # it was killed, and is made again; nothing is lost but a line of progress
            return []
        return [Event(what, self._names[name], told) for name, what, told in said if name in self._names]

    def _end(self, task: Any, program: Program) -> tuple[str, Program, Any]:
        errors = self._ray.exceptions
        try:
            what, told = self._ray.get(task)
        except errors.RayTaskError as error:  # before or after the job itself, such as a node without the package
            return "failed", program, (str(error).strip().splitlines()[-1], str(error))
        except errors.RayError as error:  # its process, its node, memory: all that is not the job's own doing
            return "died", program, str(error).splitlines()[0]
        return what, program, told

    def close(self) -> None:
        """Stops what runs, and leaves the cluster; one that was made here ends."""
        for task in self._running:
            self._ray.cancel(task, force=True)
        if self._own:
            self._ray.shutdown()


class _Inbox:
    """Keeps what tasks say until it is asked for."""

    def __init__(self):
        self._said: list[tuple[str, str, Any]] = []

    def tell(self, *said: Any) -> None:
        self._said.append(said)

    def take(self) -> list[tuple[str, str, Any]]:
        said, self._said = self._said, []
        return said


def _task(
    program: Program, path: Path, work: Work, inbox: Any, where: Path, cpus: int, gpus: float
) -> tuple[str, Any]:
    """In a process of Ray's, which does one task after the other; `where` is what relative names of logs are relative to."""
    _pin(cpus)
    if not gpus:
        os.environ.setdefault("JAX_PLATFORMS", "cpu")  # Ray leaves all GPUs in sight of a task that asked for none
    elif gpus < 1:
        os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", f"{0.9 * gpus:.2f}")  # JAX takes three quarters otherwise
    if where.is_dir():
        os.chdir(where)
    inbox.tell.remote(program.name, "begun", None)
    return attempt(program, path, work, lambda done, total: inbox.tell.remote(program.name, "progress", (done, total)))


_held: list[BinaryIO] | None = None  # locks of this process's cores


def _pin(count: int) -> None:
    """Keeps this process, for all its life, to cores that no other one of ours on this machine has, as `Local` does.

    Thread pools are as large as the cores they see when they start, and that decides the last bits of sums.
    """
    global _held
    if _held is not None or not hasattr(os, "sched_setaffinity"):
        return
    import fcntl

    folder = Path(tempfile.gettempdir()) / f"deadreckon-cores-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    _held, mine, cores = [], [], sorted(os.sched_getaffinity(0))
    for core in cores:
        if len(mine) == count:
            break
        lock = open(folder / str(core), "ab")  # noqa: SIM115 - held until the process ends, and freed by the system then
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        mine.append(core)
        _held.append(lock)
    # More processes than cores, as where several nodes are one machine: as many cores as asked for, whoever has them.
    first = os.getpid() % len(cores)
    others = [core for core in cores[first:] + cores[:first] if core not in mine]
    os.sched_setaffinity(0, mine + others[: count - len(mine)])
