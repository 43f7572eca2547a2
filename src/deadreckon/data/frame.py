"""Tables of one's own: columns are named, encoded and sorted into episodes, as `Dataset.from_arrays` takes them."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from deadreckon.data.columns import LOG_PROBS, RESERVED
from deadreckon.data.encode import Encoder, flags, log_probabilities, numbers
from deadreckon.errors import UserError, unknown

PROPENSITY = re.compile(r"propensit(y|ies)|p_?scores?|(action_|behaviou?r_|logging_)?prob(s|ability)?|action_probability")
IDENTITY = re.compile(r"(^|_)(u?u?id|user|customer|patient|session|site)(_?id)?$")


class FrameColumns(NamedTuple):
    """What a table becomes.

    Attributes:
        columns: by `Dataset.from_arrays` names, (rows, ...) each, in the order of episodes and time.
        extra: for the provenance: names of the observation's dimensions, levels of categories.
        warnings: what was noticed, one line each.
    """

    columns: dict[str, Any]
    extra: dict[str, Any]
    warnings: list[str]


def frame_columns(
    frame: Any,
    *,
    action: str | Sequence[str],
    reward: str,
    episode: str | None = None,
    time: str | None = None,
    observations: str | Sequence[str] | None = None,
    ignore: str | Sequence[str] = (),
    terminal: str | None = None,
    timeout: str | None = None,
    propensity: str | None = None,
    keep: str | Sequence[str] = (),
    name: str = "frame",
) -> FrameColumns:
    """The columns of a log that a table holds; `Dataset.from_frame` makes the log of them.

    Texts, categories and truth values among the observations become one 0/1 column per level (levels in
    `provenance.extra`); missing numbers become the column's mean, and a 0/1 column `<name>_missing` tells where.

    Args:
        frame: a pandas, polars or pyarrow table, or a mapping of column names to sequences of `rows` values.
        action: one column (integers, texts or categories: discrete; floats: continuous), several, or a prefix such as
            `action` that stands for action_0, action_1, ..., also among several.
        reward: column of numbers.
        episode: column that is equal within an episode. Absent: see `time`.
        time: column of numbers or timestamps that orders the rows of an episode, and the episodes by their first; rows
            are taken to be in order if absent. With neither `episode`, `time`, `terminal` nor `timeout`, each row is
            an episode of one terminal step (a bandit); otherwise, without `episode`, all rows are one stream that
            `terminal` and `timeout` cut.
        observations: columns, or prefixes; if absent, all that have no other part to play, are not row numbers without
            a name and hold no timestamps.
        ignore: columns, or prefixes, that are no observations.
        terminal: column of truth values: the task ended here.
        timeout: column of truth values: only the recording ended here. The last row of an episode that is not a
            terminal is always one.
        propensity: column of the logging policy's probability of the logged action (of its density, for floats), in
            (0, 1]; its logarithm is kept as the extra `behavior_log_probs`.
        keep: columns, or prefixes, that are no observations unless `observations` names them, but stay beside the log as
            extras, such as the user or the site by which episodes are held out. Texts and times become integer codes, up to
            1,000 levels of each in `provenance.extra`.
        name: of the log, used in errors.

    Raises:
        UserError: one line with the column and the row (counted from 0, as in the table given).
    """
    table = to_arrow(frame, name)
    if table.num_rows == 0:
        raise UserError(f"{name}: the table has no rows")
    actions = _columns_like(table, action, name)
    ignored = _columns_like(table, ignore, name)
    kept = _columns_like(table, keep, name)
    single = [reward, episode, time, terminal, timeout, propensity]
    for column in (*actions, *single):
        if column is not None:
            check_column(table, column, name)
    if observations is None:
        taken = {*actions, *single, *kept, *ignored}
        seen, warnings = _plausible(table, [column for column in table.column_names if column not in taken], propensity)
    else:
        seen, warnings = [column for column in _columns_like(table, observations, name) if column not in ignored], []
        parts = {reward: "the reward", terminal: "terminal", timeout: "timeout", propensity: "the propensity"}
        for column in seen:
            if part := "an action" if column in actions else parts.get(column):
                raise UserError(f"{name}: column {column} is {part} and an observation; ignore it, or name other observations")
    if not seen:
        raise UserError(f"{name}: no column is left to be an observation; name them with observations")

    encoder = Encoder(name, table)
    columns: dict[str, Any] = {
        "observations": encoder.observations(seen),
        "rewards": numbers(name, table, reward),
        "actions": encoder.actions(actions),
    }
    for key, column in (("terminals", terminal), ("timeouts", timeout)):
        columns[key] = np.zeros(table.num_rows, bool) if column is None else flags(name, table, column)
    if propensity is not None:
        columns[LOG_PROBS] = log_probabilities(name, table, propensity)
    for column in kept:
        if column in RESERVED | columns.keys():
            raise UserError(f"{name}: a column that is kept cannot be called {column}, which means something else; rename it")
        columns[column] = encoder.kept(column)
    moments = None if time is None else encoder.moments(time)
    codes = None if episode is None else encoder.episodes(episode, ordered=time is not None)

    if episode is None and time is None and terminal is None and timeout is None:
        columns["terminals"][:] = True
    order, ends = _order(table.num_rows, codes, moments)
    warnings += encoder.warnings
    if order is not None:
        columns = {key: column[order] for key, column in columns.items()}
    if order is not None and time is not None and moments is not None:
        moments = moments[order]
        if ties := int((~ends[:-1] & (moments[1:] == moments[:-1])).sum()):
            warnings.append(f"{ties} rows have the {time} of the row before them; they stay in the table's order")
        if not pa.types.is_temporal(table.column(time).type):
            stops = ends | columns["terminals"] | columns["timeouts"]
            warnings += _missing_steps(time, moments, stops, ends if episode is not None else None)
    early = int((columns["terminals"] & ~ends).sum()) if episode is not None else 0
    if early:
        warnings.append(f"{early} terminal rows are not the last of their episode, which is cut there")
    columns["timeouts"] |= ends & ~columns["terminals"]
    return FrameColumns(columns, encoder.extra, warnings)


def to_arrow(frame: Any, name: str = "frame") -> pa.Table:
    """A pandas, polars or pyarrow table, or a mapping of columns, as a pyarrow table.

    Raises:
        UserError: it is none of these, or its columns do not fit together.
    """
    try:
        if isinstance(frame, pa.Table):
            table = frame
        elif isinstance(frame, Mapping):
            table = pa.table({str(key): _sequence(value) for key, value in frame.items()})
        elif hasattr(frame, "__arrow_c_stream__"):
            table = pa.table(frame)
        elif hasattr(frame, "__dataframe__"):
            from pyarrow.interchange import from_dataframe

            table = from_dataframe(frame)
        else:
            raise UserError(f"{name}: a pandas, polars or pyarrow table is needed, not {type(frame).__name__}")
    except (pa.ArrowException, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{name}: not a table of plain columns ({' '.join(str(error).split())})") from error
    names = table.column_names
    twice = sorted({column for column in names if names.count(column) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise UserError(f"{name}: column {twice[0]} occurs more than once")
    # pandas' own index, unless it has a name, is no column of the user's.
    return table.drop_columns([column for column in names if re.fullmatch(r"__index_level_\d+__", column)])


def columns_like(table: pa.Table, prefix: str, name: str) -> list[str]:
    """The column `prefix`, or those called prefix_0, prefix_1, ... in the order of their numbers.

    Raises:
        UserError: neither exists, with the nearest names.
    """
    if prefix in table.column_names:
        return [prefix]
    found = numbered(table.column_names, prefix)
    if not found:
        check_column(table, prefix, name)
    return found


def _columns_like(table: pa.Table, given: str | Sequence[str], name: str) -> list[str]:
    """The columns of one name or prefix, or of several, each once."""
    several = [given] if isinstance(given, str) else given
    return list(dict.fromkeys(column for prefix in several for column in columns_like(table, prefix, name)))


def numbered(names: Sequence[str], prefix: str) -> list[str]:
    """Those of `names` called prefix_0, prefix_1, ... in the order of their numbers."""
    found = [column for column in names if re.fullmatch(re.escape(prefix) + r"_\d+", column)]
    return sorted(found, key=lambda column: int(column.rpartition("_")[2]))


def check_column(table: pa.Table, column: str, name: str) -> None:
    """Refuses a column that is not there, with the nearest names."""
    if column not in table.column_names:
        raise UserError(f"{name}: {unknown('column', column, table.column_names)}")


def row_numbers(names: Sequence[str]) -> list[str]:
    """Those of `names` that a table library gives to the row numbers that it writes."""
    return [column for column in names if column == "" or re.fullmatch(r"Unnamed: \d+", column)]


def _plausible(table: pa.Table, names: list[str], propensity: str | None) -> tuple[list[str], list[str]]:
    """Those of `names` that may be observations, which row numbers and timestamps are not, and what to say of them."""
    index = row_numbers(names)
    moments = [column for column in names if pa.types.is_temporal(table.column(column).type)]
    found = [column for column in names if column not in index and column not in moments]
    warnings = []
    if index:
        warnings.append(f"column {index[0]!r} looks like a row number and is left out of the observations")
    if moments:
        warnings.append(f"timestamps are left out of the observations: {', '.join(moments)}")
    for column in found:
        if propensity is None and PROPENSITY.fullmatch(column.lower()):
            warnings.append(
                f"column {column} looks like a probability of the logged action, and is read as an observation: "
                f"--propensity {column}, or --ignore {column}"
            )
        elif IDENTITY.search(column.lower()):
            warnings.append(
                f"column {column} looks like a name of someone or something, and is read as an observation: --keep {column} "
                f"keeps it beside the log, --ignore {column} leaves it out"
            )
    return found, warnings


def _sequence(value: Any) -> Any:
    return pa.chunked_array(value) if hasattr(value, "__arrow_c_stream__") else pa.array(value)


def _order(rows: int, codes: np.ndarray | None, moments: np.ndarray | None) -> tuple[np.ndarray | None, np.ndarray]:
    """How rows are put into episodes.

    Args:
        rows: how many.
        codes: (rows,) index of each row's episode; None: all are one.
        moments: (rows,) of each row; None: they are in order.

    Returns:
        The order of rows (None: as they are), and (rows,) whether each, in that order, is its episode's last.
    """
    last = np.zeros(rows, bool)
    last[-1] = True
    if codes is None and moments is None:
        return None, last
    codes = np.zeros(rows, np.int64) if codes is None else codes
    moments = np.zeros(rows) if moments is None else moments
    # Episodes follow one another by their first moment, so that a split by time is one; equal ones by their names.
    first = np.full(codes.max() + 1, np.inf)
    np.minimum.at(first, codes, moments)
    order = np.lexsort((moments, codes, first[codes]))
    last[:-1] = codes[order][1:] != codes[order][:-1]
    return order, last


def _missing_steps(time: str, moments: np.ndarray, stops: np.ndarray, ends: np.ndarray | None) -> list[str]:
    """What to say of rows that seem to be missing, where `time` counts steps: whole numbers that mostly grow by one.

    Args:
        time: the column.
        moments: (rows,) of it, sorted.
        stops: (rows,) bool, after which a gap is none.
        ends: (rows,) bool, the last rows of episodes that a column tells apart; None where no column does.
    """
    steps = np.diff(moments)[~stops[:-1]]
    if not len(steps) or (moments != np.floor(moments)).any() or 2 * int((steps == 1).sum()) <= len(steps):
        return []
    told = []
    if gaps := int((steps > 1).sum()):
        told.append(f"{gaps} of {len(steps)} steps skip values of {time}; their rows are taken as following one another")
    if ends is not None:
        starts = moments[np.append(0, np.flatnonzero(ends)[:-1] + 1)]
        values, counts = np.unique(starts, return_counts=True)
        usual = values[np.argmax(counts)]
        # Where time runs on through all episodes, no start is usual, and none is late.
        if 2 * counts.max() > len(starts) and (late := int((starts > usual).sum())):
            text = f"{late} of {len(starts)} episodes start after {time} {usual:g}, where most do"
            told.append(f"{text}; their first rows are taken as starts")
    return told
