"""Temporary files and folders beside the place that they are written for, of which a killed process leaves none for long.

Whoever writes holds a lock of the system on its temporary file, and a kill frees the lock. So the next process that writes into
the folder knows which files nobody is writing any more, on whatever host and under whatever process number, and removes them.
Where the system or the file system has no such locks (Windows), nothing is removed.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

SUFFIX = ".deadreckon.tmp"  # which no other program gives to its files: they are never removed
_cleared: set[str] = set()  # folders that this process has looked through; what dies later is removed by later processes


@contextlib.contextmanager
def beside(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A new temporary file, or an empty folder, beside `path`, in a folder that exists; removed at the end, unless renamed.

    Raises:
        OSError: it cannot be made.
    """
    clear(path.parent)
    temporary, handle = _made(path, folder)
    try:
        yield temporary
    finally:
        if folder:
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
        if handle is not None:
            os.close(handle)


def clear(folder: Path) -> None:
    """Removes the temporary files and folders of dead processes from a folder, once in the life of this process."""
    if fcntl is None or (name := os.path.abspath(folder)) in _cleared:
        return
    _cleared.add(name)
    with contextlib.suppress(OSError):  # of a folder that cannot be read, whoever writes there will be told
        for entry in os.scandir(folder):
            if entry.name.endswith(SUFFIX) and entry.name.startswith("."):
                with contextlib.suppress(OSError):
                    _remove_dead(Path(entry.path))


def _made(path: Path, folder: bool) -> tuple[Path, int | None]:
    """A new file or folder, and what holds its lock."""
    while True:
        if folder:
            temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=SUFFIX, dir=path.parent))
            handle = None if fcntl is None else os.open(temporary, os.O_RDONLY)
        else:
            handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=SUFFIX, dir=path.parent)
            temporary = Path(name)
        if fcntl is None or handle is None:
            if handle is not None:
                os.close(handle)  # Windows renames no file that is open
            return temporary, None
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        if temporary.exists():
            return temporary, handle
        os.close(handle)  # it was taken for a dead process's before it was locked


def _remove_dead(temporary: Path) -> None:
    """Removes a temporary file or folder that nobody writes.

    Raises:
        OSError: somebody does, or it cannot be removed.
    """
    assert fcntl is not None
    handle = os.open(temporary, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if temporary.is_dir():
            shutil.rmtree(temporary)
        else:
            temporary.unlink()
    finally:
        os.close(handle)


def put(folder: Path, path: Path) -> None:
    """Renames a folder to `path`. What was there goes when that is done, and comes back where it fails.

    A kill between two of its steps leaves what was there beside `path`, from where `recover` takes it back.

    Raises:
        OSError: it cannot be renamed.
    """
    if not path.exists():
        folder.rename(path)
        return
    aside = _aside(path)
    _remove(aside)
    path.rename(aside)
    try:
        folder.rename(path)
    except BaseException:
        aside.rename(path)
        raise
    _remove(aside)


def recover(path: Path) -> None:
    """Takes back what a `put` that was killed has put aside; to be called by whoever writes to `path` next."""
    with contextlib.suppress(OSError):  # whoever cannot write there will be told
        if not path.exists() and _aside(path).exists():
            _aside(path).rename(path)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}.old")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
