"""Writing files so that a kill, a full disk or a read-only folder leaves nothing half-written."""

import contextlib
import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import platformdirs

from deadreckon.errors import UserError


def home() -> Path:
    """The folder of collected and downloaded logs: `DEADRECKON_HOME`, else the user's cache folder."""
    return Path(os.environ.get("DEADRECKON_HOME") or platformdirs.user_cache_dir("deadreckon"))


@contextlib.contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Gives a temporary path beside `path`; on success it is synced to disk and renamed over `path` in one step.

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


def read_json(path: Path | str) -> Any:
    """Reads a JSON file.

    Raises:
        UserError: the file is missing or is not JSON.
    """
    try:
        return json.loads(Path(path).read_text())
    except FileNotFoundError as error:
        raise UserError(f"no file {path}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not valid JSON: {error}") from error
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror or error}") from error
