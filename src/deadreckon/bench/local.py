"""Jobs on this machine: processes that stay, each on cores of its own, and another one where one dies."""

import contextlib
import multiprocessing
import os
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

from deadreckon.bench.plan import Job, code
from deadreckon.bench.store import Store

TRIES = 3  # of a job whose process dies; what went on until then is on disk and is not done again


class Event(NamedTuple):
    """What happens to a job: `begun`, `progress` (done, total), `done`, `failed` (why) or `died` (and is begun again)."""

    what: str
    job: Job
    told: Any = None


Told = Callable[[Event], None]


def shares(workers: int | None) -> list[list[int]]:
    """The cores of each worker: one core each on a CPU, where a program of several lanes is no faster on more.

    A GPU has one worker with all cores: there seeds are lanes of one program.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    if workers is None:
        import jax

        workers = 1 if jax.default_backend() != "cpu" else len(cores)
    return [cores[i::workers] or [cores[i % len(cores)]] for i in range(workers)]


def run(suite: str, jobs: Sequence[Job], store: Store, told: Told, workers: int | None = None) -> None:
    """Does what is not done yet, and keeps results as they come. A job that fails is noted, and the others go on.

    Args:
        suite: name of the suite.
        jobs: all of it.
        store: where results lie.
        told: called with what happens.
        workers: processes; None: one a core, or one for a GPU.
    """
    waiting = store.undone(jobs)
    tries = dict.fromkeys((job.name for job in waiting), 0)
    team = [_Worker(cores, store.path) for cores in shares(workers)[: len(waiting)]]
    try:
        for worker in team:
            worker.begin(waiting.pop(0), told)
        while busy := [worker for worker in team if worker.job is not None]:
            for ready in wait([worker.pipe for worker in busy]):
                worker = next(w for w in busy if w.pipe is ready)
                job = worker.job
                assert job is not None
                event = worker.hear()
                if event.what == "progress":
                    told(event)
                    continue
                worker.job = None
                if event.what == "died":
                    tries[job.name] += 1
                    worker.start()
                    if tries[job.name] < TRIES:
                        told(event)
                        waiting.insert(0, job)
                    else:
                        event = Event("failed", job, (f"its process died {TRIES} times, the last with code {event.told}", ""))
                if event.what == "done":
                    found, made_by = event.told
                    event = event._replace(told=found)
                    if made_by != code():  # under its name lie results of that code alone
                        event = Event("failed", job, ("the package's source was changed while it ran; run it again", ""))
                if event.what == "done":
                    store.keep(suite, job, event.told)
                    told(event)
                elif event.what == "failed":
                    store.fail(job, *event.told)
                    told(event)
                if waiting:
                    worker.begin(waiting.pop(0), told)
    finally:
        for worker in team:
            worker.end()


class _Worker:
    """A process that does one job after the other."""

    def __init__(self, cores: list[int], path: Path):
        self.cores, self.path = cores, path
        self.job: Job | None = None
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.cores, self.path), daemon=True)
        self.process.start()
        theirs.close()

    def begin(self, job: Job, told: Told) -> None:
        self.job = job
        told(Event("begun", job))
        with contextlib.suppress(OSError):  # it died while it was idle: `hear` finds out
            self.pipe.send(job)

    def hear(self) -> Event:
        assert self.job is not None
        try:
            what, told = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            return Event("died", self.job, self.process.exitcode)
        return Event(what, self.job, told)

    def end(self) -> None:
        self.pipe.close()
        self.process.join(timeout=0 if self.job is not None else 5)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _serve(pipe: Connection, cores: list[int], path: Path) -> None:
    """The process: on its cores, job after job until the pipe is closed."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)  # before anything starts threads
    from deadreckon.bench.work import perform
    from deadreckon.errors import UserError
    from deadreckon.files import alone

    store = Store(path)
    while True:
        try:
            job: Job = pipe.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            with alone(store.run(job)):  # of all that write to this folder
                found = perform(job, store.run(job), lambda done, total: pipe.send(("progress", (done, total))))
            answer: Any = ("done", (found, code()))
        except BrokenPipeError:
            return  # nobody listens any more; what is on disk is gone on with
        except UserError as error:
            answer = ("failed", (str(error), ""))
        except Exception as error:  # noqa: BLE001 - told in the list of failures, with its trace; the other jobs go on
            answer = ("failed", (f"{type(error).__name__}: {error}", traceback.format_exc()))
        try:
            pipe.send(answer)
        except OSError:
            return
