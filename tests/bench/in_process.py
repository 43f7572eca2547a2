"""An executor for tests in which the process is not what is tested: a new one takes seconds to import JAX."""

from pathlib import Path

from deadreckon.bench.executor import Event, Work, attempt
from deadreckon.bench.jobs import Program
from deadreckon.bench.work import perform
from deadreckon.progress import unwatched


class InProcess:
    """Programs in this process, one after another; otherwise as `bench.local.Local` with one worker."""

    workers = lanes = 1

    def __init__(self, path: Path, workers: int | None = 1, work: Work = perform):
        self._path, self._work, self._taken = path, work, []

    @property
    def room(self) -> bool:
        return not self._taken

    def begin(self, program: Program) -> None:
        self._taken.append(program)

    def wait(self, timeout: float | None = None) -> Event | None:
        if not self._taken:
            return None
        program = self._taken.pop()
        what, found = attempt(program, self._path, self._work, unwatched)
        return Event(what, program, found)

    def close(self) -> None:
        pass
