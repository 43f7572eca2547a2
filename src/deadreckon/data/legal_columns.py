"""Which actions are legal, as tables say it: a column that lists them, or a 0/1 column for each."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import (
    decoded,
    few_values,
    flags,
    flat,
    is_category,
    is_missing,
    is_text,
    levels_of_whole_numbers,
)
from deadreckon.data.formats.cells import TRUTHS
from deadreckon.data.roles import like
from deadreckon.data.schema import Column
from deadreckon.errors import UserError, unknown

_SEPARATORS = ("|", ";", ",", " ")  # of the actions in a text, the first that occurs in the column


def listed_levels(name: str, table: pa.Table, columns: Sequence[Column]) -> list[str]:
    """The actions, as texts, that columns of legal actions name, each once in the order in which they appear.

    Args:
        name: of the log, for errors.
        table: it.
        columns: of the role legal or next_legal.
    """
    found: dict[str, None] = {}
    for column in columns:
        cells = [[str(column.of)]] if column.of is not None else _cells(name, table, column.name)
        found |= dict.fromkeys(each for cell in cells for each in cell or ())
    return list(found)


def masks(
    name: str, table: pa.Table, columns: Sequence[Column], levels: Sequence[Any], last: np.ndarray
) -> dict[str, np.ndarray]:
    """{role: (rows, n) bool, which actions are legal} of columns of the roles legal and next_legal; see `_mask`.

    Where actions are true and false, as those of a text file with yes and no are, its words for them mean these. Cells of
    next_legal may be empty in rows without a known next observation, `last` (rows,).
    """
    return {
        role: _mask(
            name, table, [column for column in columns if column.role == role], levels, last & (role == "next_legal")
        )
        for role in dict.fromkeys(column.role for column in columns)
    }  # fmt: skip


def _mask(name: str, table: pa.Table, columns: Sequence[Column], levels: Sequence[Any], free: np.ndarray) -> np.ndarray:
    """(rows, n) bool, which actions are legal; all of them in rows that are `free` (rows,) to be empty, and are.

    Args:
        name: of the log, for errors.
        table: it.
        columns: one that lists actions, or a 0/1 column for each of them, in any order, each with `of`.
        levels: the actions in the order of their codes.

    Raises:
        UserError: a column names an action that there is not, none names one that there is, or a cell is empty.
    """
    place = {_text(level): code for code, level in enumerate(levels)}
    said = _truth if place.keys() <= {"true", "false"} else str
    mask = np.zeros((table.num_rows, len(levels)), bool)
    if len(columns) == 1 and columns[0].of is None:
        column = columns[0].name
        for row, cell in enumerate(_cells(name, table, column)):
            if cell is None and free[row]:
                mask[row] = True
                continue
            if cell is None:
                raise UserError(f"{name}: column {column} is empty in row {row}; it must list the actions that are legal there")
            for level in map(said, cell):
                if level not in place:
                    raise UserError(f"{name}: column {column}, row {row}: {unknown('action', level, list(place))}")
                mask[row, place[level]] = True
        return mask
    told = set()
    for column in columns:
        if column.of is None:
            text = f"column {column.name} is one of several that say which actions are legal, and needs of = ACTION"
            raise UserError(f"{name}: {text}; actions are {', '.join(place)}")
        if (of := said(str(column.of))) not in place:
            raise UserError(f"{name}: column {column.name}: {unknown('action', of, list(place))}")
        mask[:, place[of]] = flags(name, table, column.name, free)
        told.add(of)
    if missing := [level for level in place if level not in told]:
        raise UserError(f"{name}: no column says where action {missing[0]} is legal (of = {json.dumps(missing[0])})")
    return mask


def is_list(values: Any) -> bool:
    """Whether a column holds lists or texts, which may name several actions."""
    return pa.types.is_list(values.type) or pa.types.is_large_list(values.type) or is_text(values.type)


def _cells(name: str, table: pa.Table, column: str) -> list[list[str] | None]:
    """Per row the actions that a column lists, as texts; None where it is empty."""
    values = flat(table, column)
    if not is_list(values):
        text = f"column {column} holds {values.type}, lists of actions or texts such as a|b are needed"
        raise UserError(f"{name}: {text}, or a 0/1 column for each action with of = ACTION")
    gone = is_missing(values)
    cells = decoded(values).to_pylist()
    texts: dict[str, Any] = {}
    if is_text(values.type):  # few different ones, which are looked at once
        try:
            texts = {cell: _unwrapped(cell) for cell, missing in zip(cells, gone) if not missing}
        except RecursionError as error:
            raise UserError(f"{name}: column {column} has lists in lists without end; a list of actions is needed") from error
    for row, cell in enumerate(cells):
        found = texts.get(cell) if isinstance(cell, str) else cell
        if isinstance(found, list) and None in found:
            raise UserError(f"{name}: column {column} lists an empty action in row {row}; leave such entries out of the list")
        if isinstance(found, list) and any(isinstance(each, list | dict) for each in found):
            raise UserError(f"{name}: column {column} has lists in a list in row {row}; a list of actions is needed")
    if not is_text(values.type):
        return [None if missing else [_text(each) for each in cell] for cell, missing in zip(cells, gone)]
    plain = [text for text in texts.values() if isinstance(text, str)]
    separator = next((each for each in _SEPARATORS if any(each in text for text in plain)), None)
    parts = {cell: _parts(text, separator) if isinstance(text, str) else text for cell, text in texts.items()}
    listed = {cell: [_text(each) for each in part] for cell, part in parts.items()}
    return [None if missing else listed[cell] for cell, missing in zip(cells, gone)]


def _unwrapped(cell: str) -> str | list[Any]:
    """The actions of a cell that is a list in JSON; of another one the text within its brackets."""
    text = cell.strip()
    if text.startswith("["):
        try:
            return json.loads(text)
        except ValueError:  # also of a number of thousands of digits
            pass
    inner = text[1:-1]
    wrapped = text[:1] + text[-1:] in ("[]", "()", "{}") and not set(inner) & {text[0], text[-1]}
    return inner if wrapped else text


def _parts(text: str, separator: str | None) -> list[Any]:
    """The actions that a text lists, without the quotes around each."""
    parts = [part.strip() for part in text.split(separator)]
    bare = [part[1:-1] if len(part) > 1 and part[0] == part[-1] and part[0] in "'\"" else part for part in parts]
    return [_number(part) for part in bare if part]


def _number(text: str) -> Any:
    """A text as the number it says, so that 2.0 and 2 are one action; else the text."""
    return float(text) if re.fullmatch(r"-?\d+\.0+", text) else text


def _text(level: Any) -> str:
    """An action as it is compared: 2.0 as 2, true and false as the texts that they become in a file."""
    if isinstance(level, bool):
        return str(level).lower()
    return str(int(level)) if isinstance(level, float) and level.is_integer() else str(level)


def _truth(text: str) -> str:
    """An action that is true or false, whatever word says so."""
    return TRUTHS.get(text.lower(), text)


def find_legal(
    name: str, table: pa.Table, role: str, asked: str | Sequence[str] | None, actions: Sequence[str], free: Sequence[str]
) -> dict[str, str | None]:
    """{column: the action it is for, or None where it lists them} that say which actions are legal.

    Args:
        name: of the log, for errors.
        table: it.
        role: legal or next_legal.
        asked: columns, or the beginning of names that end in an action (legal for legal_a, legal_b); None: by their names.
        actions: columns of the logged actions; only one can have legal values.
        free: columns that have no other role.

    Raises:
        UserError: a column that was asked for does not exist, or there is not one action.
    """
    if len(actions) != 1:
        if asked is None:
            return {}
        raise UserError(f"{name}: legal actions need one action column, {len(actions)} are known (--action)")
    logged = decoded(flat(table, actions[0]))
    if pa.types.is_nested(logged.type):
        raise UserError(f"{name}: column {actions[0]} holds {logged.type}, an action is one plain value in each row")
    values = few_values(logged)
    levels = set() if values is None else {_text(value) for value in values.to_pylist()}
    said, words, fold = (_truth, {*TRUTHS}, str.lower) if pa.types.is_boolean(logged.type) else (str, levels, str)
    if asked is None:
        listing = [column for column in free if levels and like(role, column) and is_list(flat(table, column))]
        taken = [_text(each) for each in logged.to_pylist()] if listing else []
        for column in listing:
            cells = [[*map(said, cell or [])] for cell in _cells(name, table, column)]
            # A name alone says little: now the logged action is listed in its row, and not it alone everywhere.
            own = role == "next_legal" or all(one in cell for one, cell in zip(taken, cells))
            if own and any(len(cell) > 1 for cell in cells) and levels >= {each for cell in cells for each in cell}:
                return {column: None}
        starts = dict.fromkeys(c[: -len(a) - 1] for c in free for a in words if fold(c).endswith(f"_{a}"))
        found = [_for_actions(start, free) for start in starts if like(role, start)]
        return next((columns for columns in found if levels <= {said(str(of)) for of in columns.values()}), {})
    columns: dict[str, str | None] = {}
    for each in [asked] if isinstance(asked, str) else asked:
        if each in table.column_names:
            of = next((a for a in sorted(words, key=len, reverse=True) if fold(each).endswith(f"_{a}")), None)
            columns[each] = None if is_list(flat(table, each)) else of
        elif found := _for_actions(each.removesuffix("_"), table.column_names):
            columns |= found
        else:
            raise UserError(f"{name}: {unknown('column', each, table.column_names)}")
    return columns


def _for_actions(start: str, names: Sequence[str]) -> dict[str, str | None]:
    """{column: action} of those of `names` that are called `start`, an underscore and an action."""
    return {each: each.removeprefix(f"{start}_") for each in names if each.startswith(f"{start}_")}


def with_levels(name: str, table: pa.Table, actions: Sequence[Column], listed: Sequence[str]) -> Column:
    """The column of the actions, with those of the table and those that are only `listed` as legal among its levels.

    Raises:
        UserError: actions are several or continuous, or a listed one is of another kind than those of the table.
    """
    if len(actions) != 1:
        raise UserError(f"{name}: legal actions need one discrete action, the table has {len(actions)} action columns")
    action = actions[0]
    if action.kind == "number":
        text = f"column {action.name} is a continuous action, and only discrete ones can be illegal"
        raise UserError(f"{name}: {text} (--kinds {action.name}=integer makes it discrete)")
    if action.levels is not None:
        return action
    values = flat(table, action.name)
    if is_category(values.type):
        texts = {_text(value) for value in decoded(values).drop_null().unique().to_pylist()}
        said = _truth if pa.types.is_boolean(values.type) else str
        return replace(action, levels=tuple(sorted(texts | {*map(said, listed)})))
    whole = levels_of_whole_numbers(values)
    if wrong := [each for each in listed if not re.fullmatch(r"-?\d+", each)]:
        text = f"{wrong[0]!r} is said to be legal, but actions (column {action.name}) are whole numbers"
        raise UserError(f"{name}: {text}")
    return replace(action, levels=tuple(sorted({*(whole or ()), *map(int, listed)})))
