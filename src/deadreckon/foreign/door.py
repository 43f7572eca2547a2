"""What may be opened: a file where a file is expected, and nothing that waits or answers."""

import contextlib
import errno
import gzip
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from deadreckon.errors import UserError
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked

_KINDS = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a named pipe"), (stat.S_ISSOCK, "a socket"), (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)  # fmt: skip
_NO_WAIT = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


def file_size(path: Path | str) -> int:
    """Bytes of a file.

    Raises:
        UserError: it is missing or cannot be read, or is no file: a folder, a named pipe, a socket or a device.
    """
    try:
        found = os.stat(path)
    except OSError as error:
        raise _unreadable(path, error) from error
    except ValueError as error:  # a null character
        raise UserError(f"no file {str(path)!r}: {error}") from error
    _refuse_others(path, found.st_mode)
    return found.st_size


@contextlib.contextmanager
def opened(path: Path | str) -> Iterator[io.BufferedReader]:
    """A file, open for reading from its beginning, which cannot become something else between the look and the opening.

    Raises:
        UserError: as of `file_size`.
    """
    file_size(path)  # a device may do something when it is opened, so it is looked at before
    try:
        handle = os.open(path, os.O_RDONLY | _NO_WAIT)
    except OSError as error:
        raise _unreadable(path, error) from error
    with os.fdopen(handle, "rb") as file:
        _refuse_others(path, os.fstat(handle).st_mode)
        yield file


def refuse_links(folder: Path | str, what: str, but: str | None = None) -> None:
    """Refuses a folder in which anything is a symbolic link: what is read, written or removed there would lie elsewhere.

    The folder itself may be reached by links, which are its user's own.

    Args:
        folder: need not be there.
        what: the folder is, in words, for the error.
        but: name of a folder that may hold links, and be none itself, directly in it or beside a run.json, as in the folds of a
            cross-fit: nothing is read there, or written through them.
    """
    for place, folders, names in os.walk(folder):
        for name in (*folders, *names):
            refuse_link(os.path.join(place, name), what)
        if but in folders and (Path(place) == Path(folder) or "run.json" in names):
            folders.remove(but)


def refuse_link(path: Path | str, what: str) -> None:
    """Refuses one path that is a symbolic link; see `refuse_links`."""
    if os.path.islink(path):
        raise UserError(f"{path} is a link, which is not followed in {what}; put what it leads to there itself")


def read_bytes(path: Path | str) -> bytes:
    """All bytes of a file; raises as `opened`."""
    with opened(path) as file:
        return file.read()


def unpacked(path: Path | str, file: BinaryIO) -> BinaryIO:
    """A file that is open for reading, from its beginning; what is gzipped is unpacked, as far as it may.

    By Python's gzip, which notices a file that was cut short; pyarrow's does not.

    Args:
        path: of the file, for errors.
        file: that is open.
    """
    file.seek(0)
    packed = file.read(2) == b"\x1f\x8b"
    file.seek(0)
    return io.BufferedReader(_Unpacked(path, file), 1 << 16) if packed else file


class _Unpacked(io.RawIOBase):
    """Unpacks, and refuses a file that unpacks to more than it may."""

    def __init__(self, path: Path | str, file: BinaryIO):
        self.path, self.most = path, max_unpacked(os.fstat(file.fileno()).st_size)
        self.inner = gzip.GzipFile(fileobj=file)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self.inner.seek(offset, whence)

    def tell(self) -> int:
        return self.inner.tell()

    def readinto(self, buffer) -> int:
        count = self.inner.readinto(buffer)
        if self.inner.tell() > self.most:
            raise beyond(self.path, self.inner.tell(), self.most, UNPACKED, "unpacks to")
        return count


def _refuse_others(path: Path | str, mode: int) -> None:
    what = next((words for test, words in _KINDS if test(mode)), None)
    if what is not None:
        raise UserError(f"{path} is {what}, and a file is needed")


def _unreadable(path: Path | str, error: OSError) -> UserError:
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return UserError(f"no file {path}")
    return UserError(f"cannot read {path}: {error.strerror or error}")
