"""Jobs until all are done, wherever they run: what an executor is, and what becomes of a program that fails or is lost."""

import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from deadreckon.bench.jobs import Job, Program, programs
from deadreckon.bench.store import JobResult, Store
from deadreckon.errors import BusyError, UserError
from deadreckon.files import alone
from deadreckon.progress import Progress

TRIES = 3  # of a program whose process dies; what went on until then is on disk and is not done again


class Event(NamedTuple):
    """What happens to a program: `begun`, `progress` (done, total), `done` (what was found, one per job), `failed` (why),
    `elsewhere` (another command is at it), `skipped` (another command has done it since), `split` (it failed for a reason, and
    its jobs, or its only job's seeds, go on one by one) or `died` (and is begun again)."""

    what: str
    program: Program
    payload: Any = None


OnEvent = Callable[[Event], None]
# Which of the waiting programs is begun with so many seconds left (None: no end); None: none of them, even if there is room.
Choice = Callable[[Sequence[Program], float | None], Program | None]
# `bench.work.perform`, which finds something of each job; a module's function, so that it travels.
Work = Callable[[Program, Path, Progress], list[JobResult]]


class Executor(Protocol):
    """Where programs run, each in a process that may die."""

    @property
    def workers(self) -> int:
        """How many programs run side by side."""
        ...

    @property
    def lanes(self) -> int | None:
        """Cells of one program at most, where a suite does not say; None: see `plan`."""
        ...

    @property
    def room(self) -> bool:
        """Whether it takes another program now."""
        ...

    def begin(self, program: Program) -> None:
        """Takes a program; returns at once."""
        ...

    def wait(self, timeout: float | None = None) -> Event | None:
        """The next thing that happens to a program that it has taken: `done` tells what was found.

        Args:
            timeout: seconds after which it is None where nothing happens; None: it waits.
        """
        ...

    def close(self) -> None:
        """Ends all processes, whatever they do."""
        ...


def _next(waiting: Sequence[Program], left: float | None) -> Program | None:
    """The first of them."""
    return waiting[0]


def run(
    jobs: Sequence[Job],
    store: Store,
    on_event: OnEvent,
    executor: Executor,
    seconds: float | None = None,
    choice: Choice = _next,
) -> None:
    """Does what is not done yet, and keeps results as they come. A program that fails is noted, and the others go on.

    What another command is doing in the same folder, or has done since this one began, is told and left to it.

    Args:
        jobs: of a suite or several, in the order in which they are begun.
        store: where results lie.
        on_event: called with every event.
        executor: who does it; closed at the end.
        seconds: after which it ends; programs that are not done then go on from their last checkpoint another time.
        choice: which program is begun next; where it begins none while none runs, this ends.
    """
    end = None if seconds is None else time.monotonic() + seconds
    with closing(executor):
        waiting, lost, running = deque(programs(store.undone(jobs))), Counter[str](), 0
        while waiting or running:
            over = end is not None and time.monotonic() >= end  # what has been found until then is kept, and nothing begun
            while waiting and executor.room and not over:
                chosen = choice(waiting, None if end is None else end - time.monotonic())
                if chosen is None:
                    break
                waiting.remove(chosen)
                if not store.undone(chosen.jobs):
                    on_event(Event("skipped", chosen))
                    continue
                executor.begin(chosen)
                running += 1
            if not running:
                return
            event = executor.wait(None if end is None else max(end - time.monotonic(), 0.0))
            if event is None and over:
                return
            if event is None:
                continue
            if event.what in ("begun", "progress"):
                on_event(event)
                continue
            running -= 1
            event = _judged(event, lost)
            if event.what == "failed" and len(event.program.parts) > 1:
                # Settings that are refused, a seed that diverged, or too many for the memory, must not take others with them.
                waiting.extend(event.program.parts)
                event = Event("split", event.program, event.payload[0])
            elif event.what == "died":
                waiting.appendleft(event.program)
            elif event.what == "failed":
                for job in event.program.jobs:
                    store.fail(job, *event.payload)
            elif event.what == "done":
                for job, found in zip(event.program.jobs, event.payload, strict=True):
                    store.keep(job, found, event.program.run(job))
            on_event(event)


def _judged(event: Event, lost: Counter[str]) -> Event:
    """An end as it counts: too many deaths are a failure."""
    if event.what == "died":
        lost[event.program.name] += 1
        if lost[event.program.name] >= TRIES:
            return Event("failed", event.program, (f"its process died {TRIES} times, the last with {event.payload}", ""))
    return event


def attempt(program: Program, path: Path, work: Work, watch: Progress) -> tuple[str, Any]:
    """In a worker: does a program, and says how it ended: `done`, `failed` or `elsewhere`, and what goes with it.

    Args:
        program: the program.
        path: the store's folder.
        work: does it.
        watch: called as it goes; its `BrokenPipeError` passes, because then nobody listens.
    """
    folder = Store(path).folder(program)
    try:
        with alone(folder):  # of all that write to it
            return "done", work(program, folder, watch)
    except BusyError:
        return "elsewhere", None
    except BrokenPipeError:
        raise
    except UserError as error:
        return "failed", (str(error), "")
    except Exception as error:  # noqa: BLE001 - told in the list of failures, with its trace; the other jobs go on
        return "failed", (f"{type(error).__name__}: {error}", traceback.format_exc())
