"""A log as named columns and a header: what every file format of ours stores, and how it becomes a `Dataset` again."""

import contextlib
import inspect
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
COLUMNS = (*NEEDED, "terminals", "timeouts", "next_observations", "final_observations", "final_known")
RESERVED = frozenset(inspect.signature(Dataset.from_arrays).parameters)  # names that an extra column cannot have


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
) -> Dataset:
    """Checks columns read from `path` and makes a log of them.

    Args:
        path: named in errors and kept in the provenance.
        columns: by `from_arrays` names; other names are extras.
        about: what `header_of` gave when the file was written, if it is one of ours.
        source: kind of file, for the provenance of files that are not ours.
        name: of the log; the header's, else the file's, if absent.
        action_space: the header's, else the range of the data, if absent.
        extra: what else the file says, for the provenance of files that are not ours.
        strict: refuse actions out of bounds.

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
        if about.get("deadreckon", 0) > FORMAT:
            raise UserError(f"{path}: written by a newer deadreckon (format {about['deadreckon']}); update to read it")
        try:
            provenance = Provenance(**about["provenance"])
            if action_space is None and about["action_space"] is not None:
                action_space = action_space_from_json(about["action_space"])
            name = name or about["name"]
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(f"{path}: its header is damaged ({type(error).__name__}: {error})") from error
    name = name or stem(path)
    given: dict[str, Any] = dict(columns)
    with naming(path, name):
        return Dataset.from_arrays(
            action_space=action_space,
            name=name,
            provenance=replace(provenance, path=str(path)),
            strict=strict,
            **given,
        )


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
    """The name of an extra column for a path such as `infos/goal`: `goal`, or `infos_goal` where that is taken."""
    parts = key.split("/")
    short = "_".join(parts[1:] if parts[0] == "infos" and len(parts) > 1 else parts)
    return "_".join(parts) if short in RESERVED or short in taken else short


def refuse_mmap(path: Path | str, why: str) -> UserError:
    """The error for a file that cannot be memory-mapped, with the way out."""
    return UserError(f"{path}: {why}, so it cannot be memory-mapped: `deadreckon data convert {path} OUT.hdf5` first")
