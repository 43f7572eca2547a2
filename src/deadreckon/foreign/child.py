"""Asks a process of its own to read a file, within limits of memory and time, and takes its arrays over uncopied."""

import atexit
import contextlib
import json
import mmap
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError
from deadreckon.foreign.limits import LIMITS, RATE, SECONDS, UNPACKED, max_unpacked
from deadreckon.foreign.reader import HEAD, SPARE, TASKS

_PROGRAM = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from deadreckon.foreign.reader import main; main({})"
_lock = threading.Lock()


class _Hung(Exception):
    """The process has been silent for too long."""


class _Killed(Exception):
    """The process was killed by a signal that none of its libraries sends."""


class _Child:
    """The process, and this end of its socket."""

    def __init__(self):
        ours, theirs = socket.socketpair()
        with theirs:
            handle = theirs.fileno()
            # No plugins of HDF5, which are code; and as few threads as will do.
            own = {"HDF5_PLUGIN_PRELOAD": "::", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
            self.process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _PROGRAM.format(handle), json.dumps(sys.path)],
                env=os.environ | own, pass_fds=(handle,), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )  # fmt: skip
        self.socket, self.owner = ours, os.getpid()

    def ask(self, request: dict[str, Any], silence: float) -> tuple[dict[str, Any], Any]:
        """The answer to a request, and the mapped bytes of its arrays.

        Raises:
            _Hung: nothing came for `silence` seconds.
            EOFError, OSError: the process has died.
        """
        self.socket.sendall(json.dumps(request).encode() + b"\n")
        while not (size := int.from_bytes(self._take(HEAD, silence), "big")):
            pass
        self._wait(silence)
        first, handles, _, _ = socket.recv_fds(self.socket, 1, 1)
        try:
            data = first + self._take(size - 1, silence)
            answer = json.loads(data)
            if not answer.get("size"):
                return answer, b""
            # Private, so that arrays may be written to as any others.
            return answer, mmap.mmap(handles[0], answer["size"], flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ | mmap.PROT_WRITE)
        finally:
            for handle in handles:
                os.close(handle)

    def _take(self, count: int, silence: float) -> bytes:
        data = bytearray()
        while len(data) < count:
            self._wait(silence)
            part = self.socket.recv(min(count - len(data), 1 << 20))
            if not part:
                raise EOFError
            data += part
        return bytes(data)

    def _wait(self, silence: float) -> None:
        until = time.monotonic() + silence
        while not select.select([self.socket], [], [], max(min(until - time.monotonic(), 5.0), 0.0))[0]:
            if time.monotonic() >= until:
                raise _Hung

    def ended(self) -> int | None:
        """How a process that has closed its socket ended by itself; None where it lives on."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(1.0)
        return None

    def end(self) -> int:
        """Ends the process, if it is ours; gives how it ended."""
        self.socket.close()
        if self.owner != os.getpid():  # of a parent that was forked
            return 0
        self.process.kill()
        return self.process.wait()


_child: _Child | None = None


def read_apart(task: str, path: Path | str, kind: str, *, size: int, **arguments: Any) -> Any:
    """What a reader of `reader.TASKS` makes of a file, in a process that is kept for the next one.

    It costs 0.2 seconds the first time and a millisecond after that; arrays are handed over through shared memory.

    Args:
        task: name of the reader.
        path: of the file, for errors.
        kind: what the file should be, in words, for errors.
        size: bytes of all files that are read, from which the limits of memory and time follow.
        **arguments: of the reader, as JSON values.

    Raises:
        UserError: the file was refused or is damaged; reading it hung, crashed or took too much memory.
    """
    assert task in TASKS
    most, silence = max_unpacked(size), SECONDS.value + size / RATE
    request = {
        "task": task, "arguments": arguments, "memory": int(2 * most) + SPARE, "folder": _folder(),
        "limits": {each.variable: os.environ.get(each.variable) for each in LIMITS},
    }  # fmt: skip
    with _lock:
        try:
            answer, memory = _asked(request, silence, path, kind)
        except _Killed:  # by somebody else, who meant this process no harm or was short of memory for a moment
            try:
                answer, memory = _asked(request, silence, path, kind)
            except _Killed as error:
                raise UserError(
                    f"{path}: cannot be read as {kind}: the process that reads it was killed twice (SIGKILL), "
                    "as the system does where memory runs out"
                ) from error
    if "refused" in answer:
        raise UserError(answer["refused"])
    if "broken" in answer:
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged or cut short ({answer['broken']})")
    from deadreckon.foreign.parcel import unpack

    return unpack(answer["nodes"], memory)


def _asked(request: dict[str, Any], silence: float, path: Path | str, kind: str) -> tuple[dict[str, Any], Any]:
    """The answer of the process, which is started where there is none.

    Raises:
        _Killed: the process was killed from outside.
        UserError: it cannot be started; reading hung, crashed or took too much memory.
    """
    global _child
    if _child is None or _child.owner != os.getpid() or _child.process.poll() is not None:
        if _child is not None:
            _child.end()
        try:
            _child = _Child()
        except OSError as error:
            why = error.strerror or str(error)
            raise UserError(f"{path}: no process can be started to read it ({why}); {kind} is read by one") from error
    try:
        return _child.ask(request, silence)
    except _Hung as error:
        _drop()
        raise UserError(
            f"{path}: reading it as {kind} has not ended after {silence:.0f} s, it is damaged or made to hang; "
            f"{SECONDS.variable} sets another limit"
        ) from error
    except (EOFError, BrokenPipeError, ConnectionResetError) as error:
        code = _child.ended()
        _drop()
        if code == -signal.SIGKILL:
            raise _Killed from error
        why = f"it is damaged: the library that reads it crashed ({code})"
        if code == -signal.SIGABRT:  # as libraries end that find no memory, in Rust and in C++
            why = f"it is damaged, or needs more memory than a file of its size may take; {UNPACKED.variable} sets more"
        raise UserError(f"{path}: cannot be read as {kind}, {why}") from error
    except (OSError, ValueError) as error:  # of this process, such as no memory to map; or of an answer that is none
        _drop()
        if isinstance(error, OSError):
            raise UserError(f"{path}: cannot be read as {kind}: {error.strerror or error}") from error
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged: what its library told is no answer") from error
    except BaseException:  # such as the user's interrupt, after which the answer would be taken for the next one's
        _drop()
        raise


def _folder() -> str:
    """The folder at which relative paths begin; that of the system where it has been removed."""
    try:
        return os.getcwd()
    except OSError:
        return os.sep


def _drop() -> int:
    """Ends the process; the next request begins another."""
    global _child
    child, _child = _child, None
    return 0 if child is None else child.end()


atexit.register(_drop)
