"""Programs on this machine: processes that stay, each on cores of its own, and another one where one dies."""

import contextlib
import math
import multiprocessing
import os
import signal
import time
import warnings
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from deadreckon import interrupts
from deadreckon.bench.executor import Event, Work, attempt
from deadreckon.bench.idle import give_way, is_measured, stand_still
from deadreckon.bench.jobs import Program
from deadreckon.bench.work import perform
from deadreckon.errors import UserError
from deadreckon.versions import cores

POLL = 1.0  # seconds between two looks whether somebody measures
MERCY = 5.0  # seconds within which a process that is to end may bring its chunk to disk


def shares(workers: int | None, accelerator: bool) -> list[list[int]]:
    """The cores of each worker: where None says how many, one core each on a CPU, and one worker with all of them for a GPU.

    All have as many, because how many threads there are decides the last bits.
    """
    own = cores()
    workers = workers or (1 if accelerator else len(own))
    each = max(len(own) // workers, 1)
    return [[own[(i * each + k) % len(own)] for k in range(each)] for i in range(workers)]


class Local:
    """Processes on this machine, made when the first program needs them.

    On a CPU lanes of one program are no faster than one after another, and a program on several cores is slower than one on
    each: so each seed of each setting is a program there. On a GPU they are lanes of one (`benchmarks/lanes.py` measures).

    Args:
        path: the store's folder.
        workers: processes; None: one per core, or one for a GPU.
        work: does a program.
        idle: take only the time that other processes leave, and stand still while one measures (`bench.idle`).

    Raises:
        UserError: fewer than one worker.
    """

    def __init__(self, path: Path, workers: int | None = None, work: Work = perform, idle: bool = False):
        import jax

        if workers is not None and workers < 1:
            raise UserError(f"workers must be 1 or more, got {workers}")
        accelerator = jax.default_backend() != "cpu"
        self.lanes = None if accelerator else 1
        self._idle, self._still = idle, False
        self._team = [_Worker(cores, path, work, idle) for cores in shares(workers, accelerator)]

    @property
    def workers(self) -> int:
        """Processes."""
        return len(self._team)

    @property
    def room(self) -> bool:
        """Whether a worker is idle."""
        return any(worker.program is None for worker in self._team)

    def begin(self, program: Program) -> None:
        """Gives the program to an idle worker."""
        next(worker for worker in self._team if worker.program is None).begin(program)

    def wait(self, timeout: float | None = None) -> Event | None:
        """Hears what a worker says, or that it has died; None where nobody says anything for so many seconds."""
        end = math.inf if timeout is None else time.monotonic() + timeout
        busy = {worker.pipe: worker for worker in self._team if worker.program is not None}
        while True:
            self._make_room()
            left = min(end - time.monotonic(), POLL if self._idle else math.inf)
            if heard := wait(list(busy), None if left == math.inf else max(left, 0.0)):
                return busy[heard[0]].hear()  # pyrefly: ignore[bad-index] - one of those that `wait` was given
            if time.monotonic() >= end:
                return None

    def _make_room(self) -> None:
        """Stops the processes while another one measures, and lets them go on afterwards."""
        if self._idle and ((still := is_measured()) or self._still):
            pids = [worker.process.pid for worker in self._team if worker.process is not None]
            stand_still([pid for pid in pids if pid is not None], still)
            self._still = still

    def close(self) -> None:
        """Ends them: idle ones by themselves, others at their next chunk, or by a kill where that takes longer than `MERCY`."""
        for worker in self._team:
            worker.stop()
        end = time.monotonic() + MERCY
        for worker in self._team:
            worker.end(end)


class _Worker:
    """A process that does one program after the other."""

    def __init__(self, cores: list[int], path: Path, work: Work, idle: bool):
        self.given = cores, path, work, idle
        self.program: Program | None = None
        self.process: SpawnProcess | None = None

    def begin(self, program: Program) -> None:
        self.program = program
        if self.process is None:
            self.pipe, theirs = multiprocessing.Pipe()
            self.process = SpawnProcess(target=_serve, args=(theirs, *self.given), daemon=True)
            self.process.start()
            theirs.close()
        with contextlib.suppress(OSError):  # it died while it was idle: `hear` finds out
            self.pipe.send(program)

    def hear(self) -> Event:
        assert self.program is not None
        assert self.process is not None
        program = self.program
        try:
            what, told = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            what, told = "died", f"code {self.process.exitcode}"
            self.process = None
        if what not in ("begun", "progress"):
            self.program = None
        return Event(what, program, told)

    def stop(self) -> None:
        """Lets the process end: a busy one at its next chunk, of which it tells in vain, an idle one at once."""
        if self.process is None:
            return
        if self.program is not None:
            self.process.terminate()
        else:
            self.pipe.close()

    def end(self, latest: float) -> None:
        """Waits until a stopped process has ended, and kills it where it lives at the time `latest`."""
        if self.process is None:
            return
        self.process.join(timeout=max(latest - time.monotonic(), 0.0))
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.pipe.close()


def _serve(pipe: Connection, cores: list[int], path: Path, work: Work, idle: bool) -> None:
    """The process: on its cores, one program after the other until the pipe is closed."""
    if idle:
        give_way()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)  # before anything starts threads
    warnings.formatwarning = lambda message, *_, **__: f"deadreckon: warning: {message}\n"  # as the command shows its own
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's goes to the command too, which ends this process
    listening = interrupts.listening(lambda number: None, (signal.SIGTERM,))
    # Nobody listens any more, or all shall end: it is resumed from what is on disk.
    try:
        with contextlib.suppress(EOFError, OSError, KeyboardInterrupt), listening:
            while True:
                program: Program = pipe.recv()
                pipe.send(("begun", None))
                pipe.send(attempt(program, path, work, lambda done, total: pipe.send(("progress", (done, total)))))
    except MemoryError:  # outside a program, which tells of its own: the command tells that this process has ended
        raise SystemExit(1) from None
