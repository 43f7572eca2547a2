"""Reading of tables from files as pyarrow tables: CSV in its dialects, JSON, Parquet, spreadsheets, SQLite and DuckDB."""

import contextlib
import functools
from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from deadreckon.data.arrow import is_string
from deadreckon.data.formats.cells import NOTHING, PLAIN, Known, converted
from deadreckon.data.formats.dialect import SEPARATORS, Dialect
from deadreckon.data.formats.kind import DIALECT, READING, no_options, sniff
from deadreckon.data.formats.words import is_word
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError
from deadreckon.foreign.parquet import read_parquet

_OF_SEPARATOR = ("separator", "decimal", "thousands")  # what another program that writes tables has otherwise


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
    if kind == "json":
        from deadreckon.data.formats.json_table import read_json_table

        found, told = read_json_table(path, known)
    elif kind == "excel":
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
    lists = frozenset(each.name for each in schema.having("legal"))
    known = Known(frozenset(texts), flags, lists, plain=plain)
    given = {key: value for key, value in ways.items() if value is not None}
    kind = sniff(path, given.get("separator", schema.options().get("separator")))
    own = {key: value for key, value in schema.options().items() if key in DIALECT and kind in READING[key]}
    alone = {key: value for key, value in own.items() if key not in _OF_SEPARATOR}
    asked = Dialect.asked(separator=given.get("separator")).separator
    if asked is not None and asked != Dialect.asked(separator=own.get("separator")).separator:
        own = alone
    if given.keys() & {"decimal", "thousands"}:  # each says something of the other
        own = {key: value for key, value in own.items() if key not in ("decimal", "thousands")}
    numbers = {each.name for each in used if each.kind in ("number", "integer")}
    fits = lambda found: any(each.name in found[0].column_names for each in used)  # noqa: E731
    reading = functools.partial(table_of_kind, path, kind, known=known)
    failure, found = None, None
    try:
        found = reading({**own, **given})
    except UserError as error:
        failure = error
    if "separator" in own and asked is None and (found is None or not fits(found)):
        with contextlib.suppress(UserError):
            if fits(other := reading({**alone, **given})):
                mark = str(other[1].separator if other[1] is not None else None)
                text = f"columns are separated by {SEPARATORS.get(mark, mark)}, and in the log of the schema by"
                line = f"{text} {SEPARATORS.get(own['separator'], own['separator'])}, so marks of numbers are detected anew"
                return other[0], [line, *other[2]]
    if found is None:
        assert failure is not None
        raise failure
    # Columns are converted one by one: under wrong marks 20.125 may be 20125 while 0.5 beside it stays a text.
    if own.keys() & {"decimal", "thousands"} and (odd := _texts_among(found[0], numbers)):
        with contextlib.suppress(UserError):
            if fits(other := reading({**alone, **given})) and not _texts_among(other[0], numbers):
                line = f"numbers in column {odd} are not written as in the log, so marks of numbers are detected anew"
                return other[0], [line, *other[2]]
    return found[0], found[2]


def _texts_among(table: pa.Table, numbers: Set[str]) -> str | None:
    """The first column of `numbers` that is one of texts."""
    return next((name for name in table.column_names if name in numbers and is_string(table[name].type)), None)
