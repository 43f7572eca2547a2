"""Commands as processes that can be killed, begun by a fork of one that has imported everything.

Importing JAX and the package takes seconds, in which a kill can do no harm. So this process imports them once, and every
command is a fork of it: a process of its own, with its own threads, devices and files, that the system kills like any other.
A fork copies one thread alone, and locks that others hold stay locked for ever; so it is refused where there is more than one.
JAX starts its threads when it first computes, which this process never does.
"""

import contextlib
import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ENVIRONMENT = {  # of all commands; small programs that compile fast, and no thread before the fork
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PLATFORMS": "cpu",
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MUJOCO_GL": "disabled",
    "PYTHONDONTWRITEBYTECODE": "1",
}  # fmt: skip


def warm() -> None:
    """Imports what commands import, and starts nothing."""
    for name in (
        "jax", "jax.numpy", "optax", "equinox", "mujoco", "gymnasium", "h5py", "pyarrow.parquet", "pyarrow.csv",
        "deadreckon.cli.main", "deadreckon.cli.train", "deadreckon.cli.ope", "deadreckon.cli.bench", "deadreckon.cli.tune",
        "deadreckon.cli.design", "deadreckon.cli.recommend", "deadreckon.cli.collect", "deadreckon.cli.options",
        "deadreckon.runs.train", "deadreckon.runs.online", "deadreckon.runs.offline", "deadreckon.bench.work",
        "deadreckon.bench.plan", "deadreckon.bench.tables", "deadreckon.bench.local", "deadreckon.bench.tune",
        "deadreckon.collect", "deadreckon.collect.domains", "deadreckon.tasks.registry", "deadreckon.mbo.gp",
        "deadreckon.mbo.registry", "deadreckon.report", "deadreckon.report.design", "deadreckon.agents.td3_bc",
        "deadreckon.agents.sac", "deadreckon.agents.mbpo", "deadreckon.agents.bc", "deadreckon.ope.registry",
    ):  # fmt: skip
        __import__(name)


def threads(pid: int | str = "self") -> int:
    """How many threads a process has, but for jemalloc's (Arrow's allocator), which handles forks itself."""
    names = [Path(f"/proc/{pid}/task/{each}/comm").read_text() for each in os.listdir(f"/proc/{pid}/task")]
    return sum(not name.startswith("jemalloc_bg_thd") for name in names)


@dataclass
class Running:
    """A command that runs.

    Attributes:
        pid: of its process, which leads a group of its own.
        folder: that it runs in; what it says is beside it.
        code: exit code, negative for a signal; None while it runs.
    """

    pid: int
    folder: Path
    code: int | None = None

    def wait(self, seconds: float | None = None) -> int | None:
        """Its exit code; None where it still runs after so many seconds."""
        end = None if seconds is None else time.monotonic() + seconds
        pause = 0.001
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
            elif end is not None and time.monotonic() >= end:
                return None
            else:
                time.sleep(pause)
                pause = min(pause * 1.5, 0.02)
        return self.code

    def kill(self, number: int = signal.SIGKILL, whole: bool = False) -> None:
        """Sends a signal to the process, or to all of its group."""
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if whole else os.kill)(self.pid, number)

    def survivors(self) -> list[int]:
        """Processes of the group, or of this command's folder, that live though the command has ended."""
        found = []
        for each in Path("/proc").iterdir():
            if each.name.isdigit() and int(each.name) != self.pid:
                with contextlib.suppress(OSError):
                    if os.readlink(each / "cwd") == str(self.folder) and "State:\tZ" not in (each / "status").read_text():
                        found.append(int(each.name))
        return found

    def gone(self, seconds: float = 120.0) -> bool:
        """Waits until nothing of the command lives; whether that is so, within so many seconds. Then they are killed."""
        end = time.monotonic() + seconds
        while left := self.survivors():
            if time.monotonic() > end:
                for pid in left:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                return False
            time.sleep(0.02)
        return True

    def lines(self, which: str = "err") -> list[str]:
        """What it said on standard error, or on standard output (`out`)."""
        return said(self.folder, which).read_text(errors="replace").splitlines()


def said(folder: Path, which: str) -> Path:
    """Where a command in a folder says what it has to say: beside it, as the folder's disk may be full."""
    return folder.with_name(f"{folder.name}.{which}")


def begin(argv: Sequence[str], folder: Path, before: Callable[[], None] = lambda: None) -> Running:
    """Begins a command in a folder.

    Args:
        argv: after `deadreckon`.
        folder: that it runs in.
        before: called in the new process first, to limit or disturb it.

    Raises:
        RuntimeError: this process has threads.
    """
    folder = folder.resolve()
    if (count := threads()) > 1:
        raise RuntimeError(f"a fork of {count} threads may hang")
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX warns of forks after its threads have started, of which there are none
        pid = os.fork()
    if pid:
        return Running(pid, folder)
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        for number, name in ((1, "out"), (2, "err")):
            handle = os.open(said(folder, name), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(handle, number)
            os.close(handle)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        before()
        from deadreckon.cli.main import main

        code = main(list(argv))
    except SystemExit as error:  # as an interpreter ends
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException:  # noqa: BLE001 - what a user would see
        traceback.print_exc()
        code = 1
    finally:
        with contextlib.suppress(BaseException):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def run(argv: Sequence[str], folder: Path, seconds: float = 300.0, before: Callable[[], None] = lambda: None) -> Running:
    """Runs a command to its end; one that takes longer than so many seconds is killed, and has the code -9."""
    running = begin(argv, folder, before)
    if running.wait(seconds) is None:
        running.kill(whole=True)
        running.wait()
    return running


def apart(function: Callable[..., Any], *given: Any) -> Any:
    """What a function gives, of JSON's types, in a process of its own: Arrow starts threads where it reads a table."""
    ours, theirs = os.pipe()
    if not (pid := os.fork()):
        code = 1
        try:
            with open(theirs, "w") as pipe:
                json.dump(function(*given), pipe)
            code = 0
        except BaseException:  # noqa: BLE001 - told here, and by the exit code
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(theirs)
    with open(ours) as pipe:
        text = pipe.read()
    if os.waitpid(pid, 0)[1]:
        raise RuntimeError(f"{function.__name__} failed")
    return json.loads(text)


@contextlib.contextmanager
def private_mounts() -> Iterator[bool]:
    """File systems mounted from now on are seen by this process and its children alone; gives whether that is allowed."""
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    allowed = os.geteuid() == 0 and libc.unshare(0x00020000) == 0 and libc.mount(None, b"/", None, 0x4000 | 0x40000, None) == 0
    yield allowed


def mount(kind: str, source: str, place: Path, flags: int = 0, data: str = "") -> None:
    """mount(2).

    Raises:
        OSError: it failed.
    """
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(source.encode(), str(place).encode(), kind.encode(), flags, data.encode() or None):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(place))


def unmount(place: Path) -> None:
    """umount2(2), lazily: whatever still has a file open keeps it."""
    import ctypes

    ctypes.CDLL(None, use_errno=True).umount2(str(place).encode(), 2)


def memory(limit: int) -> Callable[[], None]:
    """What gives a new process so many bytes of addresses."""
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def at_operation(number: int, then: Callable[[], None]) -> Callable[[], None]:
    """What calls `then` at the `number`-th change of the file system that Python makes in the new process."""

    def install() -> None:
        left = [number]
        changes = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate", "os.chmod"}

        def hook(event: str, args: tuple) -> None:
            writes = event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if event in changes or writes:
                left[0] -= 1
                if left[0] == 0:
                    then()

        sys.addaudithook(hook)

    return install
