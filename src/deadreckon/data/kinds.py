"""Of which kind the values of a column are: numbers, whole numbers, levels, flags or dates."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data import roles
from deadreckon.data.arrow import (
    as_dates,
    compute,
    decoded,
    few_values,
    is_category,
    is_text,
    levels_of_whole_numbers,
    says_numbers,
)
from deadreckon.data.legal_columns import is_list
from deadreckon.data.likeness import FEW
from deadreckon.data.placeholders import placeholder
from deadreckon.data.schema import ALLOWED, KINDS, Kind, Role
from deadreckon.errors import UserError, unknown

_DIGITS = r"\d+([.,]\d+)?|\d{1,3}([.,]\d{3})+([.,]\d+)?"
_NUMBER = re.compile(rf"\s*[-+]?({_DIGITS})\s*(?P<unit>([^\W\d_]|[°%€$£µ])\S{{0,7}})?\s*")  # with a unit, if any
_FEWEST, _MOSTLY = 20, 0.8  # levels from which on, and share of them with which, texts are said to be numbers
_EXACT = 2**24  # up to which float32 holds every integer
MOST_DISCRETE = 100  # different whole numbers in a column of actions beyond which it is read as continuous


def columns_like(table: pa.Table, prefix: str, name: str) -> list[str]:
    """The column `prefix`, or those called prefix_0, prefix_1, ... in the order of their numbers.

    Raises:
        UserError: neither exists, with the nearest names.
    """
    if prefix in table.column_names:
        return [prefix]
    found = roles.numbered(table.column_names, prefix)
    if not found:
        check_column(table, prefix, name)
    return found


def check_column(table: pa.Table, column: str, name: str) -> None:
    """Refuses a column that is not there, with the nearest names."""
    if column not in table.column_names:
        raise UserError(f"{name}: {unknown('column', column, table.column_names)}")


def kind_of(column: str, values: Any, role: Role, alone: bool, asked: Kind | None) -> tuple[Kind, str, str]:
    """The kind of a column, why, and what should be checked (empty where nothing).

    Args:
        column: its name.
        values: (rows,) of it.
        role: of the column.
        alone: whether there is one action.
        asked: the kind that is asked for, or None.
    """
    if asked is not None:
        return asked, "asked for", ""
    if role in ("legal", "next_legal"):
        return ("category", "lists actions", "") if is_list(values) else ("flag", "truth values of one action", "")
    kind, reason = _stored(values)
    if kind == "category" and role not in ("action", "observation", "next_observation") and as_dates(values) is not None:
        kind, reason = "date", "texts that are dates"
    if role == "action":
        kind, reason, doubt = _action(column, values, kind, alone)
        return kind, reason, doubt or (placeholder(values, "leave such rows out") if kind == "number" else "")
    if role in ("observation", "next_observation") and kind == "category" and says_numbers(values):
        doubt = f"holds numbers as texts, and is read as numbers (--kinds {column}=category)" if role == "observation" else ""
        return "number", "texts that are numbers", doubt
    if role == "observation" and kind == "category":
        levels = _texts(values)
        return kind, reason, _measured(levels) or _alike(levels)
    if role in ("observation", "reward", "cost") and (doubt := placeholder(values)):
        return kind if role == "observation" else "number", reason, doubt
    if role == "observation" and (doubt := _rounded(values)):
        return kind, reason, doubt
    # What does not go with the role is refused when it is encoded, with the value that is wrong.
    return (kind, reason, "") if kind in ALLOWED.get(role, KINDS) else ("number", reason, "")


def _action(column: str, values: Any, kind: Kind, alone: bool) -> tuple[Kind, str, str]:
    """Whether an action is discrete or continuous."""
    only = few_values(values, 1)
    same = only is not None and len(only) == 1
    constant = "is an action that never changes, so nothing is known of other actions" if same else ""
    if kind == "category":
        return kind, "texts", constant or _alike(_texts(values))
    levels = levels_of_whole_numbers(values)
    few = levels is not None and len(levels) <= FEW
    if not alone:
        doubt = "holds whole numbers and is one of several actions: it is read as continuous" if few else ""
        return "number", "one of several actions", doubt
    if kind == "flag":
        return kind, "truth values", constant
    if levels is None:
        return "number", "numbers", constant
    count, as_number = len(levels), f"(--kinds {column}=number makes it continuous)"
    if kind != "integer":
        if levels[0] not in (0, 1) or count != levels[-1] - levels[0] + 1 or not few or constant:
            return "number", "numbers", constant
        doubt = f"holds the whole numbers {levels[0]} to {levels[-1]} with a decimal point"
        return "integer", "whole numbers with a decimal point", f"{doubt} and is read as {count} discrete actions {as_number}"
    if count > MOST_DISCRETE:
        doubt = f"has {count:,} different whole numbers and is read as a continuous action"
        doubt += f" (--kinds {column}=integer makes each a discrete one)"
        return "number", f"more than {MOST_DISCRETE} whole numbers", doubt
    doubt = constant if few else f"has {count} different whole numbers and is read as {count} discrete actions {as_number}"
    return kind, f"{count} whole numbers", doubt


def _texts(values: Any) -> list[str]:
    """The different texts of a column, if they are few."""
    levels = few_values(decoded(values))
    return levels.to_pylist() if levels is not None and is_text(levels.type) else []


def _alike(levels: list[str]) -> str:
    """What to say of texts that are empty, or differ in blanks or in upper and lower case alone and are probably one level."""
    found: dict[str, str] = {}
    for level in levels:
        if not level.strip():
            return f"has the empty text {level!r} as a level like others; make it a missing value if it stands for none"
        other = found.setdefault(" ".join(level.lower().split()), level)
        if other != level:
            return f"has levels that differ in blanks or capitals alone, such as {other!r} and {level!r}"
    for lower, level in found.items():
        if (of := lower.removesuffix(" total").removesuffix(" ergebnis")) != lower and of in found:
            return f"has {level!r} beside {found[of]!r}, as subtotals are called: leave such rows out if they sum others up"
    return ""


def _measured(texts: list[str]) -> str:
    """What to say of texts most of which are a number and, perhaps, its unit."""
    if len(texts) < _FEWEST:
        return ""
    found = {text: match for text in texts if (match := _NUMBER.fullmatch(text))}
    units = Counter(match["unit"] for match in found.values()).most_common(1)
    if not units or units[0][1] <= _MOSTLY * len(texts):
        return ""
    found = [text for text, match in found.items() if match["unit"] == units[0][0]]
    how = ["leave units out of the cells"] if units[0][0] else []
    if any("," in text for text in found):
        thousands = all(re.search(r",\d{3}(?!\d)", text) for text in found if "," in text)
        how.append(f"give --{'thousands' if thousands else 'decimal'} comma")
    how = " and ".join(how)
    told = f"holds texts that begin with a number, such as {found[0]!r}, and is read as {len(texts):,} levels"
    return f"{told}: for numbers, {how or 'correct the others'}"


def _rounded(values: Any) -> str:
    """What to say of integers between which float32, in which observations are kept, does not tell."""
    ends = compute.min_max(values).as_py().values() if pa.types.is_integer(values.type) else ()
    if not any(end is not None and abs(end) > _EXACT for end in ends):
        return ""
    different = values.drop_null().unique().to_numpy(zero_copy_only=False)
    lost = len(different) - len(np.unique(different.astype(np.float32)))
    text = f"holds whole numbers beyond {_EXACT:,}, of which {lost:,} become equal to others in float32"
    return f"{text}: subtract a constant from quantities, and keep or ignore dates and names" if lost else ""


def asked_kinds(given: Mapping[str, str] | Sequence[str], table: pa.Table, name: str) -> dict[str, Kind]:
    """Kinds that are asked for, as a mapping or as texts such as dose=number; a prefix stands for its numbered columns."""
    pairs = given.items() if isinstance(given, Mapping) else [tuple(each.rpartition("=")[::2]) for each in given]
    kinds: dict[str, Any] = {}
    for column, kind in pairs:
        if not column:
            raise UserError(f"--kinds takes COLUMN=KIND, such as dose=number, got {kind!r}")
        if kind not in KINDS:
            raise UserError(f"{name}: {unknown('kind', kind, KINDS)}")
        kinds |= dict.fromkeys(columns_like(table, column, name), kind)
    return kinds


def _stored(values: Any) -> tuple[Kind, str]:
    """The kind that the stored type of a column suggests, and why."""
    kind = values.type
    if pa.types.is_boolean(kind):
        return "flag", "truth values"
    if is_category(kind):
        return "category", "texts" if is_text(kind) else "categories"
    if pa.types.is_temporal(kind):
        return "date", "dates"
    return ("integer", "whole numbers") if pa.types.is_integer(kind) else ("number", "numbers")
