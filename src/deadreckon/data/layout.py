"""A log as named columns and a header: what every file format of ours stores, and how it becomes a `Dataset` again."""

import contextlib
import inspect
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset, Provenance
from deadreckon.data.spec import Box, Discrete, action_space_from_json, action_space_to_json
from deadreckon.errors import UserError

FORMAT = 1  # raised when an older deadreckon could not read what we write
NEEDED = ("observations", "actions", "rewards")
_ENDS = {"timeouts", "next_observations", "final_observations"}  # any of these tells where episodes end
COLUMNS = (*NEEDED, "terminals", "timeouts", "next_observations", "final_observations", "final_known")
# Names that an extra column cannot have.
RESERVED = frozenset(inspect.signature(Dataset.from_arrays).parameters) - {"extras"} | {"cls"}


def columns_of(log: Dataset) -> dict[str, np.ndarray]:
    """The columns that make up `log`, by `from_arrays` names: (rows, ...) each, `final_*` (episodes, ...)."""
    columns = {key: getattr(log, key) for key in COLUMNS if key != "next_observations"}
    if log.successors is not None:
        columns["next_observations"] = log.successors
    return {**columns, **log.extras}


def header_of(log: Dataset) -> dict[str, Any]:
    """What a log says beside its columns, as JSON values."""
    return header(log.name, log.action_space, log.provenance)


def header(name: str, action_space: Box | Discrete | None, provenance: Provenance) -> dict[str, Any]:
    """The header of a log that is still being written."""
    space = None if action_space is None else action_space_to_json(action_space)
    return {"deadreckon": FORMAT, "name": name, "action_space": space, "provenance": asdict(provenance)}


