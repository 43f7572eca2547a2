"""Logs as npz files: one array per column, by `Dataset.from_arrays` names."""

import json
import zipfile
from pathlib import Path

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.arrange import Arranged, arranged
from deadreckon.data.formats.build import arrays_of, build
from deadreckon.data.formats.header import Header
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.foreign.archive import read_arrays
from deadreckon.names import safe_name

_HEADER = "deadreckon"  # the array that holds the header as JSON


def read_npz(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads an npz file with columns by `Dataset.from_arrays` names (D4RL's), or in another library's layout.

    Raises:
        UserError: one line: damaged, columns missing or wrong, or arrays that hold Python objects.
    """
    columns = read_arrays(path)
    text = columns.pop(_HEADER, None)
    header = None if text is None else Header.parse(path, str(text))
    found = Arranged(columns) if header else arranged(path, columns)
    return build(
        path, found.columns, header, source="npz", name=name, action_space=found.space, extra=found.extra, strict=strict,
        horizon=horizon, warnings=found.told,
    )  # fmt: skip


def write_npz(log: Dataset, path: Path | str) -> None:
    """Writes `log` as a compressed npz that `read_npz` reads back exactly. Atomic.

    Raises:
        UserError: a column's name is not a valid name of a file, as which it is unpacked, or is that of the header; or the
            file cannot be written.
    """
    columns = arrays_of(log)
    for key in columns:
        safe_name(key, f"{path}: column")
    if _HEADER in columns:
        raise UserError(f"{path}: column {_HEADER} has the name of the header in an npz file; rename it")
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        # Not by `savez_compressed`, of which columns called file or allow_pickle would be arguments.
        for key, column in {**columns, _HEADER: np.array(json.dumps(Header.of(log).to_json()))}.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(column), allow_pickle=False)
