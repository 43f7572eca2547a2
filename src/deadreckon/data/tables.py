"""Logs as Parquet, CSV and npz files.

In Parquet and CSV a vector is spread over columns `observation_0, observation_1, ...`; `final_observation_*` is filled
in the last row of an episode alone. CSV keeps neither action bounds nor name; the others give a log back exactly.
"""

import gzip
import json
import math
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from deadreckon.data.dataset import Dataset
from deadreckon.data.encode import numbers
from deadreckon.data.frame import from_frame, log_probabilities, numbered
from deadreckon.data.layout import build, columns_of, damaged, header_of, naming, parse_header, reading, stem
from deadreckon.errors import UserError, unknown
from deadreckon.files import replacing, safe_name

_HEADER = "deadreckon"
# Our name in a table for each column of a log.
_SINGULAR = {"observations": "observation", "actions": "action", "rewards": "reward", "terminals": "terminal",
             "timeouts": "timeout", "next_observations": "next_observation",
             "final_observations": "final_observation"}  # fmt: skip
_PLURAL = {value: key for key, value in _SINGULAR.items()}
# Any of these tells that rows follow each other, or that somebody meant to say so.
_ORDERED = {"terminals", "timeouts", "next_observations", "final_observations", "dones", "done", "terminations", "time"}
MAPPING = ("episode", "time", "action", "reward", "observations", "ignore", "terminal", "timeout", "propensity", "keep")


def read_parquet(
    path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None, **mapping: Any
) -> Dataset:
    """Reads a Parquet file: one that `write_parquet` wrote, one with our column names, or any, given a mapping.

    Args:
        path: of the file.
        strict: refuse actions out of bounds.
        name: of the log; the file's if absent.
        horizon: steps after which an episode is cut by a timeout, for files of our names that mark no time limits.
        **mapping: which column is what, as for `from_frame`.

    Raises:
        UserError: one line with file, column and row.
    """
    with reading(path, "Parquet", pa.ArrowException):
        table = parquet.read_table(path)
    text = (table.schema.metadata or {}).get(_HEADER.encode())
    about = None if text is None else parse_header(path, text)
    return _from_table(path, table, about, "parquet", strict, name, horizon, mapping)


