"""Writing files so that a kill, a full disk or a read-only folder leaves nothing half-written."""

import contextlib
import errno
import hashlib
import json
import os
import shutil
import tempfile
import unicodedata
import warnings
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any

import platformdirs

from deadreckon.errors import BusyError, UserError
from deadreckon.foreign.text import read_json as read_json  # beside `write_json`
from deadreckon.foreign.text import read_toml as read_toml

if TYPE_CHECKING:
    from filelock import FileLock

LONGEST = 200  # bytes of a name; file systems take 255, and endings come behind it


def home() -> Path:
    """The folder of collected and downloaded logs: `DEADRECKON_HOME`, else the user's cache folder."""
    return Path(os.environ.get("DEADRECKON_HOME") or platformdirs.user_cache_dir("deadreckon"))


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
    made = [folder for folder in path.absolute().parents if not folder.exists()]
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
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
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if not path.exists():
            for folder in made:  # innermost first; one that others have filled meanwhile stays
                with contextlib.suppress(OSError):
                    folder.rmdir()


def safe_name(name: str, what: str) -> str:
    """`name`, which came from outside and becomes the name of a file: refused where that would not lie where it is made.

    Args:
        name: without an ending.
        what: has that name, for the error.

    Raises:
        UserError: it is empty or too long, leads to another folder on some system, or holds control characters.
    """
    if not name:
        why = "is empty"
    elif name == ".." or PureWindowsPath(name).name != name:  # Windows knows every separator, and drives
        why = "would lead to another folder"
    elif any(_is_control(c) for c in name):
        why = "has control characters"
    elif len(name.encode()) > LONGEST:
        why = f"is longer than {LONGEST} bytes"
    else:
        return name
    shown = repr(name) if len(name) <= 60 else f"{name[:57]!r}..."
    raise UserError(f"{what} {shown} {why}, so no file can be called that; rename it")


def file_part(name: str) -> str:
    """`name` as the name of a file: itself where it can be one, else with dashes for what cannot, and cut to its length.

    For folders that are called after what is in them; names that become the same here share a folder.
    """
    try:
        return safe_name(name, "")
    except UserError:
        plain = "".join("-" if c in "/\\:" or _is_control(c) else c for c in name)
        plain = plain.encode()[:LONGEST].decode(errors="ignore")
        return plain if plain.strip(".") else "-"


def _is_control(c: str) -> bool:
    return unicodedata.category(c) in ("Cc", "Cs")  # and halves of characters, which no encoding has


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


def write_json(path: Path | str, value: Any) -> None:
    """Writes `value` as readable JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, sort_keys=False) + "\n")


def copy_folder(source: Path, target: Path | str) -> Path:
    """Copies a folder to a new place, where it appears only when it is complete; temporary files and locks stay behind.

    Raises:
        UserError: there is something at `target`, or it cannot be written. Nothing is left behind.
    """
    target = Path(target)
    if target.exists():
        raise UserError(f"{target} exists already; choose another place")
    aside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        shutil.copytree(source, aside, ignore=shutil.ignore_patterns(".*.tmp", ".*.lock"))
        aside.rename(target)
    except OSError as error:  # copytree's is a list of those of all files
        raise UserError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return target


def digest(value: Any, size: int, *, sort_keys: bool = False) -> str:
    """`size` bytes in hexadecimal that tell JSON values apart, the same in every process: for names of files.

    Args:
        value: of JSON's types.
        size: bytes.
        sort_keys: whether objects are the same in whatever order their keys stand.
    """
    return hashlib.blake2b(json.dumps(value, sort_keys=sort_keys).encode(), digest_size=size).hexdigest()


def write_at(path: Path, offset: int, data: bytes | memoryview) -> None:
    """Writes `data` at `offset` of a growing file, cuts off what was behind it, and sees it onto the disk.

    Raises:
        UserError: the file is shorter than `offset`, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "r+b" if path.exists() else "w+b") as file:
            there = file.seek(0, os.SEEK_END)
            if there < offset:  # it would be filled up with zeros
                raise UserError(f"{path} has lost its end: {there} bytes are left of {offset}")
            file.truncate(offset)
            file.seek(offset)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error


@contextlib.contextmanager
def alone(path: Path, wait: str = "", what: str = "this") -> Iterator[None]:
    """Lets one process at a time work on what will be `path`. The system frees the lock of a killed one.

    Args:
        path: need not be there yet.
        wait: what another process that is at it does: then it is waited for, which a warning tells, instead of refused.
        what: is worked on, for the error.

    Raises:
        BusyError: another process is at it.
        UserError: the folder cannot be made. A folder made for nothing is removed.
    """
    path = path.absolute()
    made = [folder for folder in path.parents if not folder.exists()]
    lock = path.with_name(f".{path.name}.lock")
    try:
        try:
            held = _locked(lock, wait)
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror or error}") from error
        if held is None:
            raise BusyError(f"another process is at work on {what} already: {lock} is locked")
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # while it is held: whoever waits sees that the file is gone, and makes its own
                lock.unlink()
            held.release()
    finally:
        for folder in made:  # innermost first; one that holds something stays
            with contextlib.suppress(OSError):
                folder.rmdir()


def _locked(lock: Path, wait: str) -> "FileLock | None":
    """A lock that is held; None where another process has it and is not waited for."""
    from filelock import FileLock, Timeout  # 40 ms, which `deadreckon --help` need not take

    held, told = FileLock(lock), False
    while True:
        lock.parent.mkdir(parents=True, exist_ok=True)  # whoever was waited for may have removed it
        try:
            held.acquire(timeout=0.2, poll_interval=0.02)
            return held
        except FileNotFoundError:  # the folder was removed between these two lines
            continue
        except Timeout:
            if not wait:
                return None
        if not told:
            warnings.warn(f"another process {wait}: waiting for it", stacklevel=4)
        told = True
