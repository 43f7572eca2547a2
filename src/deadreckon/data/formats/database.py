"""Reading of tables of SQLite and DuckDB files, whole or by a query, as pyarrow tables.

Files are opened read-only, and neither a query nor a view can write, or read another file.
"""

import contextlib
import itertools
import sqlite3
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pyarrow as pa

from deadreckon.data.formats.values import column_of
from deadreckon.errors import UserError, as_one_line, extra, reading, unknown
from deadreckon.foreign.door import file_size
from deadreckon.foreign.limits import RATE, SECONDS, UNPACKED, beyond, max_unpacked
from deadreckon.names import repeated

_BATCH = 10_000  # rows that are fetched at once
_STEPS = 100_000  # instructions of SQLite's virtual machine between two checks of the time
# What a query may do; VACUUM INTO and ATTACH would write files even though the database is opened read-only.
_MAY = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE)
# A query, which may be from somebody else, and the views of a file cannot read other files or variables of Python; and no
# temporary file is written beside the database when memory runs out.
_CLOSED: dict[str, Any] = {"enable_external_access": False, "python_enable_replacements": False,
                           "temp_directory": ""}  # fmt: skip
_DUCKDB = 2e8  # least limit of DuckDB's memory in bytes, for its internal structures


def read_database(
    path: Path | str, kind: str, query: str | None = None, table: str | None = None
) -> tuple[pa.Table, list[str]]:
    """Reads the rows of a query, of a table or view, or of the only one in the file.

    Args:
        path: of the file.
        kind: `sqlite` or `duckdb`.
        query: one SELECT in SQL.
        table: name of a table or view.

    Returns:
        The table, and messages.

    Raises:
        UserError: one line: the query fails or is no SELECT, or a table must be named, with those of the file.
    """
    if query is not None and table is not None:
        raise UserError(f"{path}: --query and --table exclude each other; name the table in the query")
    size = file_size(path)  # it also reports why a file cannot be opened, unlike SQLite
    seconds, most = SECONDS.value + size / RATE, max_unpacked(size)
    with reading(path, f"a database of {'SQLite' if kind == 'sqlite' else 'DuckDB'}"):
        found, told = (_sqlite if kind == "sqlite" else _duckdb)(path, query, table, seconds, most)
    for index, name in enumerate(found.column_names):
        if not name.strip():
            raise UserError(f"{path}: column {index + 1} of the query has no name; give it one with AS")
    if twice := repeated(found.column_names):
        raise UserError(f"{path}: the query gives two columns called {twice[0]!r}; rename one with AS")
    return found, told


def _sqlite(path: Path | str, query: str | None, table: str | None, seconds: float, most: float) -> tuple[pa.Table, list[str]]:
    denied: list[int] = []

    def allowed(action: int, *_: Any) -> int:
        if action in _MAY:
            return sqlite3.SQLITE_OK
        denied.append(action)
        return sqlite3.SQLITE_DENY

    taken = 0

    def measured(rows: sqlite3.Cursor) -> Iterator[tuple[Any, ...]]:
        """Rows one by one, because a batch of them could exceed the memory."""
        nonlocal taken
        for row in rows:
            if (taken := taken + sum(map(sys.getsizeof, row))) > most:
                raise beyond(path, taken, most, UNPACKED, "unpacks to")
            yield row

    place = f"file:{quote(str(Path(path).absolute()))}?mode=ro"
    try:
        with contextlib.closing(sqlite3.connect(place, uri=True)) as base:
            base.set_authorizer(allowed)
            base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, int(min(most, 2**31 - 1)))  # of one value, which a view may compute
            until = time.monotonic() + seconds
            base.set_progress_handler(lambda: time.monotonic() > until, _STEPS)  # a view may have infinitely many rows
            if query is None:
                listed = base.execute(
                    "SELECT name FROM sqlite_master WHERE type IN ('table', 'view') AND name NOT LIKE 'sqlite_%' ORDER BY name"
                )
                query = _all_of(path, {name: _quoted(name) for (name,) in listed}, table)
            rows = base.execute(query)
            if rows.description is None:
                raise UserError(f"{path}: --query takes a SELECT, which gives rows, not {query[:60]!r}")
            names = [name for name, *_ in rows.description]
            columns: list[list[Any]] = [[] for _ in names]
            while batch := list(itertools.islice(measured(rows), _BATCH)):
                for values, more in zip(columns, zip(*batch, strict=True), strict=True):
                    values.extend(more)
    except (sqlite3.Error, sqlite3.Warning) as error:  # a Warning is for several statements
        if denied:
            raise UserError(f"{path}: --query takes a SELECT that only reads tables of the file, not {query!r:.80}") from error
        raise _wrong(path, "SQLite", error, query, seconds) from error
    arrays, told = [], []
    for name, values in zip(names, columns, strict=True):
        array, lines = column_of(path, f"column {name}", values, lambda row: f"row {row}", decimal=True)
        arrays.append(array)
        told += lines
    return pa.table(arrays, names=names), told


