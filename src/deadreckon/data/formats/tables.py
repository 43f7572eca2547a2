"""Reading of logs from tables, and writing as CSV and Parquet. CSV keeps neither action bounds nor name; Parquet keeps all."""

import json
from pathlib import Path
from typing import Any

from pyarrow import parquet

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.any_table import table_of_kind
from deadreckon.data.formats.build import arrays_of, build
from deadreckon.data.formats.csv_out import write_table
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.kind import READING
from deadreckon.data.formats.spread import from_anybody, from_table, shapes_of, to_table, told_shapes
from deadreckon.data.formats.words import levels_in
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError, reading
from deadreckon.files import replacing
from deadreckon.foreign.parquet import check_parquet

_HEADER = b"deadreckon"  # the entry of Parquet's metadata that holds the header as JSON


def read_tabular(
    path: Path | str,
    *,
    kind: str,
    strict: bool = False,
    name: str | None = None,
    horizon: int | None = None,
    **mapping: Any,
) -> Dataset:
    """Reads a file of a table: CSV in any dialect, JSON, Parquet, a spreadsheet, SQLite or DuckDB.

    Parquet that `write_parquet` wrote gives the log back exactly, unless a mapping is given.

    Args:
        path: of the file.
        kind: its format, as returned by `kind.sniff`.
        strict: refuse actions out of bounds.
        name: of the log; the file's if absent.
        horizon: steps after which an episode is cut by a timeout, for files with our names that mark no time limits.
        **mapping: the roles of columns, as for `from_frame`, and options of the reader, as for `table_of_kind`.

    Raises:
        UserError: one line with file, column and row or line.
    """
    ways = {key: mapping.pop(key) for key in READING if key in mapping}
    table, dialect, told = table_of_kind(path, kind, ways, levels_in(mapping))
    text = (table.schema.metadata or {}).get(_HEADER) if kind == "parquet" else None
    if text is None or any(value is not None for value in mapping.values()):
        columns, extra, warnings, space = from_anybody(path, table, mapping, horizon, dialect=dialect)
        header = None
    else:
        header = Header.parse(path, text)
        columns, extra, warnings, space = from_table(path, table, told_shapes(path, header)), {}, [], None
    return build(
        path, columns, header, source=kind, extra=extra, warnings=[*told, *warnings], strict=strict, name=name, horizon=horizon,
        action_space=space,
    )  # fmt: skip


def is_written(path: Path | str) -> bool:
    """Whether a Parquet file is a log that `write_parquet` wrote, and not a user's table.

    Raises:
        UserError: it is not a Parquet file, or is damaged.
    """
    check_parquet(path, "Parquet", whole=False)
    with reading(path, "Parquet"), parquet.ParquetFile(path) as file:
        return _HEADER in (file.schema_arrow.metadata or {})


def write_parquet(log: Dataset, path: Path | str) -> None:
    """Writes `log` as Parquet that `read_tabular` reads back exactly. Atomic."""
    header = Header.of(log, columns=shapes_of(log))
    with replacing(path) as temporary:
        table = to_table(log)
        parquet.write_table(table.replace_schema_metadata({_HEADER: json.dumps(header.to_json())}), temporary)


def write_csv(log: Dataset, path: Path | str) -> None:
    """Writes `log` as CSV; `read_tabular` gives the values back as float32, without the action bounds. Atomic.

    Names that a spreadsheet would take for formulas get an apostrophe in front (`csv_out`).

    Raises:
        UserError: a column has more than one dimension per row, actions have a mask, or the file cannot be written.
    """
    for key, column in arrays_of(log).items():
        if isinstance(log.action_space, Discrete) and log.action_space.masked:
            raise UserError(f"{path}: CSV does not keep which actions are legal; write .hdf5 or .parquet")
        if column.ndim > 2:
            raise UserError(f"{path}: {key} of shape {column.shape[1:]} do not fit into CSV; write .hdf5 or .parquet")
    with replacing(path) as temporary:
        write_table(to_table(log), temporary)
