"""A log as a folder of .npy columns and a log.json: plain, memory-mappable, for logs larger than memory."""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.layout import build, columns_of, header_of, reading
from deadreckon.errors import UserError
from deadreckon.files import read_json

HEADER = "log.json"


def write_folder(log: Dataset, path: Path | str) -> None:
    """Writes `log` to a new folder that `read_folder` reads back exactly. The folder appears only when complete.

    Raises:
        UserError: `path` exists, or cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise UserError(f"{path} exists already")
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent))
        columns = columns_of(log)
        for key, column in columns.items():
            np.save(temporary / f"{key}.npy", column, allow_pickle=False)
        (temporary / HEADER).write_text(json.dumps({**header_of(log), "columns": list(columns)}, indent=1) + "\n")
        temporary.chmod(0o755)
        temporary.rename(path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def read_folder(path: Path | str, *, mmap: bool = True, strict: bool = False, name: str | None = None) -> Dataset:
    """Reads what `write_folder` wrote; columns are memory-mapped unless `mmap` is false.

    Raises:
        UserError: one line that names the file that is missing or damaged.
    """
    path = Path(path)
    about = read_json(path / HEADER)
    if not isinstance(about, dict) or not isinstance(about.get("columns"), list):
        raise UserError(f"{path / HEADER}: no list of columns; is this a log that deadreckon wrote?")
    columns = {}
    for key in about["columns"]:
        file = path / f"{key}.npy"
        if Path(key).name != key or not file.is_file():
            raise UserError(f"{path}: column file {key}.npy is missing")
        with reading(file, "a .npy column", ValueError, EOFError):
            columns[key] = np.load(file, mmap_mode="r" if mmap else None, allow_pickle=False)
    return build(path, columns, about, name=name, strict=strict)
