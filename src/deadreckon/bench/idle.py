"""Work that nobody waits for: processes that take the time that others leave, and stop while something is being timed."""

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Iterable
from pathlib import Path

from deadreckon.errors import BusyError
from deadreckon.files import alone, home

_PR_SET_PDEATHSIG = 1  # of prctl(2)


def _measuring() -> Path:
    return home() / "measuring"


def measuring() -> contextlib.AbstractContextManager[None]:
    """While it is held, idle processes on this machine stand still; for whoever measures times.

    Raises:
        BusyError: another process is measuring.
    """
    return alone(_measuring(), what="measurements on this machine")


def is_measured() -> bool:
    """Whether a process on this machine is measuring times."""
    lock = _measuring()
    if not lock.with_name(f".{lock.name}.lock").exists():
        return False
    try:
        with measuring():
            return False  # the file is one that a killed process left
    except BusyError:
        return True


def give_way() -> None:
    """Gives this process, and all that it starts, the lowest priority that the system knows. It ends with its parent.

    It gets a session of its own: Linux shares processors between sessions first, and priorities count within one.
    """
    if sys.platform != "linux":
        with contextlib.suppress(AttributeError):
            os.nice(19)
        return
    # Also when it stands still, which a parent that is killed cannot end.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    os.setsid()
    with contextlib.suppress(OSError):  # where the kernel does not group sessions
        Path("/proc/self/autogroup").write_text("19")
    os.nice(19)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def stand_still(processes: Iterable[int], still: bool) -> None:
    """Stops processes that `give_way`, with what they started, or lets them go on."""
    for pid in processes:
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.killpg(pid, signal.SIGSTOP if still else signal.SIGCONT)