def read_csv(
    path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None, **mapping: Any
) -> Dataset:
    """Reads a CSV file with a line of names, plain or gzipped; see `read_parquet`."""
    with reading(path, "CSV", pa.ArrowException, EOFError), open(path, "rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        # Through Python's gzip, which notices a file that was cut short; pyarrow's does not.
        source = gzip.GzipFile(fileobj=file) if packed else file
        table = csv.read_csv(source)
    return _from_table(path, table, None, "csv", strict, name, horizon, mapping)


def read_npz(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads an npz file with columns by `Dataset.from_arrays` names (D4RL's).

    Raises:
        UserError: one line: damaged, columns missing or wrong, or arrays that hold Python objects.
    """
    with (
        reading(path, "npz", ValueError, KeyError, EOFError, zipfile.BadZipFile),
        np.load(path, allow_pickle=False) as file,
    ):
        columns = {key: file[key] for key in file.files}
    text = columns.pop(_HEADER, None)
    about = None if text is None else parse_header(path, str(text))
    return build(path, columns, about, source="npz", name=name, strict=strict, horizon=horizon)


def write_parquet(log: Dataset, path: Path | str) -> None:
    """Writes `log` as Parquet that `read_parquet` gives back exactly. Atomic."""
    table = to_table(log)
    shapes = {key: (list(column.shape[1:]), str(column.dtype)) for key, column in columns_of(log).items()}
    about = json.dumps({**header_of(log), "columns": shapes})
    with replacing(path) as temporary:
        parquet.write_table(table.replace_schema_metadata({_HEADER: about}), temporary)


def write_csv(log: Dataset, path: Path | str) -> None:
    """Writes `log` as CSV; `read_csv` gives the values back as float32, without the action bounds. Atomic.

    Raises:
        UserError: a column has more than one dimension a row, or the file cannot be written.
    """
    for key, column in columns_of(log).items():
        if column.ndim > 2:
            raise UserError(f"{path}: {key} of shape {column.shape[1:]} do not fit into CSV; write .hdf5 or .parquet")
    with replacing(path) as temporary:
        csv.write_csv(to_table(log), temporary)


def write_npz(log: Dataset, path: Path | str) -> None:
    """Writes `log` as a compressed npz that `read_npz` gives back exactly. Atomic.

    Raises:
        UserError: a column's name can be no file's, as which whatever unpacks the archive takes it; or the file cannot be
            written.
    """
    columns = columns_of(log)
    for key in columns:
        safe_name(key, f"{path}: column")
    if _HEADER in columns:
        raise UserError(f"{path}: column {_HEADER} has the name of the header in an npz file; rename it")
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        # Not by `savez_compressed`, to which columns called file or allow_pickle would be arguments.
        for key, column in {**columns, _HEADER: np.array(json.dumps(header_of(log)))}.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(column), allow_pickle=False)


def to_table(log: Dataset) -> pa.Table:
    """`log` as a pyarrow table: `episode`, then every column, vectors spread over name_0, name_1, ..."""
    table: dict[str, Any] = {"episode": log.episode_of}
    columns = columns_of(log)
    known = columns.pop("final_known")
    final = columns.pop("final_observations")
    for key, column in columns.items():
        _spread(table, _SINGULAR.get(key, key), column)
    if log.successors is None:
        rows = log.ends[known]
        elsewhere = np.ones(len(log), bool)
        elsewhere[rows] = False
        for index, values in enumerate(final.reshape(len(final), -1)[known].T):
            spread = np.zeros(len(log), final.dtype)
            spread[rows] = values
            table[f"final_observation_{index}"] = pa.array(spread, mask=elsewhere)
    return pa.table(table)


def _spread(table: dict[str, Any], name: str, column: np.ndarray) -> None:
    if column.ndim == 1:
        table[name] = np.asarray(column)
        return
    for index, values in enumerate(np.asarray(column).reshape(len(column), -1).T):
        table[f"{name}_{index}"] = np.ascontiguousarray(values)


def _from_table(
    path: Path | str,
    table: pa.Table,
    about: dict[str, Any] | None,
    source: str,
    strict: bool,
    name: str | None,
    horizon: int | None,
    mapping: dict,
) -> Dataset:
    given = {key: value for key, value in mapping.items() if value is not None}
    for key in given:
        if key not in MAPPING:
            raise unknown("option", key, MAPPING)
    if given:
        for key in ("action", "reward"):
            if key not in given:
                raise UserError(f"{path}: say which column is the {key}: --{key} COLUMN ({_listed(table.column_names)})")
        if horizon is not None:
            raise UserError(f"{path}: where columns are named, --timeout names the one that marks time limits; no horizon")
        with naming(path, name or stem(path)):
            log = from_frame(table, name=name or stem(path), strict=strict, source=source, **given)
        return replace(log, provenance=replace(log.provenance, path=str(path)))
    for key in ("observation", "action", "reward"):
        if key not in table.column_names and not numbered(table.column_names, key):
            raise UserError(
                f"{path}: no column {key} or {key}_0; name the columns: --action COLUMN --reward COLUMN "
                "[--observations COLUMN ...] [--episode, --time, --propensity ...]; all others become observations; "
                "`deadreckon data convert` does that once, for commands that do not take these options "
                f"({_listed(table.column_names)})"
            )
    columns = _columns(path, table, _shapes(path, about))
    if about is None:
        if horizon is None and not ("episode" in table.column_names or _ORDERED & columns.keys()):
            columns["terminals"] = np.ones(table.num_rows, bool)  # nothing tells of episodes: decisions that stand alone
        if "propensity" in columns and "behavior_log_probs" not in columns:
            columns["behavior_log_probs"] = log_probabilities(str(path), table, "propensity")
            del columns["propensity"]
    return build(path, columns, about, source=source, name=name, strict=strict, horizon=horizon)


def _listed(names: list[str], width: int = 200) -> str:
    """The names, as many as fit."""
    names = [name for name in names if name]
    shown = [*names]
    while len(shown) > 1 and len(", ".join(shown)) > width:
        shown.pop()
    return f"columns: {', '.join(shown)}{', ...' if len(shown) < len(names) else ''}"


def _shapes(path: Path | str, about: dict[str, Any] | None) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """{column: (shape of a row, dtype)} as the header says."""
    try:
        shapes = {key: (tuple(shape), np.dtype(dtype)) for key, (shape, dtype) in (about or {}).get("columns", {}).items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise damaged(path, f"columns: {error}") from error
    for key, (shape, dtype) in shapes.items():
        if not all(type(size) is int and size >= 0 for size in shape) or dtype.kind not in "fiub":
            raise damaged(path, f"column {key} of shape {list(shape)}, {dtype}")
    return shapes


def _columns(path: Path | str, table: pa.Table, shapes: dict[str, tuple[tuple[int, ...], np.dtype]]) -> dict[str, np.ndarray]:
    """The columns of a table that has our names, by `from_arrays` names."""
    if not table.num_rows:
        raise UserError(f"{path}: the log has no rows")
    columns: dict[str, np.ndarray] = {}
    for name, parts in _groups(table.column_names, shapes).items():
        key = _PLURAL.get(name, name)
        if name in ("episode", "final_observation"):
            continue
        values = [_values(path, table, part) for part in parts]
        column = values[0] if parts == [name] else np.stack(values, 1)
        if key == "actions" and parts != [name]:
            column = column.astype(np.float32)  # action_0 alone is a vector of one, even where CSV shows 1, 0, 1
        if key in shapes:
            shape, dtype = shapes[key]
            if column[:1].size != math.prod(shape):
                raise damaged(path, f"column {key} of shape {list(shape)} has {column[:1].size} numbers a row")
            column = column.reshape(len(column), *shape).astype(dtype, copy=False)
        columns[key] = column
    rows = table.num_rows
    if "episode" in table.column_names:
        episode = numbers(str(path), table, "episode")
        change = np.append(episode[1:] != episode[:-1], True)
        if int(change.sum()) != len(np.unique(episode)):
            row = _returns(episode, change)
            raise UserError(
                f"{path}: the rows of episode {episode[row]:g} are not together (row {row}); "
                "name all columns (--episode, --time, --action, --reward) to have them sorted"
            )
        terminals = np.asarray(columns.get("terminals", np.zeros(rows, bool)))
        columns["timeouts"] = np.asarray(columns.get("timeouts", np.zeros(rows, bool))) | (change & (terminals == 0))
    finals = _groups(table.column_names, shapes).get("final_observation")
    if finals and "next_observations" not in columns:
        columns |= _finals(path, table, finals, columns)
    return columns


def _finals(path: Path | str, table: pa.Table, parts: list[str], columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    ends = np.asarray(columns.get("terminals", np.zeros(table.num_rows, bool))) != 0
    ends |= np.asarray(columns.get("timeouts", np.zeros(table.num_rows, bool))) != 0
    ends[-1:] = True
    rows = np.flatnonzero(ends)
    known = ~table.column(parts[0]).is_null().to_numpy()[rows]
    last = table.select(parts).take(rows).filter(pa.array(known))
    shape = columns["observations"].shape[1:]
    final = np.zeros((len(rows), *shape), columns["observations"].dtype)
    values = np.stack([_values(path, last, part) for part in parts], 1)
    if values.shape[1] != int(np.prod(shape)):
        raise UserError(f"{path}: {len(parts)} columns final_observation_*, {int(np.prod(shape))} are needed")
    final[known] = values.reshape(-1, *shape)
    return {"final_observations": final, "final_known": known}


def _groups(names: list[str], shapes: dict[str, Any]) -> dict[str, list[str]]:
    """{column of the log: its columns in the table}: name_0, name_1, ... belong together if all are there."""
    scalars = {key for key, (shape, _) in shapes.items() if not shape}
    groups: dict[str, list[str]] = {}
    for column in names:
        prefix, _, number = column.rpartition("_")
        together = number.isdecimal() and prefix and column not in scalars
        groups.setdefault(prefix if together else column, []).append(column)
    return {key: parts if parts == [key] else numbered(parts, key) for key, parts in groups.items()}


def _values(path: Path | str, table: pa.Table, column: str) -> np.ndarray:
    """A column as it is stored; missing values and texts are refused."""
    values = table.column(column)
    if not len(values):
        return np.zeros(0, np.float32)
    if pa.types.is_null(values.type) or values.null_count:
        row = int(np.argmax(values.is_null().to_numpy()))
        raise UserError(f"{path}: column {column} is empty in row {row}")
    if not (pa.types.is_boolean(values.type) or pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
        raise UserError(
            f"{path}: column {column} holds {values.type}, numbers are needed; name your columns "
            "(--action, --reward, --observations) to have it encoded or left out"
        )
    return values.to_numpy()


def _returns(episode: np.ndarray, change: np.ndarray) -> int:
    """The first row of an episode that was left before."""
    starts = np.append(0, np.flatnonzero(change)[:-1] + 1)
    _, first = np.unique(episode[starts], return_index=True)
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]])
