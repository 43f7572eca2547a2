"""Categorical columns that contain only words for missing values, such as none.

pyarrow, which determines the types of a text file's columns, takes a column of nothing but such words for an empty one. An
action `none` must not be lost, so such categorical columns are read again, as texts.
"""

from collections.abc import Mapping
from typing import Any, BinaryIO

import pyarrow as pa
from pyarrow import csv

from deadreckon.data import roles
from deadreckon.data.formats.cells import MISSING, Known
from deadreckon.data.formats.spool import Spool


def levels_in(mapping: Mapping[str, Any]) -> Known:
    """The columns of a table whose levels may be such words, by the roles of columns.

    With a schema also the columns of texts whose levels it lists, and those of flags, regardless of their cells in this table.

    Args:
        mapping: the roles of columns, as for `from_frame`; a schema is a `Schema`.
    """
    if (schema := mapping.get("schema")) is not None:
        categories = [column for column in schema.columns if column.kind == "category"]
        words = frozenset(each.name for each in categories if each.levels is None or {*each.levels} & {*MISSING})
        listed = frozenset(each.name for each in categories if each.levels is not None and any(map(is_word, each.levels)))
        lists = frozenset(each.name for each in schema.having("legal", "next_legal"))
        return Known(listed, frozenset(each.name for each in schema.columns if each.kind == "flag"), lists, words)
    action, *lists = (mapping.get(role) for role in ("action", "legal", "next_legal"))
    return Known(lists=frozenset().union(*map(_names, lists)) or None, words=None if action is None else _names(action))


def _names(asked: Any) -> frozenset[str]:
    """The columns that an option names; none if it is a function."""
    return frozenset() if callable(asked) else frozenset([asked] if isinstance(asked, str) else asked or ())


def is_word(level: Any) -> bool:
    """Whether a level is a text, other than true and false, to which columns of yes and no are converted."""
    return isinstance(level, str) and level not in ("true", "false")


def with_words(
    table: pa.Table, source: BinaryIO, options: tuple[csv.ReadOptions, csv.ParseOptions], spool: Spool | None, known: Known
) -> pa.Table:
    """The table with the words of categorical columns that pyarrow took for empty.

    Args:
        table: as pyarrow has read it.
        source: the text file.
        options: with which it was read.
        spool: where columns are kept; None: in memory.
        known: its `words` are the names of categorical columns; None: those that are named like an action.
    """
    empty = [name for name in table.column_names if pa.types.is_null(table.column(name).type)] if _distinct(table) else []
    held = {name: roles.like("action", name.strip()) if known.words is None else name.strip() in known.words for name in empty}
    names = [name for name in empty if held[name]]
    if not names:
        return table
    if spool is not None:
        found = spool.cells.select(names).cast(pa.schema([(name, pa.string()) for name in names]))
    else:
        source.seek(0)
        as_they_stand = csv.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.string()))
        found = csv.read_csv(source, *options, as_they_stand)
    for name in names:
        table = table.set_column(table.column_names.index(name), name, found.column(name))
    return table


def _distinct(table: pa.Table) -> bool:
    return len(set(table.column_names)) == table.num_columns