def _duckdb(path: Path | str, query: str | None, table: str | None, seconds: float, most: float) -> tuple[pa.Table, list[str]]:
    try:
        import duckdb
    except ImportError as error:
        raise UserError(f"{path}: DuckDB's files are read with duckdb: {extra('tables')}") from error
    try:
        config = _CLOSED | {"memory_limit": f"{int(max(most, _DUCKDB))}B"}
        with contextlib.closing(duckdb.connect(str(path), read_only=True, config=config)) as base:
            if query is None:
                listed = base.execute("SELECT table_schema, table_name FROM information_schema.tables ORDER BY 1, 2").fetchall()
                known = {
                    name if schema == "main" else f"{schema}.{name}": f"{_quoted(schema)}.{_quoted(name)}"
                    for schema, name in listed
                }
                query = _all_of(path, known, table)
            statements = base.extract_statements(query)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise UserError(f"{path}: --query takes one SELECT, which gives rows, not {query[:60]!r}")
            ends = threading.Timer(seconds, base.interrupt)
            ends.start()
            taken = 0
            try:
                asked: Any = base.sql(query)
                read = getattr(asked, "to_arrow_reader", None) or asked.fetch_record_batch  # its name in older versions
                rows = read(_BATCH)
                batches: list[pa.RecordBatch] = []
                for batch in rows:
                    batches.append(batch)
                    if (taken := taken + batch.nbytes) > most:
                        raise beyond(path, taken, most, UNPACKED, "unpacks to")
                found = pa.Table.from_batches(batches, rows.schema)
            finally:
                ends.cancel()
    except (duckdb.Error, OSError, pa.ArrowException) as error:  # Arrow raises DuckDB's errors within batches
        raise _wrong(path, "DuckDB", error, query, seconds) from error
    for name, values in zip(found.column_names, found.columns, strict=True):
        if pa.types.is_binary(values.type) or pa.types.is_large_binary(values.type):
            raise UserError(f"{path}: column {name} holds binary data, which agents cannot use; leave it out with --query")
    return found, []


def _all_of(path: Path | str, known: dict[str, str], table: str | None) -> str:
    """The query for all rows of a table; `known` is {name: quoted name in SQL} of all tables."""
    if table is None and len(known) != 1:
        if not known:
            raise UserError(f"{path}: the database has no tables")
        listed = ", ".join(known)
        raise UserError(f"{path}: which table is it? --table NAME, or --query 'SELECT ...'; it has {listed}")
    if table is not None and table not in known:
        raise UserError(f"{path}: {unknown('table', table, known)}")
    return f"SELECT * FROM {known[table] if table is not None else next(iter(known.values()))}"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _wrong(path: Path | str, what: str, error: Exception, query: str | None, seconds: float) -> UserError:
    text = as_one_line(error)
    if "interrupt" in text.lower():
        how = f"{SECONDS.variable} sets another limit"
        return UserError(f"{path}: {what} has not ended {str(query)[:80]!r} after {seconds:.0f} s; {how}")
    if query is None or "not a database" in text or "malformed" in text or "disk image" in text:
        return UserError(f"{path}: cannot be read as a database of {what}, it is damaged or in use ({text})")
    return UserError(f"{path}: {what} cannot run {query[:80]!r} ({text})")
