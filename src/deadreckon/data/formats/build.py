"""Conversion of the columns of a file to a `Dataset`, and of a `Dataset` to the columns of a file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.columns import COLUMNS, given_columns, unmarked
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.header import Header
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError

ENDINGS = (".gz", ".hdf5", ".h5", ".npz", ".pickle", ".pkl", ".json", ".vw")  # of logs that are no tables
TABLE_ENDINGS = (
    ".parquet", ".csv", ".tsv", ".jsonl", ".ndjson", ".json", ".xlsx", ".xls", ".ods", ".sqlite", ".sqlite3", ".duckdb", ".db",
)  # fmt: skip


def build(
    path: Path | str,
    columns: Mapping[str, Any],
    header: Header | None = None,
    *,
    source: str = "file",
    name: str | None = None,
    action_space: Box | Discrete | None = None,
    extra: Mapping[str, Any] | None = None,
    strict: bool = False,
    horizon: int | None = None,
    warnings: Sequence[str] = (),
) -> Dataset:
    """Checks columns read from `path` and makes a log of them.

    Args:
        path: named in errors and kept in the provenance.
        columns: by `from_arrays` names; others are extras, called `infos_...` if `from_arrays` has an argument of that name.
        header: of the file, if this package wrote it.
        source: kind of file, for the provenance of other files.
        name: of the log; the header's, else the file's, if absent.
        action_space: the header's, else the range of the data, if absent.
        extra: further information in the file, for the provenance of other files.
        strict: refuse actions out of bounds.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.
        warnings: of the reader, one line each.

    Raises:
        UserError: one line with file, column and row.
    """
    given = given_columns(path, columns)
    about = header or Header(name or stem(path), None, Provenance(source=source, extra=dict(extra or {})))
    provenance = replace(about.provenance, path=str(path))
    if horizon is not None:
        timeouts = _cut(path, given, horizon)
        if "final_known" in given:  # where the horizon cuts an episode, the next row shows what follows
            known = np.ones(rows := len(timeouts), bool)
            known[last_rows(given, rows)] = given["final_known"]
            given["final_known"] = known[last_rows(given | {"timeouts": timeouts}, rows)]
        given["timeouts"] = timeouts
        provenance = replace(provenance, extra={**provenance.extra, "horizon": horizon})
    space = action_space or about.action_space
    # The log has the file's name while its columns are checked, so that errors name the file.
    log = Dataset.from_arrays(**given, action_space=space, name=str(path), provenance=provenance, strict=strict)
    found = [*warnings, *log.warnings]
    if header is None:
        found += [f"{line} (a horizon marks them)" for line in unmarked(given, log.lengths)]
    return replace(log, name=name or about.name, warnings=tuple(found))


def last_rows(columns: Mapping[str, Any], rows: int) -> np.ndarray:
    """The last row of each episode, by the flags."""
    ends = np.asarray(columns.get("terminals", np.zeros(rows, bool))) != 0
    ends |= np.asarray(columns.get("timeouts", np.zeros(rows, bool))) != 0
    ends[-1:] = True
    return np.flatnonzero(ends)


def _cut(path: Path | str, columns: Mapping[str, Any], horizon: int) -> np.ndarray:
    """(rows,) timeouts, with further ones after every `horizon` steps of an episode."""
    if horizon < 1:
        raise UserError(f"{path}: horizon must be >= 1, got {horizon}")
    told = "final_observations" if "final_observations" in columns else "next_observations"
    if told in columns and (told == "final_observations" or "timeouts" not in columns):
        raise UserError(f"{path}: its {told} tell where episodes end; a horizon is for files that do not say")
    rows = len(columns["actions"]) if np.ndim(columns["actions"]) else 0
    flags = {key: np.asarray(columns.get(key, np.zeros(rows, bool))) for key in ("terminals", "timeouts")}
    for key, flag in flags.items():
        if flag.size != rows:
            raise UserError(f"{path}: column {key} has {flag.size} values, actions have {rows} rows")
    if flags["timeouts"].dtype.kind not in "fiub":
        return flags["timeouts"]  # refused when all columns are checked
    ends = (flags["terminals"].reshape(rows) != 0) | (flags["timeouts"].reshape(rows) != 0)
    row = np.arange(rows)
    start = np.zeros(rows, np.int64)
    start[1:] = np.where(ends[:-1], row[1:], 0)
    step = row - np.maximum.accumulate(start)
    cut = (step % horizon == horizon - 1) & ~ends
    return np.where(cut, np.ones(1, flags["timeouts"].dtype), flags["timeouts"].reshape(rows))


def stem(path: Path | str) -> str:
    """The name of a log by that of its file: without folders and without the endings of formats."""
    name = Path(path).name
    for ending in (*ENDINGS, *TABLE_ENDINGS):
        name = name.removesuffix(ending)
    return name or "log"


def refuse_mmap(path: Path | str, why: str) -> UserError:
    """The error for a file that cannot be memory-mapped, with the command that converts it."""
    return UserError(f"{path}: {why}, so it cannot be memory-mapped: `deadreckon data convert {path} OUT.hdf5` first")


def arrays_of(log: Dataset) -> dict[str, np.ndarray]:
    """The columns that make up `log`, by `from_arrays` names: (rows, ...) each, `final_*` (episodes, ...)."""
    columns = {key: getattr(log, key) for key in COLUMNS if key != "next_observations"}
    if log.successors is not None:
        columns["next_observations"] = log.successors
    return {**columns, **log.extras}
