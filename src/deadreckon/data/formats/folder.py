"""A log as a folder of .npy columns and a log.json: plain, memory-mappable, for logs larger than memory."""

import json
import os
from pathlib import Path
from typing import IO, Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import arrays_of, build
from deadreckon.data.formats.header import Header, damaged
from deadreckon.errors import UserError, cannot_write
from deadreckon.files import drop_empty, is_there, missing_folders
from deadreckon.foreign.archive import read_array
from deadreckon.foreign.door import read_bytes
from deadreckon.names import safe_name
from deadreckon.temporaries import beside, put, recover

HEADER = "log.json"


def write_folder(log: Dataset, path: Path | str, *, force: bool = False) -> None:
    """Writes `log` to a folder that `read_folder` reads back exactly. The folder appears only when complete.

    Args:
        log: to be written.
        path: of the new folder.
        force: replace an existing folder, which is removed only when the new log is complete.

    Raises:
        UserError: `path` exists, a column's name is not a valid name of a file, or it cannot be written. Nothing is left
            behind, and an existing folder is unchanged.
    """
    path = Path(path)
    recover(path)
    if path.exists() and not force:
        raise UserError(f"{path} exists already")
    columns = arrays_of(log)
    for key in columns:  # names are from the author of the log
        safe_name(key, f"{path}: column")
    made = missing_folders(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside(path, folder=True) as temporary:
            for key, column in columns.items():
                with open(temporary / f"{key}.npy", "xb") as file:  # not "w": without case, two columns could be one file
                    np.save(file, column, allow_pickle=False)
                    _sync(file)
            with open(temporary / HEADER, "w") as file:
                file.write(json.dumps(Header.of(log, columns=list(columns)).to_json(), indent=1) + "\n")
                _sync(file)
            temporary.chmod(0o755)
            put(temporary, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        if not path.exists():
            drop_empty(made)


def read_folder(path: Path | str, *, mmap: bool = True, strict: bool = False, name: str | None = None) -> Dataset:
    """Reads what `write_folder` wrote; columns are memory-mapped unless `mmap` is false.

    Raises:
        UserError: one line that names the file that is missing or damaged.
    """
    path = Path(path)
    header = Header.parse(path / HEADER, read_bytes(path / HEADER))
    keys = header.columns
    if not isinstance(keys, list) or not all(isinstance(key, str) for key in keys):
        raise damaged(path / HEADER, "no list of columns")
    columns = {}
    for key in keys:
        file = path / f"{key}.npy"
        if Path(key).name != key or not is_there(file):
            raise UserError(f"{path}: column file {key}.npy is missing")
        columns[key] = read_array(file, mmap=mmap)
    return build(path, columns, header, name=name, strict=strict)


def folder_bytes(path: Path | str) -> int:
    """Bytes that the column files of a folder take."""
    return sum(file.stat().st_size for file in Path(path).glob("*.npy"))


def _sync(file: IO[Any]) -> None:
    file.flush()
    os.fsync(file.fileno())
