"""How a log was read: the record in runs and policy files, and checks that another log was read in the same way.

A policy acts on numbers, and its run identifies episodes by their contents. Both need a log whose columns become the same
numbers and whose rows are divided into the same episodes; other logs are refused here, so that they are not taken for new data.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import alike_in
from deadreckon.data.formats.io import read as read_file
from deadreckon.data.formats.kind import TABLES, sniff
from deadreckon.data.formats.tables import is_written
from deadreckon.data.held import HELD
from deadreckon.data.schema import Schema
from deadreckon.data.schema_file import table_of
from deadreckon.data.spec import action_space_to_json
from deadreckon.errors import UserError

ALIKE = 0.01  # share of episodes that equal several others up to which these are of no account
HORIZON = "horizon"  # in `Provenance.extra`: steps after which episodes were cut when a file was read
ENCODED = {
    "observation_names": "observations are", "observation_levels": "levels of observations are",
    "action_levels": "levels of actions are",
}  # fmt: skip


class Read(NamedTuple):
    """How the training log of a policy was read, as far as it is known.

    Attributes:
        extra: of the log's provenance; None if not known.
        path: of its file.
        episodes: uint64 `episode_ids` of the whole log, held-out ones included; None if not recorded.
    """

    extra: Mapping[str, Any] | None = None
    path: str | None = None
    episodes: np.ndarray | None = None

    @classmethod
    def of(cls, provenance: Mapping[str, Any] | None, taught: np.ndarray | None, held: np.ndarray | None) -> "Read":
        """From the contents of a run or a policy file."""
        known = None if taught is None or held is None else np.concatenate([taught, held])
        provenance = provenance or {}
        return cls(provenance.get("extra"), provenance.get("path"), known)


def noted(log: Dataset) -> dict[str, Any]:
    """The record of a log in a policy file, with which `policies.table_encoder` encodes new rows in the same way.

    Its schema, ranges and levels of its observation and action columns, and shapes; no path, since such files are passed on.
    """
    told = log.provenance.extra
    extra = {key: value for key, value in told.items() if key in (*ENCODED, HORIZON)}
    if (schema := told.get("schema")) is not None:
        table = {key: value for key, value in schema.get("table", {}).items() if key != "path"}
        extra["schema"] = {"columns": schema["columns"]} | ({"table": table} if table else {})
        used = [name for name, column in schema["columns"].items() if column["role"] in ("observation", "action")]
        extra[HELD] = {name: held for name, held in (told.get(HELD) or {}).items() if name in used}
    spaces = {"observation_shape": log.observations.shape[1:], "action_space": action_space_to_json(log.action_space)}
    return json.loads(json.dumps({"extra": extra, **spaces}, default=str))


def schema_for(name: str, read: Read, path: Path | str) -> tuple[Schema | None, Path | str]:
    """The schema by which a file of a table is read as the log of a policy or run was, and the file.

    Args:
        name: of the policy or run.
        read: how its log was read.
        path: the file, which may be another one than at training; the file of a schema stands for the table beside it.

    Returns:
        The schema, None for other files or if unknown; and the file, with a schema that of the table.

    Raises:
        UserError: a schema's file that names no table beside it.
    """
    known = (read.extra or {}).get("schema")
    if known is None:
        return None, path
    table, options = table_of(path)
    schema = Schema.from_json(known, name)
    if options is None and (read.path is None or Path(table).suffix != Path(read.path).suffix):
        options = {}  # a file of another kind than at training may have another dialect, and has another name
    schema = schema.read_as(schema.options() if options is None else options)
    kind = Path(table).is_file() and sniff(table, schema.table.get("separator"))
    return (schema, table) if kind in TABLES and not (kind == "parquet" and is_written(table)) else (None, path)


def read_like(name: str, read: Read, path: Path | str) -> Dataset:
    """A log, given by its name or a file, read like the log of a policy or run: with its schema and horizon.

    Raises:
        UserError: it cannot be read in this way.
    """
    (schema, path), horizon = schema_for(name, read, path), (read.extra or {}).get(HORIZON)
    return catalogue.load(path, horizon=horizon) if schema is None else read_file(path, schema=schema, horizon=horizon)


def check_encoding(name: str, read: Read, data: Dataset) -> None:
    """Refuses a table whose columns are encoded differently from those of the log that a policy was trained on.

    Raises:
        UserError: names the policy, and what differs.
    """
    before, here = read.extra or {}, json.loads(json.dumps(dict(data.provenance.extra), default=str))
    if "observation_names" not in before or "observation_names" not in here:
        return  # one of them is no table: its columns have no names that could differ
    for key, what in ENCODED.items():
        if before.get(key) != here.get(key):
            kinds = [each.get(key, "plain numbers") for each in (before, here)]
            raise UserError(
                f"{name} was trained on a log whose {what} {kinds[0]}; those of {data.name} are {kinds[1]}: "
                "its policies would misread them"
            )


def check_episodes(name: str, read: Read, data: Dataset) -> None:
    """Refuses a log that was read differently, so that a policy's training episodes in it cannot be determined.

    Episodes are identified by their contents. The same file divided differently has other episodes, which would all seem new.

    Raises:
        UserError: names the policy, and how to read the log.
    """
    if read.episodes is None or read.extra is None:  # it had no log, or the log is not known
        return
    known = np.isin(data.episode_ids, read.episodes)
    if known.all():
        part = not data.selected and data.episodes < len(np.unique(read.episodes))
        if part and (alike := alike_in(data, read.episodes)).mean() > ALIKE:
            raise UserError(
                f"{int(alike.sum()):,} of {data.episodes:,} episodes of {data.name} equal several of the log that {name} was "
                "trained on, so only the whole log tells which were training episodes: evaluate on that or, if these are other "
                "episodes that are equal by chance, state with --unseen that it was not trained on them"
            )
        return
    new = f"{int((~known).sum()):,} of {data.episodes:,} episodes of {data.name} are not known to {name}"
    if not known.any():
        new = f"no episode of {data.name} is known to {name}"
    unseen = "or, if it was trained on none of these episodes, state that with --unseen"
    before, here = (extra.get(HORIZON) for extra in (read.extra, data.provenance.extra))
    if before != here:
        how = ["with no horizon" if each is None else f"with a horizon of {each}" for each in (before, here)]
        option = "without --log-horizon" if before is None else f"with --log-horizon {before}"
        why = f"which was trained on a log read {how[0]}, while this one was read {how[1]}"
        raise UserError(f"{new}, {why}: read it {option}, {unseen}")
    path = data.provenance.path if data.part_of is None else None  # parts of one file may well have no episode in common
    if not known.any() and (path is None or read.path is None or Path(path) != Path(read.path)):
        return  # another log
    why = "while the others are" if known.any() else f"although it was trained on {path} too"
    raise UserError(
        f"{new}, {why}: the log was read with other options or has changed since; read it as for training, "
        f"evaluate new episodes as a log of their own, {unseen}"
    )
