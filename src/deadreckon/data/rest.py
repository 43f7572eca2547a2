"""What a column is that nobody asked for and whose name gives it no role: an observation, unless its values say otherwise."""

import re
from typing import Any, NamedTuple

import pyarrow as pa

from deadreckon.data import roles
from deadreckon.data.arrow import (
    as_dates,
    compute,
    decoded,
    distinct,
    is_missing,
    is_text,
    levels_of_whole_numbers,
    says_numbers,
)
from deadreckon.data.likeness import FEW, likeness
from deadreckon.data.schema import Kind, Role

FREE_TEXT = 50  # different texts beyond which a column may be comments or identifiers: if there are fewer than ten rows of each
_COUNTED = 20  # rows from which a column of consecutive numbers is taken to count them
_CODED = re.compile(r"(code|type|class|kind|category|cat|group|region|zone|zip|postcode|status)$", re.IGNORECASE)


def _counts(values: Any) -> bool:
    """Whether a column numbers its rows, from any number on and in any order."""
    if not pa.types.is_integer(values.type) or len(values) < _COUNTED or is_missing(values).any():
        return False
    low, high = compute.min_max(values).as_py().values()
    return high - low == len(values) - 1 and distinct(values) == len(values)


class Rest(NamedTuple):
    """The role of a column, why, and what should be checked (empty where nothing)."""

    role: Role
    why: str
    doubt: str = ""


def rest(column: str, values: Any, kind: Kind | None) -> Rest:
    """The role of a column that is left.

    Args:
        column: its name.
        values: (rows,) of it.
        kind: that was asked for, or None.
    """
    rows = len(values)
    if is_missing(values).all():
        return Rest("ignore", "empty", "is empty and is left out of the observations")
    if kind is None and is_text(values.type) and as_dates(values) is not None:
        how = f"--time {column} orders rows by it"
        return Rest("ignore", "a date", f"holds dates and is left out of the observations ({how})")
    if kind is None and is_text(values.type) and not says_numbers(values):
        many = distinct(values)
        # A text among numbers is a mistake, which is refused with its row when the column is encoded.
        if many > FREE_TEXT and many > rows / 10 and not likeness(decoded(values)).mistaken:
            text = f"has {many:,} different texts in {rows:,} rows and is left out as free text or identifier"
            return Rest("ignore", "free text or an identifier", f"{text} (--keep {column}, or --kinds {column}=category)")
    doubt = ""
    if roles.like("time", column):
        text = "looks like a time and is read as an observation"
        doubt = f"{text}: --time {column} orders rows by it, --ignore {column} leaves it out"
    elif roles.IDENTITY.search(column.lower()):
        text = "looks like a name, and is read as an observation"
        doubt = f"{text}: --keep {column} stores it with the log, --ignore {column} leaves it out"
    elif kind is None and _counts(values):
        text = "has whole numbers without gaps, each once, as numbers of rows or orders are, and is read as an observation"
        doubt = f"{text}: --keep {column} stores it with the log, --ignore {column} leaves it out"
    elif kind is None and _CODED.search(column) and 2 < len(levels_of_whole_numbers(values, True) or ()) <= FEW:
        doubt = f"holds whole numbers that may be codes, and is read as a number (--kinds {column}=category)"
    return Rest("observation", "no other role", doubt)
