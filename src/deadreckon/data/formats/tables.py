"""Logs as Parquet and CSV files. CSV keeps neither action bounds nor name; Parquet gives a log back exactly."""

import gzip
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute
from pyarrow import csv, parquet

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import build, columns_of
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.spread import from_anybody, from_table, shapes_of, to_table, told_shapes
from deadreckon.errors import UserError, reading
from deadreckon.files import replacing

_compute: Any = pyarrow.compute  # its functions are made at run time, so type checkers do not know them
_HEADER = b"deadreckon"  # the entry of Parquet's metadata that holds the header as JSON


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
    table = parquet_table(path)
    text = (table.schema.metadata or {}).get(_HEADER)
    if text is None or any(value is not None for value in mapping.values()):
        columns, extra, warnings, space = from_anybody(path, table, mapping, horizon)
        header = None
    else:
        header = Header.parse(path, text)
        columns, extra, warnings, space = from_table(path, table, told_shapes(path, header)), {}, [], None
    return build(
        path, columns, header, source="parquet", extra=extra, warnings=warnings, strict=strict, name=name, horizon=horizon,
        action_space=space,
    )  # fmt: skip


def read_csv(
    path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None, **mapping: Any
) -> Dataset:
    """Reads a CSV file with a line of names, plain or gzipped; see `read_parquet`."""
    table = csv_table(path)
    columns, extra, warnings, space = from_anybody(path, table, mapping, horizon)
    return build(
        path, columns, source="csv", extra=extra, warnings=warnings, strict=strict, name=name, horizon=horizon,
        action_space=space,
    )  # fmt: skip


def parquet_table(path: Path | str) -> pa.Table:
    """(rows,) of each column of a Parquet file."""
    with reading(path, "Parquet", pa.ArrowException):
        return parquet.read_table(path)


def csv_table(path: Path | str) -> pa.Table:
    """(rows,) of each column of a CSV file."""
    with reading(path, "CSV", pa.ArrowException, EOFError), open(path, "rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        # Through Python's gzip, which notices a file that was cut short; pyarrow's does not.
        source = gzip.GzipFile(fileobj=file) if packed else file
        return _without_empty_texts(csv.read_csv(source))


def _without_empty_texts(table: pa.Table) -> pa.Table:
    """An empty cell is missing, of texts as of numbers; pyarrow reads it as a text of no letters."""
    for index, column in enumerate(table.columns):
        if pa.types.is_string(column.type):
            filled = _compute.if_else(_compute.equal(column, ""), pa.scalar(None, column.type), column)
            table = table.set_column(index, table.column_names[index], filled)
    return table


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
