"""The fields of JSON files in run folders, which are checked when they are read, because folders may come from elsewhere.

Keys that older versions did not write may be missing, and keys that are not listed are kept as they are.
"""

from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
import pyarrow as pa

from deadreckon.data.provenance import Extra
from deadreckon.errors import UserError
from deadreckon.files import read_json
from deadreckon.foreign.shapes import same_length, wrong
from deadreckon.online import Online

CROSS_FIT = "crossfit.json"

# Columns of whole numbers in the tables of a run: those that every row must have, and those that it may have.
_NEEDED = {"metrics": ("step", "seed"), "evaluations": ("step", "seed", "episode")}
_WHOLE = ("step", "seed", "episode", "length")


class Agent(TypedDict):
    """The agent of a run."""

    name: str
    fields: dict[str, Any]


class Provenance(TypedDict):
    """The provenance of its log."""

    source: NotRequired[str | None]
    recipe: NotRequired[str | None]
    seed: NotRequired[int | None]
    versions: NotRequired[dict[str, Any] | None]
    path: NotRequired[str | None]
    extra: NotRequired[Extra | None]


class Behavior(TypedDict):
    """The mean return of the behaviour policy, with its interval."""

    mean: float
    low: float
    high: float


class Holdout(TypedDict):
    """The holdout as `data.split` records it, and its numbers of episodes; with `fold` and `folds` for a run of a cross-fit."""

    share: float
    by: str
    seed: int
    held: int
    learning: int
    fold: NotRequired[int]
    folds: NotRequired[int]


class Data(TypedDict):
    """The log of a run."""

    name: str
    fingerprint: str
    rows: NotRequired[int]
    episodes: NotRequired[int]
    usable: NotRequired[int]
    holdout: NotRequired[Holdout | None]
    warnings: NotRequired[list[str]]
    behavior: NotRequired[Behavior | None]
    provenance: NotRequired[Provenance | None]


class Evaluation(TypedDict):
    """How often a run is evaluated."""

    every: NotRequired[int | None]
    episodes: NotRequired[int | None]


class Start(TypedDict):
    """The run that an online run continues."""

    path: str
    updates: int


class Log(TypedDict):
    """The log in an online run's replay."""

    name: str
    fingerprint: str
    rows: int
    share: float
    path: str | None
    task: str | None
    holdout: Holdout | None


class LogRead(TypedDict):
    """How that log was read."""

    extra: NotRequired[Extra | None]
    path: NotRequired[str | None]


class RunConfig(TypedDict):
    """`run.json`."""

    agent: Agent
    data: Data
    task: str | None
    seeds: list[int]
    steps: int
    versions: NotRequired[dict[str, Any]]
    evaluation: NotRequired[Evaluation]
    revisions: NotRequired[dict[str, Any]]
    online: NotRequired[Online | None]
    start: NotRequired[Start | None]
    log: NotRequired[Log | None]
    demonstrations: NotRequired[dict[str, Any] | None]
    log_read: NotRequired[LogRead | None]
    history: NotRequired[int]
    encoder: NotRequired[str]
    shift: NotRequired[int]
    together: NotRequired[list[str] | None]


class Status(TypedDict):
    """`status.json`."""

    step: NotRequired[int]
    steps: NotRequired[int]
    finished: NotRequired[bool]
    failures: NotRequired[list[tuple[str, int] | None] | None]


class CrossFitData(TypedDict):
    """The log of a cross-fit."""

    name: str
    fingerprint: str


class CrossFitConfig(TypedDict):
    """`crossfit.json`."""

    folds: int
    by: str
    seed: int
    data: CrossFitData
    deliver: str
    agent: NotRequired[Any]
    episodes: NotRequired[list[int]]
    members: NotRequired[list[tuple[int, int]]]


def read_run(path: Path | str) -> dict[str, Any]:
    """`run.json`.

    Raises:
        UserError: it is missing or damaged, has no steps, no seeds, equal ones or negative ones, or an incomplete holdout or
            encoder.
    """
    found = read_json(path, RunConfig)
    seeds = found["seeds"]
    if not seeds or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise wrong(path, "seeds", "different whole numbers of 0 or more, at least one", seeds)
    if found["steps"] < 1:
        raise wrong(path, "steps", "1 or more", found["steps"])
    for field, holdout in (
        ("data.holdout", found["data"].get("holdout")),
        ("log.holdout", (found.get("log") or {}).get("holdout")),
    ):
        if holdout is not None and "fold" in holdout:
            if "folds" not in holdout:
                raise UserError(f"{path}: {field} lacks folds")
            if not 0 <= holdout["fold"] < holdout["folds"]:
                raise wrong(path, f"{field}.fold", f"a whole number from 0 to {holdout['folds'] - 1}", holdout["fold"])
    if ("encoder" in found) != ("shift" in found):
        raise UserError(f"{path}: it lacks {'shift' if 'encoder' in found else 'encoder'}, which goes with the other")
    return found


def read_status(path: Path | str, seeds: int | None = None) -> dict[str, Any]:
    """`status.json` of a run of so many seeds.

    Raises:
        UserError: it is missing or damaged, or of another number of seeds.
    """
    found = read_json(path, Status)
    if seeds is not None and found.get("failures") is not None:
        same_length(path, "failures", found["failures"], seeds)
    return found


def read_cross_fit(path: Path | str) -> dict[str, Any]:
    """`crossfit.json`.

    Raises:
        UserError: it is missing or damaged, or has fewer than 2 or more than 1,000 folds.
    """
    found = read_json(path, CrossFitConfig)
    if not 2 <= found["folds"] <= 1_000:
        raise wrong(path, "folds", "a whole number from 2 to 1,000", found["folds"])
    return found


def checked_rows(path: Path | str, kind: str, table: pa.Table) -> pa.Table:
    """A table of numbers of a run, if it is empty or has the columns that identify its rows.

    Args:
        path: of the file or the folder of its parts, for errors.
        kind: `metrics` or `evaluations`.
        table: the table.

    Raises:
        UserError: it lacks a column, or a column that must have whole numbers or truth values in all rows does not.
    """
    if not table.num_rows:
        return table
    for name in _NEEDED[kind]:
        if name not in table.column_names:
            raise UserError(f"{path}: {kind} need a column {name}; the file is damaged or of another kind")
    for field in table.schema:
        if field.name in _WHOLE and not pa.types.is_integer(field.type):
            raise UserError(f"{path}: column {field.name} of {kind} must hold whole numbers, got {field.type}")
        if table[field.name].null_count and (field.name in _WHOLE or pa.types.is_boolean(field.type)):
            raise UserError(f"{path}: column {field.name} of {kind} must have a value in every row, got null")
    return table


def checked_array(path: Path | str, name: str, found: np.ndarray, shape: tuple[str, ...], least: int) -> np.ndarray:
    """An array of a run, if it has numbers and the right dimensions.

    Args:
        path: of its file, for errors.
        name: of the array.
        found: the array.
        shape: names of its dimensions.
        least: smallest size of the last dimension.

    Raises:
        UserError: it holds something else than numbers, or has other dimensions.
    """
    if found.dtype.kind not in "biuf":
        raise UserError(f"{path}: {name} must hold numbers, got {found.dtype}")
    if found.ndim != len(shape) or found.shape[-1] < least:
        text = f"must be of shape ({', '.join(shape)}) with {least} {shape[-1]} or more, got {found.shape}"
        raise UserError(f"{path}: {name} {text}")
    return found
