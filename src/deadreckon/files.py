"""Writing files so that a kill, a full disk or a read-only folder leaves nothing half-written."""

import contextlib
import errno
import hashlib
import json
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from deadreckon.errors import BusyError, UserError, cannot_write
from deadreckon.foreign.door import opened, refuse_links
from deadreckon.foreign.text import read_json as read_json  # beside `write_json`
from deadreckon.foreign.text import read_toml as read_toml
from deadreckon.names import shown
from deadreckon.temporaries import beside

if TYPE_CHECKING:
    from filelock import FileLock


PATIENCE = 100  # times that a folder may be gone before it counts as one that cannot be made, as below /proc


def home() -> Path:
    """The folder of collected and downloaded logs: `DEADRECKON_HOME`, else the user's cache folder.

    Raises:
        UserError: the user has no home folder, as where a container runs under a number that the system does not know.
    """
    try:
        return Path(os.environ.get("DEADRECKON_HOME") or platformdirs.user_cache_dir("deadreckon"))
    except RuntimeError as error:
        raise UserError("this user has no home folder; set DEADRECKON_HOME, the folder of logs") from error


@contextlib.contextmanager
def replacing(path: Path | str, *, keep: bool = False) -> Iterator[Path]:
    """Gives a temporary path beside `path`; on success it is synced to disk and renamed over `path` in one step.

    Args:
        path: of the file.
        keep: whether a file that is there by then stays as it is, and the new one is dropped.

    Raises:
        UserError: the folder cannot be made, or the disk is full or read-only. Nothing is left behind.
    """
    path = Path(path)
    made = missing_folders(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside(path) as temporary:
            yield temporary
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            # mkstemp makes files private; what we publish has the rights that open() would have given.
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
            if keep:
                with contextlib.suppress(FileExistsError):
                    os.link(temporary, path)
            else:
                temporary.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    except UnicodeEncodeError as error:
        text = shown(error.object[max(error.start - 20, 0) : error.end + 20])
        raise UserError(f"cannot write {path}: {text!r} holds half a character, which no encoding has") from error
    finally:
        if not path.exists():
            drop_empty(made)


def drop_empty(folders: Iterable[Path]) -> None:
    """Removes folders, innermost first; one that holds something, such as what others have put there meanwhile, stays."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def missing_folders(path: Path) -> list[Path]:
    """The folders on the way to `path` that are not there yet, innermost first.

    Raises:
        UserError: nothing can lie at that path: it is too long, or holds what no path does.
    """
    try:
        if b"\0" in os.fsencode(path):
            raise UserError(f"cannot write {path}: no path holds a zero byte")
        path = path.absolute()
        return [each for each in (path, *path.parents) if not each.exists() and each != path]
    except UnicodeEncodeError as error:
        raise UserError(f"cannot write {path}: no path holds half a character") from error
    except OSError as error:
        raise cannot_write(path, error) from error


def is_there(path: Path | str) -> bool:
    """Whether something lies at `path`, which may be any text: one that is too long for a path is none."""
    try:
        return Path(path).exists()
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        return False


def reserve(path: Path, size: int) -> None:
    """Makes sure that `size` bytes fit where `path` lies, before a library starts that does not survive a full disk.

    Raises:
        OSError: they do not; `replacing` tells it in one line.
    """
    if hasattr(os, "posix_fallocate"):
        with open(path, "rb+") as file:
            os.posix_fallocate(file.fileno(), 0, max(size, 1))
            file.truncate(0)
    elif shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def write_text(path: Path | str, text: str) -> Path:
    """Writes `text` in UTF-8, atomically, and gives its path.

    Raises:
        UserError: it cannot be written, as in `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)


def write_json(path: Path | str, value: Any) -> None:
    """Writes `value` as readable JSON, atomically."""
    write_text(path, json.dumps(value, indent=1, sort_keys=False) + "\n")


def copy_folder(source: Path, target: Path | str, but: str | None = None) -> Path:
    """Copies a folder to a new place, where it appears only when it is complete, without temporary files, locks and what is
    called `but`, as in `refuse_links`.

    Raises:
        UserError: there is something at `target`, or it cannot be written; or something in `source` is a link, which may
            lead to what its user does not mean to give away. Nothing is left behind.
    """
    target = Path(target)
    refuse_links(source, "a folder that is copied", but)
    left = (".*.tmp", ".*.lock", *([] if but is None else [but]))
    if target.exists():
        raise UserError(f"{target} exists already; choose another place")
    made = missing_folders(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with beside(target, folder=True) as aside:
            shutil.copytree(source, aside, ignore=shutil.ignore_patterns(*left), dirs_exist_ok=True)
            aside.rename(target)
    except OSError as error:  # copytree's is a list of those of all files
        raise cannot_write(target, error) from error
    finally:
        if not target.exists():
            drop_empty(made)
    return target


def digest(value: Any, size: int, *, sort_keys: bool = False) -> str:
    """`size` bytes in hexadecimal that tell JSON values apart, the same in every process: for names of files.

    Args:
        value: of JSON's types.
        size: bytes.
        sort_keys: whether objects are the same in whatever order their keys stand.
    """
    return hashlib.blake2b(json.dumps(value, sort_keys=sort_keys).encode(), digest_size=size).hexdigest()


def content_digest(path: Path | str) -> str:
    """16 bytes in hexadecimal that tell the contents of files apart.

    The path may be from elsewhere, as in a record of policies, so it is opened as what is read from there is.

    Raises:
        UserError: it is missing or cannot be read, or is no file: a device, a named pipe, a socket or a folder.
    """
    with opened(path) as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def write_at(path: Path, offset: int, data: bytes | memoryview, *, cut: bool = True) -> None:
    """Writes `data` at `offset` of a growing file, cuts off what was behind it, and sees it onto the disk.

    Args:
        path: of the file.
        offset: in bytes.
        data: what to write.
        cut: whether what was behind `offset` is cut off; else `data` replaces as many bytes there, and the others stay.

    Raises:
        UserError: the file is shorter than `offset`, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "r+b" if path.exists() else "w+b") as file:
            there = file.seek(0, os.SEEK_END)
            if there < offset:  # it would be filled up with zeros
                raise UserError(f"{path} has lost its end: {there} bytes are left of {offset}")
            if cut:
                file.truncate(offset)
            file.seek(offset)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise cannot_write(path, error) from error


@contextlib.contextmanager
def alone(path: Path, wait: str = "", what: str = "") -> Iterator[None]:
    """Lets one process at a time work on what will be `path`. The system frees the lock of a killed one.

    Args:
        path: need not be there yet.
        wait: what another process that is at it does: then it is waited for, which a warning tells, instead of refused.
        what: is worked on, for the error; `path` if empty.

    Raises:
        BusyError: another process is at it.
        UserError: the folder cannot be made. A folder made for nothing is removed.
    """
    told, path = path, path.absolute()
    if not path.name:
        raise UserError(f"{path} is the root of all folders; choose another place")
    made = missing_folders(path)
    lock = path.with_name(f".{path.name}.lock")
    try:
        try:
            held = _locked(lock, wait)
        except OSError as error:
            raise cannot_write(path, error) from error
        if held is None:
            raise BusyError(f"another process is at work on {what or told} already: {lock} is locked")
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # while it is held: whoever waits sees that the file is gone, and makes its own
                lock.unlink()
            held.release()
    finally:
        drop_empty(made)


def _can_make_files(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except FileNotFoundError:
        return False


def _locked(lock: Path, wait: str) -> "FileLock | None":
    """A lock that is held; None where another process has it and is not waited for."""
    from filelock import FileLock, Timeout  # 40 ms, which `deadreckon --help` need not take

    held, told, gone = FileLock(lock), False, 0
    while True:
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)  # whoever was waited for may have removed it
            held.acquire(timeout=0.2, poll_interval=0.02)
            return held
        except FileNotFoundError:  # a folder was removed between these two lines, or on the way; or none can be made there
            if (gone := gone + 1) == PATIENCE:
                raise
            continue
        except FileExistsError:  # `mkdir` found a folder, and then none: it was removed meanwhile
            with contextlib.suppress(FileNotFoundError):
                if not stat.S_ISDIR(lock.parent.lstat().st_mode):
                    raise
            continue
        except Timeout:
            if not lock.exists():  # released meanwhile; or none can be made here, which the system says now
                gone += 0 if _can_make_files(lock.parent) else PATIENCE // 5  # each of which has taken 0.2 s
                if gone >= PATIENCE:
                    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(lock)) from None
                continue
            if not wait:
                return None
        if not told:
            warnings.warn(f"another process {wait}: waiting for it", stacklevel=4)
        told = True
