"""Logs as Parquet and CSV files. CSV keeps neither action bounds nor name; Parquet gives a log back exactly."""

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import build, columns_of, stem
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.spread import from_table, shapes_of, to_table, told_shapes
from deadreckon.data.frame import log_probabilities, numbered
from deadreckon.errors import UserError, naming, reading, unknown
from deadreckon.files import replacing

_HEADER = b"deadreckon"  # the entry of Parquet's metadata that holds the header as JSON
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
    text = (table.schema.metadata or {}).get(_HEADER)
    if text is None or any(value is not None for value in mapping.values()):
        return _log_of(path, table, mapping, source="parquet", strict=strict, name=name, horizon=horizon)
    header = Header.parse(path, text)
    columns = from_table(path, table, told_shapes(path, header))
    return build(path, columns, header, strict=strict, name=name, horizon=horizon)


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
    return _log_of(path, table, mapping, source="csv", strict=strict, name=name, horizon=horizon)


def write_parquet(log: Dataset, path: Path | str) -> None:
    """Writes `log` as Parquet that `read_parquet` gives back exactly. Atomic."""
    table = to_table(log)
    header = Header.of(log, columns=shapes_of(log))
    with replacing(path) as temporary:
        parquet.write_table(table.replace_schema_metadata({_HEADER: json.dumps(header.to_json())}), temporary)


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


def _log_of(
    path: Path | str,
    table: pa.Table,
    mapping: dict[str, Any],
    *,
    source: str,
    strict: bool,
    name: str | None,
    horizon: int | None,
) -> Dataset:
    """A table that is not ours as a log: its columns are what `mapping` says, or have our names."""
    given = {key: value for key, value in mapping.items() if value is not None}
    if not given:
        columns = _named_ours(path, table, horizon)
        return build(path, columns, source=source, name=name, strict=strict, horizon=horizon)
    for key in given:
        if key not in MAPPING:
            raise unknown("option", key, MAPPING)
    for key in ("action", "reward"):
        if key not in given:
            raise UserError(f"{path}: say which column is the {key}: --{key} COLUMN ({_listed(table.column_names)})")
    if horizon is not None:
        raise UserError(f"{path}: where columns are named, --timeout names the one that marks time limits; no horizon")
    name = name or stem(path)
    with naming(path, name):
        log = Dataset.from_frame(table, name=name, strict=strict, source=source, **given)
    return replace(log, provenance=replace(log.provenance, path=str(path)))


def _named_ours(path: Path | str, table: pa.Table, horizon: int | None) -> dict[str, np.ndarray]:
    """The columns of a table that somebody gave our names, by `from_arrays` names."""
    for key in ("observation", "action", "reward"):
        if key not in table.column_names and not numbered(table.column_names, key):
            raise UserError(
                f"{path}: no column {key} or {key}_0; name the columns: --action COLUMN --reward COLUMN "
                "[--observations COLUMN ...] [--episode, --time, --propensity ...]; all others become observations; "
                "`deadreckon data convert` does that once, for commands that do not take these options "
                f"({_listed(table.column_names)})"
            )
    columns = from_table(path, table)
    if horizon is None and not ("episode" in table.column_names or _ORDERED & columns.keys()):
        columns["terminals"] = np.ones(table.num_rows, bool)  # nothing tells of episodes: decisions that stand alone
    if "propensity" in columns and LOG_PROBS not in columns:
        columns[LOG_PROBS] = log_probabilities(str(path), table, "propensity")
        del columns["propensity"]
    return columns


def _listed(names: list[str], width: int = 200) -> str:
    """The names, as many as fit."""
    names = [name for name in names if name]
    shown = [*names]
    while len(shown) > 1 and len(", ".join(shown)) > width:
        shown.pop()
    return f"columns: {', '.join(shown)}{', ...' if len(shown) < len(names) else ''}"
