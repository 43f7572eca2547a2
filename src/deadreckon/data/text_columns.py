"""Texts of dates and flags in tables whose columns have types (data frames, Parquet), read as they are in text files."""

from collections.abc import Collection, Iterable
from typing import Any

import pyarrow as pa

from deadreckon.data.arrow import SAMPLE, all_match, compute, decoded, is_text
from deadreckon.data.formats.cells import MISSING, flags_of, without
from deadreckon.data.formats.dates import dates_of

# The forms whose texts are not in the order of time; those of ISO 8601 are, and are read where they are used.
_WRITTEN = r"^(?:\d{1,2}[./-]\d{1,2}[./-]\d{4}|\d{4}[./]\d{1,2}[./]\d{1,2})(?:[ ,T].*)?$"


def with_dates(
    table: pa.Table, asked: str | None = None, texts: Collection[str] = ()
) -> tuple[pa.Table, str | None, list[str]]:  # fmt: skip
    """The table, where columns of texts or categories such as 03.04.2024 hold timestamps.

    Args:
        table: of any columns.
        asked: `iso`, `day-first` or `month-first`, or None; see `dates_of`.
        texts: columns that stay as they are.

    Returns:
        The table, the order that was taken (None: there was none to take), and what to tell.
    """
    written = {}
    for name in (name for name, kind in zip(table.column_names, table.schema.types, strict=True) if is_text(kind)):
        if name in texts:
            continue
        values = table.column(name)
        if all_match(_texts(values[:SAMPLE]), _WRITTEN) and all_match(found := _texts(values), _WRITTEN):
            written[name] = found
    done, order, told = dates_of(written, asked, european=False)
    for name, moments in done.items():
        table = table.set_column(table.column_names.index(name), name, moments)
    return table, order, told


def with_flags(table: pa.Table, names: Iterable[str]) -> pa.Table:
    """The table, where the columns of these names that hold texts such as yes and no hold truth values."""
    for name in names:
        if name not in table.column_names or not is_text(table.column(name).type):
            continue
        if (found := flags_of(_texts(table.column(name)), known=True)) is not None:
            table = table.set_column(table.column_names.index(name), name, found[0])
    return table


def _texts(values: pa.ChunkedArray) -> Any:
    """(rows,) texts without blanks around them, and without the words for what is missing."""
    plain = [decoded(chunk).cast(pa.string()) for chunk in values.chunks]
    return without(compute.utf8_trim_whitespace(pa.chunked_array(plain, pa.string())), MISSING)
