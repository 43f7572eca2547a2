"""RLlib's logs: JSON lines of sample batches, as its JsonWriter writes them without compression, in a file or a folder."""

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.arrange import arranged
from deadreckon.data.formats.build import build, stem
from deadreckon.data.formats.json_table import begins_object, without_mark
from deadreckon.data.formats.layouts import flat
from deadreckon.errors import UserError, naming, reading
from deadreckon.foreign.door import opened

_TYPES = ("SampleBatch", "MultiAgentBatch")
_BATCH = rb'"type"\s*:\s*"(Sample|MultiAgent)Batch"'
_BATCHES = "output-*.json"  # the files in a folder that RLlib has written
_NO_ARRAYS = ("type", "infos", "count")
_EPISODE = "eps_id"  # texts, or integers that may exceed 64 bits


def read_rllib(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads RLlib's JSON lines, a batch of rows in each.

    Args:
        path: of a file, or of a folder of files called `output-*.json`.
        strict: refuse actions out of bounds.
        name: of the log; the file's or folder's if absent.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.

    Raises:
        UserError: one line that names the file, the line and the column.
    """
    files = files_of(path) or [Path(path)]
    columns: dict[str, list[np.ndarray]] = {}
    for file in files:
        with reading(file, "RLlib's JSON lines"), naming(file, ""), opened(file) as source:
            for number, line in enumerate(io.TextIOWrapper(source, encoding="utf-8-sig"), 1):
                if line.strip():
                    _add(columns, _batch(line, number), number)
    whole: dict[str, Any] = {key: np.concatenate(values) for key, values in columns.items()}
    if _EPISODE in whole:
        whole[_EPISODE] = whole[_EPISODE].tolist()
    found = arranged(path, whole)
    if "layout" not in found.extra:
        told = f"found {', '.join(whole)}; a table has one row per line, and a value per column" if whole else "found no lists"
        raise UserError(f"{path}: JSON lines of lists are read in RLlib's layout: obs, actions, rewards, ...; {told}")
    return build(
        path, found.columns, source="rllib-json", name=name or stem(path), action_space=found.space, extra=found.extra,
        strict=strict, horizon=horizon, warnings=found.told,
    )  # fmt: skip


def files_of(path: Path | str) -> list[Path]:
    """The files of a folder that RLlib has written, in the order of their names."""
    return sorted(Path(path).glob(_BATCHES)) if Path(path).is_dir() else []


def is_rllib(head: bytes) -> bool:
    """Whether a file begins with a batch: an object of JSON that says so, or whose arrays are all lists, not of objects.

    Args:
        head: the beginning of the file, which may end within the first object.
    """
    if not begins_object(head):
        return False
    start = without_mark(head)
    try:
        first = json.loads(start.split(b"\n")[0])
    except (ValueError, RecursionError):  # the object is longer
        return re.search(_BATCH, start) is not None or re.match(rb'\{\s*"[^"]*"\s*:\s*\[(?!\s*\{)', start) is not None
    if (said := first.get("type")) is not None or first.keys() >= {"columns", "data"}:  # the latter are those of a data frame
        return said in _TYPES
    arrays = [value for key, value in flat(first).items() if key.partition("/")[0] not in _NO_ARRAYS]
    return bool(arrays) and all(isinstance(value, list) and not isinstance((*value, 0)[0], dict) for value in arrays)


def _batch(line: str, number: int) -> dict[str, Any]:
    needed = "one batch per line is needed, as RLlib's JsonWriter writes"
    try:
        batch = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise UserError(f"line {number} is no JSON ({error}); {needed}") from error
    if not isinstance(batch, dict):
        raise UserError(f"line {number} is no object; {needed}")
    if batch.get("type") == "MultiAgentBatch":
        policies = batch.get("policy_batches")
        if not isinstance(policies, dict) or len(policies) != 1:
            raise UserError(f"line {number} is a batch of several policies, and one is read; write the batches of one of them")
        (batch,) = policies.values()
    return batch


def _add(columns: dict[str, list[np.ndarray]], batch: dict[str, Any], number: int) -> None:
    """Appends the rows of a batch to the columns."""
    given: dict[str, np.ndarray] = {}
    for key, value in flat(batch).items():
        if key.partition("/")[0] in _NO_ARRAYS:
            continue
        if isinstance(value, str):
            raise UserError(f"column {key} is compressed in line {number}; write it with compress_columns=[] "
                            "(`output_compress_columns`), or read it with RLlib and save npz")  # fmt: skip
        try:
            column = np.asarray(value, object if key == _EPISODE else None)
        except ValueError as error:
            raise UserError(f"column {key} has entries of different shapes in line {number}") from error
        if (column.dtype.kind in "fiub" or key == _EPISODE) and column.ndim:
            given[key] = column
    missing = sorted(columns.keys() ^ given.keys()) if columns else []
    if missing:
        raise UserError(f"column {missing[0]} is in some lines and not in others, first noticed in line {number}")
    for key, column in given.items():
        if key in columns and columns[key][0].shape[1:] != column.shape[1:]:
            raise UserError(f"column {key} has shape {column.shape[1:]} in line {number}, {columns[key][0].shape[1:]} before")
        columns.setdefault(key, []).append(column)
