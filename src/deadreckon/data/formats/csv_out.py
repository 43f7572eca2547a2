"""Writing of CSV: texts that a spreadsheet would take for formulas are neutralised, numbers stay numbers.

A spreadsheet evaluates cells that begin with certain characters, and a formula can start programs or send the table elsewhere
(`=cmd|...`, `@SUM(...)`). Names of columns and levels are from the author of the log, who need not be trusted.
"""

import csv
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa
from pyarrow import csv as arrow_csv

# The characters, also full-width, which spreadsheets treat alike; and those that they skip before them or split cells at.
_FORMULA = re.compile(r"\s*[=+\-@＝＋－＠]|[\t\r\n]")
# Numbers, percentages and lone signs evaluate to themselves.
_HARMLESS = re.compile(r"\s*[+-]?((\d+([.,]\d+)*[.,]?|[.,]\d+)(e[+-]?\d+)?|inf|nan)?\s?%?\s*", re.IGNORECASE)


def cell(value: Any) -> Any:
    """`value` as a cell: a text that a spreadsheet would evaluate gets an apostrophe in front, others are unchanged."""
    if isinstance(value, str) and _FORMULA.match(value) and not _HARMLESS.fullmatch(value):
        return f"'{value}"
    return value


def plain(text: str) -> str:
    """The text that `cell` has written: without the apostrophe in front of what a spreadsheet would evaluate."""
    return text[1:] if text.startswith("'") and cell(text[1:]) == text else text


def write_rows(file: TextIO, rows: Iterable[Iterable[Any]], end: str = "\r\n") -> None:
    """Writes rows of cells to a file that is open for text."""
    csv.writer(file, lineterminator=end).writerows([cell(value) for value in row] for row in rows)


def write_table(table: pa.Table | Mapping[str, Any], path: Path | str) -> None:
    """Writes a table, or columns by name, to `path`; not atomic by itself, see `files.replacing`."""
    whole = pa.table(dict(table)) if isinstance(table, Mapping) else table
    columns = [_neutral(column) for column in whole.columns]
    arrow_csv.write_csv(pa.Table.from_arrays(columns, [cell(name) for name in whole.column_names]), path)


def _neutral(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """The column with neutralised texts, of a type that Arrow can write as CSV."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_string_view(column.type):
        column = column.cast(pa.large_string())
    kind, keep = column.type, "surrogateescape"
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind) or pa.types.is_fixed_size_binary(kind):
        texts = [each and cell(each.decode(errors=keep)).encode(errors=keep) for each in column.to_pylist()]
        return pa.chunked_array([texts], pa.binary())  # whose bytes are written as they are
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return column
    found = {each: changed for each in column.unique().to_pylist() if (changed := cell(each)) != each}
    return pa.chunked_array([[found.get(each, each) for each in column.to_pylist()]], kind) if found else column
