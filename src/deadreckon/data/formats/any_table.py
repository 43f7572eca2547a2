"""Reading of tables from files as pyarrow tables: CSV in its dialects, Parquet, spreadsheets, SQLite and DuckDB."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from deadreckon.data.formats.cells import NOTHING, PLAIN, Known, converted
from deadreckon.data.formats.dialect import SEPARATORS, Dialect
from deadreckon.data.formats.kind import DIALECT, READING, no_options, sniff
from deadreckon.data.formats.words import is_word
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError
from deadreckon.foreign.parquet import read_parquet


def table_of_kind(
    path: Path | str, kind: str, ways: Mapping[str, Any], known: Known = NOTHING
) -> tuple[pa.Table, Dialect | None, list[str]]:
    """Reads a table from a file.

    Args:
        path: of the file.
        kind: its format, as returned by `kind.sniff`.
        ways: the options of the reader; what is absent or None is detected from the content:

            - separator: of the columns of a text file: one character, or `comma`, `semicolon`, `tab`, `pipe`, `space`.
            - decimal: decimal separator of a text file: a point or a comma.
            - thousands: thousands separator of a text file: `none`, a point, a comma, a space or an apostrophe.
            - encoding: of a text file: a name that Python knows, such as utf-8, utf-16, latin-1.
            - dates: how texts of dates are read: `iso`, `day-first` or `month-first`.
            - sheet: of a spreadsheet: its name, or its number counted from 1.
            - query: of a database: one SELECT.
            - table: of a database: its name.
        known: the types of some columns, regardless of what their cells look like.

    Returns:
        The table; the dialect of a text file, for other formats only with the order of dates, or None if there are no such
        dates; and messages, one line for each assumption that may be wrong.

    Raises:
        UserError: one line with the file; the file is no table, is damaged, or does not have the option.
    """
    no_options(path, kind, dict(ways))
    separator, decimal, thousands, encoding, dates, sheet, query, table = map(ways.get, READING)
    asked = Dialect.asked(separator, decimal, thousands, encoding, dates)
    from deadreckon.data.formats.totals import of_totals

    if kind == "csv":
        from deadreckon.data.formats.delimited import read_delimited

        found, dialect, told = read_delimited(path, asked, known=known)
        return found, dialect, told + of_totals(found)
    if kind == "parquet":
        from deadreckon.data.text_columns import with_dates

        stored = read_parquet(path)
        found, order, told = with_dates(stored, asked.dates, known.texts)
        for name in stored.column_names:
            known.keep(name, stored[name])
        return found, None if order is None else Dialect(dates=order), told
    if kind == "excel":
        from deadreckon.data.formats.excel import read_excel

        found, told = read_excel(path, sheet)
    elif kind in ("sqlite", "duckdb"):
        from deadreckon.data.formats.database import read_database

        found, told = read_database(path, kind, query, table)
    else:
        raise UserError(f"{path}: this is {kind}, a log with columns of its own, and no table")
    found, order, lines = converted(found, replace(PLAIN, dates=dates), known=known)
    return found, None if order is None else Dialect(dates=order), told + lines + of_totals(found)


def read_rows(
    path: Path | str, schema: Schema, *, plain: dict[str, Any] | None = None, **ways: Any
) -> tuple[pa.Table, list[str]]:  # fmt: skip
    """Reads a file with further rows of a table, with the types of columns in the table's schema.

    A column of texts stays one even if all its cells look like numbers or truth values in this file, and so does a column of
    flags of which only one of the two words occurs.

    Args:
        path: of the file, in any format of tables.
        schema: of the log, resolved.
        plain: a dict with columns as keys, whose values are set to these columns before conversion (texts for a text file).
        **ways: options of `table_of_kind`. Those that are not given are taken from the schema, or else detected.

    Returns:
        The table, and messages, one line for each assumption that may be wrong.

    Raises:
        UserError: see `table_of_kind`.
    """
    used = schema.having("observation", "action", "legal")
    texts = {each.name for each in used if each.kind == "category" and (each.levels is None or any(map(is_word, each.levels)))}
    flags = frozenset(each.name for each in used if each.kind == "flag")
    known = Known(frozenset(texts), flags, plain=plain)
    given = {key: value for key, value in ways.items() if value is not None}
    kind = sniff(path, given.get("separator", schema.options().get("separator")))
    own = {key: value for key, value in schema.options().items() if key in DIALECT and kind in READING[key]}
    assumed = "separator" in own and "separator" not in given
    try:
        table, _, told = table_of_kind(path, kind, {**own, **given}, known)
    except UserError as error:
        if not assumed or "separat" not in str(error):
            raise
        how = f"read with the separator {own['separator']!r} of the schema's log; --separator names another"
        raise UserError(f"{error} ({how})") from error
    if assumed and not any(each.name in table.column_names for each in used):
        head, here = " ".join(table.column_names), table.num_columns - 1  # a name may contain a separator
        if other := next((mark for mark in SEPARATORS if mark != own["separator"] and head.count(mark) > here), None):
            text = f"it is read with the separator {own['separator']!r}, as the schema's log was, and seems to have {other!r}"
            raise UserError(f"{path}: {text}; say --separator {other!r} and, if its decimals have a comma, --decimal comma")
    return table, told
