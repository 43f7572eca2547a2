"""How columns of one kind become numbers of an observation: numbers and flags, categories, and which actions are legal.

With `table_rows` it needs numpy alone, and can be copied with it beside `portable.py`.
"""

import contextlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

if __package__:
    from deadreckon.policies.table_rows import (
        RowsError,
        code_of,
        coded,
        codes_by_level,
        first,
        flags_of,
        is_missing,
        near,
        numbers_of,
        shown,
        text_of,
        word_of_truth,
    )
else:  # copied beside `portable.py`
    from table_rows import (  # pyrefly: ignore[missing-import]
        RowsError,
        code_of,
        coded,
        codes_by_level,
        first,
        flags_of,
        is_missing,
        near,
        numbers_of,
        shown,
        text_of,
        word_of_truth,
    )

_SEPARATORS = ("|", ";", ",", " ")  # of the actions in a text


class Numbers:
    """The columns that are observed as numbers, all at once.

    Args:
        columns: {name: column of the schema}, of kind number, integer or flag.
        held: {name: what the log's column held}, as `data.held` has it.
    """

    def __init__(self, columns: Mapping[str, Mapping[str, Any]], held: Mapping[str, Mapping[str, Any]]):
        self.names = list(columns)
        every = [(column, held[key]) for key, column in columns.items()]
        nan = float("nan")  # what is not known compares as false
        of = lambda given: np.asarray([nan if value is None else value for value in given], np.float64)  # noqa: E731
        self.low, self.high = of(c.get("low") for c, _ in every), of(c.get("high") for c, _ in every)
        self.seen_low, self.seen_high = of(h.get("low") for _, h in every), of(h.get("high") for _, h in every)
        self.flags = np.asarray([column["kind"] == "flag" for column, _ in every], bool)
        self.marked = np.asarray([bool(column.get("marked")) for column, _ in every], bool)
        self.complete = np.asarray([not h.get("missing", 1) for _, h in every], bool)  # in the log, as far as is known
        self.fill = of(h.get("mean") if column.get("fill") is None else column["fill"] for column, h in every)

    def of(
        self, columns: Mapping[str, np.ndarray], count: int, name: str, flag: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(rows, columns) float32 and bool, where they were missing, and (rows,) bool, which rows are outside the log.

        Args:
            columns: {name: (rows,) values}.
            count: rows.
            name: of the rows, for errors.
            flag: whether rows outside the log are marked and not refused.
        """
        values = np.empty((count, len(self.names)))
        for index, key in enumerate(self.names):
            values[:, index] = (flags_of if self.flags[index] else numbers_of)(key, columns[key], name)
        absent = np.isnan(values)

        def refuse(wrong: np.ndarray, why: str) -> None:
            if wrong.any():
                row = first(wrong)
                at = int(np.argmax(wrong[row]))
                key = self.names[at]
                cell = "is empty" if absent[row, at] else f"has {shown(columns[key].tolist()[row])}"
                limits = f"{self.low[at]:g} .. {self.high[at]:g}".replace("nan", "")
                raise RowsError(f"{name}: column {key} {cell} in row {row}, {why.format(limits=limits)}")

        refuse(np.isinf(values), "a finite number is needed")
        beyond = (values < self.low) | (values > self.high)
        if not flag:
            refuse(absent & ~self.marked, "and the log has no missing value there")
            refuse(beyond, "outside the range {limits} that the schema gives")
        refuse(absent & np.isnan(self.fill), "and no replacement for it is known")
        outside = beyond | (values < self.seen_low) | (values > self.seen_high) | (absent & (self.complete | ~self.marked))
        with np.errstate(over="ignore"):
            small = np.where(absent, self.fill, values).astype(np.float32)
        refuse(np.isinf(small), "which float32 cannot hold")
        return small, absent, np.asarray(outside.any(1))


class Category:
    """A column that is observed as one 0/1 number per level.

    Args:
        key: its name.
        column: of the schema, with its levels.
        held: what the log's column held, as `data.held` has it.
    """

    def __init__(self, key: str, column: Mapping[str, Any], held: Mapping[str, Any]):
        self.key, self.levels, self.marked = key, list(column["levels"]), bool(column.get("marked"))
        self.codes, self.complete = codes_by_level(self.levels), not held.get("missing", 1)

    def of(self, values: np.ndarray, name: str, flag: bool) -> tuple[np.ndarray, np.ndarray]:
        """(rows, levels) float32, one more of a column whose missing values are marked; and (rows,) bool, outside the log.

        Args:
            values: (rows,) of it.
            name: of the rows, for errors.
            flag: whether rows outside the log are marked, and become no level, and not refused.
        """
        out, outside = np.zeros((len(values), len(self.levels) + self.marked), np.float32), np.zeros(len(values), bool)
        codes = np.asarray(coded(self.codes, values), np.int64)
        for row in np.flatnonzero(codes < 0).tolist():
            value = values[row : row + 1].tolist()[0]
            if is_missing(value) or (isinstance(value, str) and not value):  # as in files and exported graphs
                if not (flag or self.marked):
                    raise RowsError(f"{name}: column {self.key} is empty in row {row}, and the log has no missing value there")
                outside[row] = self.complete or not self.marked
                out[row, len(self.levels) :] = 1.0
            elif (code := code_of(self.codes, value)) is not None:
                codes[row] = code
            elif flag:
                outside[row] = True
            else:
                raise no_level(name, self.key, value, row, self.levels)
        known = np.flatnonzero(codes >= 0)
        out[known, codes[known]] = 1.0
        return out, outside


def no_level(name: str, key: str, value: Any, row: int, levels: Sequence[Any]) -> RowsError:
    """The error for a value that is none of a column's levels."""
    close = near(text_of(value), levels, "they are")
    return RowsError(f"{name}: column {key} has {shown(value)} in row {row}, which is none of its levels{close}")


class Legal:
    """Which discrete actions are legal.

    Args:
        columns: {name: column of the schema} of the role legal; none where nothing in a table says it.
        actions: the names of the actions, in the order of their codes.
    """

    def __init__(self, columns: Mapping[str, Mapping[str, Any]], actions: Sequence[Any]):
        self.columns, self.actions = columns, [text_of(action) for action in actions]
        self.places = {action: place for place, action in enumerate(self.actions)}
        self.words = word_of_truth if self.places.keys() <= {"true", "false"} else str  # as `data.legal_columns` reads them

    @property
    def strangers(self) -> list[str]:
        """The columns that are for an action which there is not."""
        given = {key: column.get("of") for key, column in self.columns.items()}
        return [key for key, of in given.items() if of is not None and self._named(of) not in self.places]

    def of(self, columns: Mapping[str, np.ndarray], count: int, name: str) -> np.ndarray:
        """(rows, actions) float32, 1 where an action is legal, by the columns of `count` rows."""
        if not self.columns:
            text = "the legal actions of the log come from a function, not from columns"
            raise RowsError(f"{name}: {text}: give legal, truth values of shape ({count}, {len(self.actions)})")
        mask = np.zeros((count, len(self.actions)), np.float32)
        for key, column in self.columns.items():
            if key not in columns:
                raise RowsError(f"{name}: no column {key}, which says which actions are legal{near(key, columns)}")
            if (of := column.get("of")) is not None:
                values = flags_of(key, columns[key], name)
                if np.isnan(values).any():
                    raise RowsError(f"{name}: column {key} is empty in row {first(np.isnan(values))}, 0 or 1 is needed")
                mask[:, self.places[self._named(of)]] = values
                continue
            for row, cell in enumerate(columns[key].tolist()):
                mask[row, [self.places[action] for action in self._listed(key, cell, row, name)]] = 1.0
        return some_legal(mask, name)

    def _named(self, action: Any) -> str:
        """The text of an action, as `actions` has it."""
        return self.words(text_of(action))

    def _listed(self, key: str, cell: Any, row: int, name: str) -> list[str]:
        """The actions that a cell lists, as texts."""
        if is_missing(cell):
            raise RowsError(f"{name}: column {key} is empty in row {row}; it must list the actions that are legal there")
        found = _unwrapped(cell) if isinstance(cell, str) else cell
        if isinstance(found, str):
            ways = [[found], *(found.split(mark) for mark in _SEPARATORS)]
            ways = [[self.words(_bare(part.strip())) for part in parts if part.strip()] for parts in ways]
            parts = next((parts for parts in ways if all(part in self.places for part in parts)), max(ways, key=len))
        else:
            parts = [self._named(each) for each in (found if _is_several(found) else [found])]
        for part in parts:
            if part not in self.places:
                close = near(part, self.actions, "actions")
                raise RowsError(f"{name}: column {key} has {shown(part)} in row {row}, which is no action{close}")
        return parts


def _is_several(cell: Any) -> bool:
    """Whether a cell is a list of actions."""
    return isinstance(cell, list | tuple) or (isinstance(cell, np.ndarray) and cell.ndim > 0)


def _unwrapped(cell: str) -> Any:
    """The actions of a cell that is a list in JSON; of another one the text within its brackets. As `data.legal_columns`."""
    text = cell.strip()
    if text.startswith("["):
        with contextlib.suppress(ValueError, RecursionError):  # also of thousands of digits or brackets, which name no action
            return json.loads(text)
    inner = text[1:-1]
    return inner if text[:1] + text[-1:] in ("[]", "()", "{}") and not set(inner) & {text[0], text[-1]} else text


def _bare(part: str) -> str:
    """An action in a text without quotes around it; 2.0 is 2."""
    part = part[1:-1] if len(part) > 1 and part[0] == part[-1] and part[0] in "'\"" else part
    return re.sub(r"^(-?\d+)\.0+$", r"\1", part)


def some_legal(mask: np.ndarray, name: str) -> np.ndarray:
    """The mask (rows, actions), refused where it allows nothing."""
    if not (some := np.asarray(mask.any(1))).all():
        raise RowsError(f"{name}: no action is legal in row {first(~some)}; at least one must be")
    return mask
