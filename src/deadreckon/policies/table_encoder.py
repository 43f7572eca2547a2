"""Encodes rows of a table as the observations of a policy's training, and names its actions as in the table.

With `table_rows` and `table_columns` it needs numpy alone, so that these can be copied beside `portable.py`. What it goes by is
JSON that every policy file keeps under `meta["log"]` (`runs.reading.noted`): the schema of the log as it was resolved, with
levels, fills and marks of missing values, and what its columns held. What training did is in `data.encode`.

    encoder = TableEncoder(log)
    observations = encoder.encode({"temp": [20.1, None], "mode": ["auto", "manual"]}).observations
    encoder.named(actions)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

if __package__:
    from deadreckon.policies.table_columns import Category, Legal, Numbers, no_level, some_legal
    from deadreckon.policies.table_rows import (
        RowsError,
        code_of,
        codes_by_level,
        columns_of,
        first,
        flags_of,
        is_missing,
        kind,
        listed,
        near,
        numbers_of,
        text_of,
    )
else:  # copied beside `portable.py`
    from table_columns import Category, Legal, Numbers, no_level, some_legal  # pyrefly: ignore[missing-import]
    from table_rows import (  # pyrefly: ignore[missing-import]
        RowsError,
        code_of,
        codes_by_level,
        columns_of,
        first,
        flags_of,
        is_missing,
        kind,
        listed,
        near,
        numbers_of,
        text_of,
    )


class Encoded(NamedTuple):
    """Rows as a policy sees them.

    Attributes:
        observations: (rows, *shape) float32.
        outside: (rows,) bool, which rows lie outside the log.
        single: whether one row was given, and not a table of one.
        columns: {name: (rows,) values} as they were given; None of plain arrays.
    """

    observations: np.ndarray
    outside: np.ndarray
    single: bool
    columns: dict[str, np.ndarray] | None


class TableEncoder:
    """Encodes rows as the log of a policy was encoded.

    Args:
        log: what a policy file keeps of its log, `meta["log"]`; {} where it keeps nothing, so that only arrays can be given.
        name: of the rows, for errors.

    Attributes:
        schema: JSON of the log's schema; None where it was no table, or nothing is known of it.
        observed: {name: column of the schema} of the columns that are observed, in their order; empty if there is no schema.
        actions: likewise of the action columns.
        times: kind of the column that orders rows; None where there is none.
        ends: columns that say where episodes end.
        alone: whether every row of the log is an episode, because none of its columns tells how rows follow one another.
        levels: names of discrete actions in the order of their codes; None where they are their codes, or continuous.
        masked: whether observations end in numbers that say which actions are legal.
        shape: of one observation; None where it is not known.
    """

    def __init__(self, log: Mapping[str, Any], name: str = "rows"):
        extra, space = log.get("extra") or {}, log.get("action_space") or {}
        columns = (extra.get("schema") or {}).get("columns") or {}
        self.name, self.held, self.schema = name, extra.get("held") or {}, extra.get("schema")
        self.observed = {key: column for key, column in columns.items() if column["role"] == "observation"}
        self.actions = {key: column for key, column in columns.items() if column["role"] == "action"}
        legal = {key: column for key, column in columns.items() if column["role"] == "legal"}
        self.one = {column["role"]: key for key, column in columns.items() if column["role"] in ("episode", "time")}
        self.times = next((column["kind"] for column in columns.values() if column["role"] == "time"), None)
        self.ends = [key for key, column in columns.items() if column["role"] in ("terminal", "timeout")]
        following = {"episode", "time", "terminal", "timeout", "next_observation"}
        self.alone = bool(columns) and not following & {column["role"] for column in columns.values()}
        self.used = {*self.actions, *legal, *self.one.values(), *self.ends}
        self.discrete = space.get("kind") == "Discrete" or (len(self.actions) == 1 and _only(self.actions)["kind"] != "number")
        self.levels = _levels(extra.get("action_levels"), self.actions, space.get("n") or 0) if self.discrete else None
        self.count = space.get("n") or (0 if self.levels is None else len(self.levels))  # of discrete actions
        self.masked = bool(space.get("masked") or legal)
        self.allowed = Legal(legal, self.names)
        plain = {key: column for key, column in self.observed.items() if column["kind"] != "category"}
        self.numbers = Numbers(plain, {key: self.held.get(key) or {} for key in plain})
        self.categories = [
            Category(key, column, self.held.get(key) or {})
            for key, column in self.observed.items() if column["kind"] == "category"
        ]  # fmt: skip
        self.places, width = {}, 0  # the first dimension of each column, and how many there are
        for key, column in self.observed.items():
            self.places[key] = width
            width += (len(column["levels"]) if column["kind"] == "category" else 1) + bool(column.get("marked"))
        self.width = width
        self.shape = tuple(log["observation_shape"]) if "observation_shape" in log else None
        if self.observed and self.shape is None:
            self.shape = (width + self.count * self.masked,)

    def encode(self, rows: Any, *, outside: str = "raise", legal: Any = None) -> Encoded:
        """Rows as observations.

        Args:
            rows: a data frame (pandas, polars, Arrow), a dictionary of columns, a list of dictionaries or one dictionary; or
                observations as they are, (rows, *shape) or one of `shape`.
            outside: "raise" refuses rows that the schema does not allow; "flag" marks them, and those beyond the log's ranges.
            legal: (rows, actions) truth values, which discrete actions are legal; None: as the rows' own columns say.

        Raises:
            RowsError: rows that cannot be encoded, or are refused.
        """
        if outside not in ("raise", "flag"):
            raise RowsError(f"outside must be raise or flag, got {outside!r}")
        if legal is not None and not self.masked:
            raise RowsError(f"{self.name}: leave legal out: the log of this policy does not say which actions are legal")
        found = columns_of(rows, self.observed, self.used, self.name)
        if found is None:
            return self._plain(rows, outside, legal)
        columns, count, single = found
        if not self.observed:
            size = "size" if self.shape is None else ", ".join(map(str, self.shape))
            raise RowsError(
                f"{self.name}: this policy has no schema of its log: it was trained on arrays, in a simulator, on a table "
                "without column options (--action, --reward), or by an earlier version; give arrays of observations "
                f"(rows, {size}), or train it again from the table"
            )
        if missing := [key for key in self.observed if key not in columns]:
            raise RowsError(f"{self.name}: no column {missing[0]}{near(missing[0], columns)}")
        flag = outside == "flag"
        if flag and not self.held:
            raise RowsError(f"{self.name}: this policy does not keep the ranges of its log: train it again, or leave flag out")
        out = np.zeros((count, self.width), np.float32)
        values, absent, beyond = self.numbers.of(columns, count, self.name, flag)
        for index, key in enumerate(self.numbers.names):
            place = self.places[key]
            out[:, place] = values[:, index]
            if self.numbers.marked[index]:
                out[:, place + 1] = absent[:, index]
        for category in self.categories:
            place = self.places[category.key]
            coded, far = category.of(columns[category.key], self.name, flag)
            out[:, place : place + coded.shape[1]] = coded
            beyond |= far
        if self.masked:
            mask = self.allowed.of(columns, count, self.name) if legal is None else self._given(legal, count, single)
            out = np.concatenate([out, mask], 1, dtype=np.float32)
        return Encoded(out, beyond, single, columns)

    def _plain(self, rows: Any, outside: str, legal: Any) -> Encoded:
        """Observations that are given as they are."""
        try:
            x = np.asarray(rows, np.float32)
        except (TypeError, ValueError, OverflowError) as error:
            text = f"rows are a data frame, dictionaries or arrays of numbers, got {kind(rows)}"
            if isinstance(error, OverflowError):
                text = "observations hold a number that is too large for float32"
            raise RowsError(f"{self.name}: {text}") from error
        if outside == "flag":
            raise RowsError(f"{self.name}: rows outside the log can be flagged where they have named columns, not in arrays")
        if like(self.shape or ()) is np.uint8:
            if not ((x >= 0) & (x <= 255) & (x == np.round(x))).all():
                raise RowsError(f"{self.name}: images hold whole numbers from 0 to 255")
            x = x.astype(np.uint8)
        rank = 1 if self.shape is None else len(self.shape)
        x = x[None] if (single := x.ndim == rank) else x
        if legal is not None:
            x = np.concatenate([x, self._given(legal, len(x), single)], 1, dtype=np.float32)
        if x.ndim != rank + 1 or (self.shape is not None and x.shape[1:] != self.shape):
            wanted = "(rows, size)" if self.shape is None else f"(rows, {', '.join(map(str, self.shape))})"
            names = f", or be given by the columns {listed(self.observed)}" if self.observed else ""
            raise RowsError(f"{self.name}: observations must have the shape {wanted}{names}; got {np.shape(rows)}")
        if (wrong := ~np.isfinite(x)).any():
            raise RowsError(f"{self.name}: observations hold a number that is not finite in row {first(wrong)}")
        return Encoded(x, np.zeros(len(x), bool), single, None)

    def _given(self, legal: Any, count: int, single: bool) -> np.ndarray:
        """(rows, actions) float32 of truth values that are given beside the rows."""
        mask = np.asarray(legal)
        mask = mask[None] if single and mask.ndim == 1 else mask
        if mask.shape != (count, self.count) or not np.isin(mask, (0, 1)).all():
            text = f"legal must be truth values of shape ({count}, {self.count}), got shape {np.shape(legal)}"
            raise RowsError(f"{self.name}: {text}")
        return some_legal(mask.astype(np.float32), self.name)

    def named(self, actions: Any) -> Any:
        """Actions as the table names them.

        Args:
            actions: (rows,) codes of discrete actions, or (rows, size) continuous ones in the units of the log.

        Returns:
            (rows,) levels or codes, or numbers where one column is the action; {column: (rows,) numbers} of several. Without a
            schema continuous actions stay as they are.
        """
        actions = np.asarray(actions)
        if self.discrete:
            if self.levels is not None and (wrong := actions[(actions < 0) | (actions >= len(self.levels))]).size:
                raise RowsError(f"{self.name}: the policy chose action {wrong[0]}, and its log has {len(self.levels)} actions")
            return actions if self.levels is None else self.levels[actions]
        if not self.actions:
            return actions
        return actions[:, 0] if len(self.actions) == 1 else {key: actions[:, i] for i, key in enumerate(self.actions)}

    def logged(self, columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
        """The actions that rows of a log say were taken: (rows,) codes, -1 where none is given, or (rows, size) with NaN.

        None where the rows have no column of an action.

        Raises:
            RowsError: some action columns are missing, or a value is none of the levels.
        """
        there = [key for key in self.actions if key in columns]
        if not there:
            return None
        if missing := [key for key in self.actions if key not in columns]:
            raise RowsError(f"{self.name}: no column {missing[0]}, which is an action as {there[0]} is")
        if not self.discrete:
            return np.stack([numbers_of(key, columns[key], self.name) for key in self.actions], 1)
        if self.actions[there[0]]["kind"] == "flag":
            flags = flags_of(there[0], columns[there[0]], self.name)
            named = flags_of(there[0], np.asarray(self.names, object), self.name)
            codes = {flag: code for code, flag in reversed([*enumerate(named)])}  # a name that fills up may repeat a level
            found = [-1 if np.isnan(flag) else codes.get(flag) for flag in flags]
        else:
            codes = codes_by_level(self.names)
            found = [-1 if is_missing(value) else code_of(codes, value) for value in columns[there[0]].tolist()]
        if None in found:
            row = found.index(None)
            raise no_level(self.name, there[0], columns[there[0]].tolist()[row], row, self.names)
        return np.asarray(found)

    @property
    def units(self) -> dict[str, str]:
        """{action column: its unit} of those that have one."""
        return {key: column["unit"] for key, column in self.actions.items() if column.get("unit")}

    @property
    def names(self) -> list[Any]:
        """Of discrete actions, in the order of their codes."""
        return list(range(self.count)) if self.levels is None else self.levels.tolist()


def like(shape: tuple[int, ...]) -> type[np.generic]:
    """The type of observations of a shape: pictures are of uint8."""
    return np.uint8 if len(shape) == 3 else np.float32


def _only(columns: Mapping[str, Any]) -> Any:
    """The one column of several, or an empty one."""
    return next(iter(columns.values())) if len(columns) == 1 else {}


def _levels(given: list[Any] | None, actions: Mapping[str, Mapping[str, Any]], count: int) -> np.ndarray | None:
    """(actions,) the names of discrete actions, or None where these are 0, 1, ...

    Args:
        given: the levels that the log keeps beside its schema.
        actions: the action column of the schema.
        count: of actions; a log that has one action has two.
    """
    column = _only(actions)
    levels = column.get("levels") if given is None else given
    if levels is None:
        return None
    if column.get("kind") == "flag" and set(map(text_of, levels)) <= {"false", "true"}:
        levels = [text_of(level) == "true" for level in levels]
    levels = [tuple(level) if isinstance(level, list) else level for level in levels]
    levels += [str(code) for code in range(len(levels), count)]
    if len({type(level) for level in levels}) == 1 and isinstance(levels[0], str | int | float):
        return np.asarray(levels)
    out = np.empty(len(levels), object)
    for code, level in enumerate(levels):
        out[code] = level
    return out