def parse_header(path: Path | str, text: str | bytes) -> dict[str, Any]:
    """The header in `text`.

    Raises:
        UserError: one line: it is damaged, or a newer deadreckon's.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"not valid JSON: {error}") from error
    return checked_header(path, value)


def checked_header(path: Path | str, value: Any) -> dict[str, Any]:
    """`value` as a header; raises like `parse_header`."""
    version = value.get("deadreckon") if isinstance(value, dict) else None
    if type(version) is not int:
        raise damaged(path, "it names no format")
    if version > FORMAT:
        raise UserError(f"{path}: written by a newer deadreckon (format {version}); update to read it")
    return value


def damaged(path: Path | str, why: str) -> UserError:
    """The error for a header that is none."""
    return UserError(f"{path}: its header is damaged ({why})")


def build(
    path: Path | str,
    columns: Mapping[str, Any],
    about: Mapping[str, Any] | None = None,
    *,
    source: str = "file",
    name: str | None = None,
    action_space: Box | Discrete | None = None,
    extra: Mapping[str, Any] | None = None,
    strict: bool = False,
    horizon: int | None = None,
) -> Dataset:
    """Checks columns read from `path` and makes a log of them.

    Args:
        path: named in errors and kept in the provenance.
        columns: by `from_arrays` names; other names are extras, `infos_name` for one that is called `name` or such.
        about: what `header_of` gave when the file was written, if it is one of ours, by `checked_header`.
        source: kind of file, for the provenance of files that are not ours.
        name: of the log; the header's, else the file's, if absent.
        action_space: the header's, else the range of the data, if absent.
        extra: what else the file says, for the provenance of files that are not ours.
        strict: refuse actions out of bounds.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.

    Raises:
        UserError: one line with file, column and row.
    """
    for key in NEEDED:
        if key not in columns:
            found = ", ".join(sorted(columns)) or "none"
            raise UserError(f"{path}: no column {key}; {', '.join(NEEDED)} are needed, the file has {found}")
    # Read as mere extras, these would leave a log without ends: better no log than a wrong one.
    for key in ("dones", "done", "terminations") if "terminals" not in columns else ():
        if key in columns:
            raise UserError(f"{path}: column {key} must be called terminals (the task ended) or timeouts (a time limit)")
    provenance = Provenance(source=source, extra=dict(extra or {}))
    if about is not None:
        try:
            provenance = Provenance(**about["provenance"])
            for part, kind in ((about["name"], str), (provenance.extra, dict), (provenance.versions, dict)):
                if not isinstance(part, kind):
                    raise TypeError(f"{part!r} is no {kind.__name__}")
            if action_space is None and about["action_space"] is not None:
                action_space = action_space_from_json(about["action_space"])
            name = name or about["name"]
        except (KeyError, TypeError, ValueError) as error:
            raise damaged(path, f"{type(error).__name__}: {error}") from error
    name = name or stem(path)
    given = _renamed(path, columns)
    if horizon is not None:
        given["timeouts"] = _cut(path, given, horizon)
        provenance = replace(provenance, extra={**provenance.extra, "horizon": horizon})
    with naming(path, name):
        log = Dataset.from_arrays(
            action_space=action_space,
            name=name,
            provenance=replace(provenance, path=str(path)),
            strict=strict,
            **given,
        )
    if about is None and log.lengths.max() > 1 and not _ENDS & given.keys():
        text = "no timeouts and no next_observations: time limits that are not marked would be crossed"
        log = replace(log, warnings=(*log.warnings, f"{text} (a horizon marks them)"))
    return log


def _renamed(path: Path | str, columns: Mapping[str, Any]) -> dict[str, Any]:
    """`columns`, where those called like another argument of `from_arrays` are `infos_...`."""
    given: dict[str, Any] = {}
    for key, column in columns.items():
        key = f"infos_{key}" if key in RESERVED and key not in COLUMNS else key
        if key in given:
            raise UserError(f"{path}: two columns would be called {key}; rename one")
        given[key] = column
    return given


def _cut(path: Path | str, columns: Mapping[str, Any], horizon: int) -> np.ndarray:
    """Timeouts, with more of them after every `horizon` steps of an episode."""
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
        return flags["timeouts"]  # refused by those who check all columns
    ends = (flags["terminals"].reshape(rows) != 0) | (flags["timeouts"].reshape(rows) != 0)
    row = np.arange(rows)
    start = np.zeros(rows, np.int64)
    start[1:] = np.where(ends[:-1], row[1:], 0)
    step = row - np.maximum.accumulate(start)
    cut = (step % horizon == horizon - 1) & ~ends
    return np.where(cut, np.ones(1, flags["timeouts"].dtype), flags["timeouts"].reshape(rows))


@contextlib.contextmanager
def naming(path: Path | str, name: str) -> Iterator[None]:
    """Errors about the log `name` name the file instead."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {str(error).removeprefix(f'{name}: ')}") from error


@contextlib.contextmanager
def reading(path: Path | str, kind: str, *more: type[Exception]) -> Iterator[None]:
    """What a library raises on a damaged or unreadable file, `more` included, becomes one line."""
    try:
        yield
    except UserError:
        raise
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise UserError(f"{path}: {(error.strerror or 'cannot be opened').lower()}") from error
    except (OSError, *more) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged or cut short ({text})") from error


def stem(path: Path | str) -> str:
    """A log's name made of its file's: without folders and without the endings of formats."""
    name = Path(path).name
    for ending in (".gz", ".hdf5", ".h5", ".parquet", ".csv", ".npz", ".pickle", ".pkl"):
        name = name.removesuffix(ending)
    return name or "log"


def extra_name(key: str, taken: Mapping[str, Any]) -> str:
    """The name of an extra column for a path such as `infos/goal`: `goal`, or `infos_goal` where that is taken.

    Raises:
        UserError: that is taken too, so one of the two would be lost.
    """
    parts = key.split("/")
    short = "_".join(parts[1:] if parts[0] == "infos" and len(parts) > 1 else parts)
    found = "_".join(parts) if short in RESERVED or short in taken else short
    if found in taken:
        raise UserError(f"two columns would be called {found}, {key} and another; rename one")
    return found


def refuse_mmap(path: Path | str, why: str) -> UserError:
    """The error for a file that cannot be memory-mapped, with the way out."""
    return UserError(f"{path}: {why}, so it cannot be memory-mapped: `deadreckon data convert {path} OUT.hdf5` first")
