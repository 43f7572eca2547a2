"""Users' tables: columns are named, encoded and sorted into episodes, for `Dataset.from_arrays`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import log_probabilities, numbers, to_arrow
from deadreckon.data.asked import Asked
from deadreckon.data.columns import LOG_PROBS, RESERVED
from deadreckon.data.draft import draft
from deadreckon.data.encode import Encoder
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.held import HELD, held
from deadreckon.data.kinds import asked_kinds
from deadreckon.data.legal_columns import listed_levels, masks, with_levels
from deadreckon.data.row_order import about_dates, about_order, missing_steps
from deadreckon.data.schema import Column, Schema, as_schema
from deadreckon.data.scratch import BLOCK, Scratch
from deadreckon.data.spec import Box, Discrete
from deadreckon.data.text_columns import with_dates, with_flags
from deadreckon.errors import UserError, unknown

ALONE = "each row is read as an episode of one step; where rows follow each other, name --episode, --time or --terminal"


class FrameColumns(NamedTuple):
    """The columns of a log made from a table.

    Attributes:
        columns: by `Dataset.from_arrays` names, (rows, ...) each, in the order of episodes and time.
        extra: for the provenance: the schema, names of the observation's dimensions, levels of categories,
            and what each column held (`data.held`).
        warnings: messages, one line each.
        action_space: from the schema, or None.
    """

    columns: dict[str, Any]
    extra: dict[str, Any]
    warnings: list[str]
    action_space: Box | Discrete | None = None


def frame_columns(
    frame: Any, *, schema: Schema | Mapping[str, Any] | Path | str | None = None, name: str = "frame",
    dates: str | None = None, **asked: Any,
) -> FrameColumns:  # fmt: skip
    """The columns of a log from a table; `Dataset.from_frame` makes the log of them.

    Texts and categories among the observations become one 0/1 column per level (levels in
    `provenance.extra`); missing numbers become the column's mean, and a 0/1 column `<name>_missing` marks them.

    Args:
        frame: a pandas, polars or pyarrow table, or a mapping of column names to sequences of `rows` values.
        schema: what each column is, as a `Schema`, its JSON values or the path of its TOML file. It is complete, so the other
            options are refused beside it; columns that it does not have are left out.
        name: of the log, used in errors.
        dates: how texts such as 03/04/2024 are read: `iso` (as texts), `day-first` or `month-first`; None: by the rules of
            text files.
        **asked: without a schema, the roles of columns:

            - action: one column (integers, texts or categories: discrete; floats: continuous), several, or a prefix such as
              `action` that stands for action_0, action_1, ..., also among several. By its name if absent.
            - reward: column of numbers. By its name if absent.
            - episode: column that is equal within an episode. Absent: see `time`.
            - time: column of numbers or timestamps that orders the rows of an episode, and the episodes by their first; rows
              are taken to be in order if absent. With neither `episode`, `time`, `terminal`, `timeout` nor next
              observations, each row is an episode of one terminal step (a bandit); otherwise, without `episode`, all rows are
              one stream that `terminal` and `timeout` cut, or the next observations where `timeout` is absent.
            - observations: columns, or prefixes; if absent, all that have no other part to play.
            - next_observations: columns, or prefixes, of the observation after the action, one for each observation and in the
              same order, unless their names (`next_x`, `x_next`, ...) identify them. By their names if absent.
            - ignore: columns, or prefixes, that are not observations.
            - terminal: column of truth values: the task ended here.
            - timeout: column of truth values: only the recording ended here. The last row of an episode that is not a
              terminal is always one.
            - propensity: column of the logging policy's probability of the logged action, in (0, 1], or of its density above 0
              where actions are continuous; its logarithm is kept as the extra `behavior_log_probs`.
            - keep: columns, or prefixes, that are not observations unless `observations` names them, but are kept beside the
              log as extras. Texts and times become integer codes, up to 1,000 levels of each in `provenance.extra`.
            - group: column, such as a user or a site, that is kept; episodes with the same value are held out together.
            - cost: columns of numbers that are neither observation nor reward, kept as extras.
            - legal: which discrete actions could be taken: a column of lists or of texts such as a|b, a 0/1 column for each
              action (or their beginning: legal for legal_a, legal_b), or, in `Dataset.from_frame`, a function of the
              observations (rows, numbers) that gives (rows, actions) truth values in the order of the actions' levels.
            - next_legal: likewise in the next observations; without it, that of the following row.
            - weight: column of the weights of rows, kept as an extra; no policy is deployed by rows of different weights.
            - kinds: {column: "number", "integer", "category" or "flag"} if the kind found from the values is wrong.

    Raises:
        UserError: one line with the column and the row (counted from 0, as in the table given).
    """
    schema = None if schema is None else as_schema(schema)
    dates = Dialect.asked(dates=dates).dates or (schema.table.get("dates") if schema else None)
    from deadreckon.data.formats.words import levels_in  # which formats need, and these need this module

    table, order, told = with_dates(to_arrow(frame, name), dates, levels_in({"schema": schema}).texts if schema else ())
    read = table_columns(table, schema, name, dialect=None if order is None else Dialect(dates=order), **asked)
    return read._replace(warnings=[*told, *read.warnings])


def table_columns(
    table: pa.Table, schema: Schema | Mapping[str, Any] | Path | str | None, name: str, scratch: Scratch | None = None,
    *, dialect: Dialect | None = None, **asked: Any,
) -> FrameColumns:  # fmt: skip
    """As `frame_columns`, of a table whose texts of dates are read already.

    `scratch`, or memory, is where columns are kept, and `dialect` how the table's file was read, noted for files of further
    rows.
    """
    if table.num_rows == 0:
        raise UserError(f"{name}: the table has no rows")
    function = asked.pop("legal") if callable(asked.get("legal")) else None
    asked = {key: value for key, value in asked.items() if value is not None and value != ()}
    if schema is None:
        wanted = Asked(**asked)
        table = with_flags(table, [column for column, kind in asked_kinds(wanted.kinds, table, name).items() if kind == "flag"])
        found, warnings = draft(table, wanted, name)
    elif asked:
        given_too = ", ".join(sorted(asked))
        raise UserError(f"{name}: the schema says what each column is; leave {given_too} out, or change the schema")
    else:
        found = as_schema(schema)
        warnings = _checked(table, found, name)
        table = with_flags(table, [column.name for column in found.columns if column.kind == "flag"])
    if dialect is not None:
        found = replace(found, table={**found.table, **dialect.options})
    read = _log_columns(table, found, warnings, name, scratch or Scratch())
    return read if function is None else read._replace(columns={**read.columns, "legal": function})


def _checked(table: pa.Table, schema: Schema, name: str) -> list[str]:
    """Refuses a schema that does not fit the table; tells which columns it does not have."""
    for column in schema.columns:
        if column.role != "ignore" and column.name not in table.column_names:
            close = str(unknown("column", column.name, table.column_names)).removeprefix(f"unknown column {column.name!r}: ")
            raise UserError(f"{name}: no column {column.name}, to which the schema gives the role {column.role}: {close}")
    for role in ("action", "reward", "observation"):
        if not schema.having(role):
            raise UserError(f"{name}: the schema gives no column the role {role}, and a log needs one")
    free = [column.name for column in schema.having("action") if column.low is None]
    if 0 < len(free) < len(schema.having("action")):
        raise UserError(f"{name}: the schema gives bounds of some actions, not of {free[0]}; give low and high of all, or none")
    known = {column.name for column in schema.columns}
    other = [column for column in table.column_names if column not in known]
    return [f"the schema does not have these columns, which are left out: {', '.join(other)}"] if other else []


def _log_columns(table: pa.Table, schema: Schema, warnings: list[str], name: str, scratch: Scratch) -> FrameColumns:
    """The columns of a log that a table holds by its schema."""
    encoder = Encoder(name, table, scratch)
    observed, actions, following = (schema.having(role) for role in ("observation", "action", "next_observation"))
    allowed = schema.having("legal", "next_legal")
    if allowed:
        actions = (with_levels(name, table, actions, listed_levels(name, table, allowed)),)
    reward, episode, time = (schema.one(role) for role in ("reward", "episode", "time"))
    terminal, timeout, propensity = (schema.one(role) for role in ("terminal", "timeout", "propensity"))
    assert reward is not None  # a schema without one is refused before
    columns: dict[str, Any] = {
        "observations": encoder.observations(observed), "rewards": scratch.keep(encoder.rewards(reward, actions)),
        "actions": encoder.actions(actions), "terminals": encoder.flags(terminal), "timeouts": encoder.flags(timeout),
    }  # fmt: skip
    unknown = np.zeros(table.num_rows, bool)  # rows without a next observation
    if following:
        columns["next_observations"], unknown = encoder.next_observations(following, observed)
        columns["next_observations"][unknown] = columns["observations"][unknown]
    if allowed:
        columns |= masks(name, table, allowed, levels := actions[0].levels or (), unknown | columns["terminals"])
        encoder.extra["observation_names"] += [f"legal={level}" for level in levels]
    if propensity is not None:
        columns[LOG_PROBS] = log_probabilities(name, table, propensity.name, columns["actions"])
    for column in schema.columns:
        if not column.keep and column.role not in ("keep", "group", "cost", "weight"):
            continue
        if column.name in RESERVED | columns.keys():
            text = f"a column that is kept cannot be called {column.name}, which means something else"
            raise UserError(f"{name}: {text}; rename it")
        if column.role == "group":
            encoder.exact(column.name, "groups")
        plain = column.role in ("cost", "weight")
        columns[column.name] = scratch.keep(numbers(name, table, column.name) if plain else encoder.kept(column.name))
    moments = None if time is None else scratch.keep(encoder.moments(time.name))
    codes = None if episode is None else scratch.keep(encoder.episodes(episode.name, ordered=time is not None))

    if not (episode or time or terminal or timeout or following):
        columns["terminals"][:] = True
        encoder.warnings.append(ALONE)
    columns, unknown, ends, told = _in_order(table, schema, columns, unknown, codes, moments, scratch)
    warnings = [*warnings, *encoder.warnings, *told]
    early = int((columns["terminals"] & ~ends).sum()) if episode is not None else 0
    if early:
        warnings.append(f"{early} terminal rows are not the last of their episode, which is cut there")
    if following:
        _ends_known(name, columns, unknown, ends, cut=timeout is not None or episode is not None)
    else:
        columns["timeouts"] |= ends & ~columns["terminals"]
    resolved = schema.resolved(encoder.resolved.values())
    extra = {**encoder.extra, "schema": resolved.to_json(), HELD: held(table, schema)}
    if group := schema.one("group"):
        extra["group"] = group.name
    return FrameColumns(columns, extra, warnings, _space(actions, encoder.resolved))


def _in_order(
    table: pa.Table, schema: Schema, columns: dict[str, Any], unknown: np.ndarray, codes: np.ndarray | None,
    moments: np.ndarray | None, scratch: Scratch,
) -> tuple[dict[str, Any], np.ndarray, np.ndarray, list[str]]:  # fmt: skip
    """The columns in the order of episodes and time.

    Args:
        table: (rows,) of each column.
        schema: of the table.
        columns: by `from_arrays` names, (rows, ...) each.
        unknown: (rows,) bool, where the next observation is missing.
        codes: (rows,) index of each row's episode; None: no column tells episodes apart.
        moments: (rows,) of each row; None: rows are in order.
        scratch: where columns are kept.

    Returns:
        The columns, and `unknown`, in order; (rows,) bool whether a row is the last of its episode; and messages.
    """
    order, ends = _order(table.num_rows, codes, moments)
    if order is None:
        return columns, unknown, ends, about_dates(table, schema)
    told = about_order(table, schema, codes, moments, order)
    columns, unknown = {key: scratch.ordered(column, order) for key, column in columns.items()}, unknown[order]
    if (time := schema.one("time")) is not None and moments is not None:
        moments = moments[order]
        if ties := int((~ends[:-1] & (moments[1:] == moments[:-1])).sum()):
            told.append(f"{ties} rows have the {time.name} of the row before them; they stay in the table's order")
        if time.kind != "date" and not pa.types.is_temporal(table.column(time.name).type):
            stops = ends | columns["terminals"] | columns["timeouts"]
            told += missing_steps(time.name, moments, stops, ends if codes is not None else None)
    return columns, unknown, ends, told


def _ends_known(name: str, columns: dict[str, Any], unknown: np.ndarray, ends: np.ndarray, cut: bool) -> None:
    """Where episodes end and which of their last rows have a next observation, of a table that has next observations.

    Args:
        name: of the log.
        columns: (rows, ...) each, in order; gets `timeouts` and `final_known`.
        unknown: (rows,) bool, where the next observation is missing.
        ends: (rows,) bool, the last rows of episodes that a column tells apart.
        cut: whether a column says where recordings end; otherwise they end where the next row does not continue.
    """
    terminals, timeouts = columns["terminals"], columns["timeouts"]
    timeouts |= ends & ~terminals
    if not cut:
        breaks = (columns["observations"][1:] != columns["next_observations"][:-1]).any(1)
        timeouts[:-1] |= breaks & ~terminals[:-1]
        timeouts |= unknown & ~terminals
    stops = terminals | timeouts
    if (inside := unknown & ~stops).any():
        row = int(np.argmax(inside))
        raise UserError(f"{name}: the next observation is missing in step {row}, which is not the last of its episode")
    columns["final_known"] = ~unknown[stops]


def _space(actions: tuple[Column, ...], resolved: Mapping[str, Column]) -> Box | Discrete | None:
    """The action space that a schema gives: the bounds of all continuous actions, or the levels of a discrete one."""
    columns = [resolved[column.name] for column in actions]
    if len(columns) == 1 and columns[0].levels is not None:
        return Discrete(max(len(columns[0].levels), 2))
    if any(column.low is None or column.high is None or column.kind != "number" for column in columns):
        return None
    return Box(tuple(float(c.low or 0.0) for c in columns), tuple(float(c.high or 0.0) for c in columns))


def _order(rows: int, codes: np.ndarray | None, moments: np.ndarray | None) -> tuple[np.ndarray | slice | None, np.ndarray]:
    """How rows are put into episodes.

    Args:
        rows: how many.
        codes: (rows,) index of each row's episode; None: all are one.
        moments: (rows,) of each row; None: they are in order.

    Returns:
        The order of rows (None: nothing orders them; a slice: they are in order), and (rows,) whether each, in that order, is
        its episode's last.
    """
    last = np.zeros(rows, bool)
    last[-1] = True
    if codes is None and moments is None:
        return None, last
    codes = np.zeros(rows, np.int64) if codes is None else codes
    moments = np.zeros(rows) if moments is None else moments
    # Episodes follow one another by their first moment, so that a split by time is one; equal ones by their names.
    first = np.full(codes.max() + 1, moments.max())  # of their type: as floats, large integers would be rounded
    np.minimum.at(first, codes, moments)
    # Most large tables are sorted already, and to sort them again takes much memory.
    order = slice(None) if _sorted(first, codes, moments) else np.lexsort((moments, codes, first[codes]))
    codes = codes[order]
    last[:-1] = codes[1:] != codes[:-1]
    return order, last


def _sorted(first: np.ndarray, codes: np.ndarray, moments: np.ndarray) -> bool:
    """Whether rows are in the order of their episodes' first moments, of their episodes and of their own moments."""
    for start in range(0, len(codes) - 1, BLOCK):
        part, moment = codes[start : start + BLOCK + 1], moments[start : start + BLOCK + 1]
        begins = first[part]
        later = (part[1:] > part[:-1]) | ((part[1:] == part[:-1]) & (moment[1:] >= moment[:-1]))
        if not ((begins[1:] > begins[:-1]) | ((begins[1:] == begins[:-1]) & later)).all():
            return False
    return True
