"""The process that reads formats whose libraries can hang or crash: one request after the other, until its parent ends.

It is started anew, not forked, because threads of JAX do not survive a fork; it has no handles but its socket.
"""

import contextlib
import importlib
import json
import os
import socket
import sys
import warnings
from typing import Any

from deadreckon.errors import UserError, as_one_line

# What may be asked for: the function of a request's name takes the request's arguments, and `Shared` for arrays.
TASKS = {
    "hdf5": "deadreckon.data.formats.hdf5_inside:contents",
    "pickle": "deadreckon.unpickle:inside",
    "excel": "deadreckon.data.formats.excel:contents",
    "minari": "deadreckon.data.formats.minari_inside:contents",
    "parquet": "deadreckon.foreign.parquet:columns_of",
    "arrow": "deadreckon.foreign.arrow:largest_batch",
}
HEAD = 8  # bytes before an answer that hold its length; 0: a sign of life
SPARE = 1 << 30  # bytes of memory beside what a file unpacks to
_socket: socket.socket | None = None


def alive() -> None:
    """Tells whoever waits that the work goes on; called between its parts. Does nothing in other processes."""
    if _socket is not None:
        _socket.sendall(bytes(HEAD))


def main(handle: int) -> None:
    """Answers requests until the other end is closed."""
    global _socket
    _socket = socket.socket(fileno=handle)
    requests = _socket.makefile("rb")
    for line in requests:
        request = json.loads(line)
        _limit(request.pop("memory"))
        with contextlib.suppress(OSError):  # of a folder that is gone, whose files are missing then
            os.chdir(request.pop("folder"))  # paths may be relative, and errors name them as they were given
        for name, value in request.pop("limits").items():  # which may be set since this process was started
            os.environ.pop(name, None)
            os.environ |= {} if value is None else {name: value}
        text, shared = _answer(request)
        data = json.dumps(text).encode()
        _socket.sendall(len(data).to_bytes(HEAD, "big"))
        handles = [] if shared is None else [shared.handle]
        socket.send_fds(_socket, [data[:1]], handles)  # with the first byte
        _socket.sendall(data[1:])
        if shared is not None:
            os.close(shared.handle)


def _answer(request: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """What becomes of a request, and where its arrays are."""
    from deadreckon.foreign.parcel import Shared, pack

    shared = Shared()
    try:
        module, _, name = TASKS[request["task"]].partition(":")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = getattr(importlib.import_module(module), name)(shared=shared, **request["arguments"])
        return {"nodes": pack(found, shared), "size": shared.size}, shared
    except UserError as error:
        os.close(shared.handle)
        return {"refused": str(error)}, None
    except MemoryError:
        os.close(shared.handle)
        return {"broken": "it needs more memory than a file of its size may take"}, None
    except Exception as error:  # noqa: BLE001 - whatever a library raises, the bytes are not what they should be
        os.close(shared.handle)
        return {"broken": as_one_line(error)}, None


def bound_memory(more: int) -> None:
    """Bounds what this process may take beyond what it has already to `more` bytes and a spare GB, where the system can.

    Does nothing in other processes.
    """
    if _socket is not None:
        _limit(more + SPARE)


def _limit(memory: int) -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    with open("/proc/self/statm") if os.path.exists("/proc/self/statm") else open(os.devnull) as file:
        pages = file.read().split()
    here = int(pages[0]) * resource.getpagesize() if pages else 1 << 32
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (here + memory if most < 0 else min(here + memory, most), most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


if __name__ == "__main__":
    main(int(sys.argv[1]))
