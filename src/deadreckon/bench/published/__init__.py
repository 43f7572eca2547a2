"""Numbers that others have published, kept as data files that say where they are from: `load`, `scores`, `best`, `reference`.

They were made on the original logs and simulators: beside ours for orientation, never averaged with ours. What was wrong with
the scan of a table, and where the thesis's tables contradict each other, is listed in the files and on the documentation's page
on published numbers.
"""

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

from deadreckon.data.entries import ENTRIES
from deadreckon.errors import UserError, unknown
from deadreckon.tasks import Reference, names, task

# Tables of the scores of agents that have learned from logs, by how they are called beside ours.
TABLES = {"thesis": "table_7_1", "CORL": "corl"}
_FILES = {path.stem: path for path in sorted(Path(__file__).parent.glob("*.json"))}


def load(name: str) -> dict[str, Any]:
    """A published table, with its `source` and `note`.

    Args:
        name: `table_7_1` (normalised scores) or `table_7_2` (returns) of the thesis, `b_1` (its settings of MBPO), `corl`, or
            `references` (D4RL's returns of tasks that this package has not rebuilt).

    Raises:
        UserError: there is no such table; the message names the nearest or all.
    """
    if name not in _FILES:
        raise unknown("published table", name, _FILES)
    return json.loads(_FILES[name].read_text(encoding="utf-8"))


def scores(task: str, table: str = TABLES["thesis"]) -> dict[str, float]:
    """Normalised scores by algorithm; empty where the table has none.

    Args:
        task: a log, such as `hopper-medium-v2@dr1` or `hopper-medium`. Version and origin do not matter; `hopper-mixed` is the
            thesis's other name of `hopper-medium-replay`.
        table: `table_7_1` of the thesis, or `corl`.

    Raises:
        UserError: as `load` does.
    """
    rows, name = {plain(log): row for log, row in load(table)["scores"].items()}, plain(task)
    if name not in rows and name.endswith("-mixed"):
        name = name.removesuffix("mixed") + "medium-replay"
    found = rows.get(name, {})
    return {algorithm: score[0] if isinstance(score, list) else score for algorithm, score in found.items()}


class Best(NamedTuple):
    """The best published score of a log, and whose it is."""

    score: float
    algorithm: str
    source: str


def best(task: str) -> Best | None:
    """The best score of `TABLES` of an algorithm that learns from the log alone; None where they have none.

    Args:
        task: as of `scores`.
    """
    own = {source: scores(task, table) for source, table in TABLES.items()}
    own["thesis"].pop("SAC", None)  # which learns online
    found = [Best(score, algorithm, source) for source, row in own.items() for algorithm, score in row.items()]
    return max(found, key=lambda each: each.score, default=None)


def reference(domain: str) -> Reference:
    """D4RL's returns of random actions and of the expert, the 0 and 100 of its scores.

    Args:
        domain: a task or log, such as `maze2d-umaze`, `hopper`, `hopper-medium-v2@dr1` or `pen-human`, or what tasks share,
            such as `pen` and `flow-ring`.

    Raises:
        UserError: D4RL has none, or the name is not known.
    """
    name = plain(domain)
    others = load("references")
    for known, (random, expert) in others["returns"].items():
        if re.fullmatch(rf"{known}(-(?!state).*)?", name):  # -state tasks are ours alone
            return Reference(random, expert, others["source"])
    judged = {plain(log): entry.task for log, entry in ENTRIES.items() if entry.task} | {known: known for known in names()}
    if name not in judged:
        raise unknown("domain", domain, {*judged, *others["returns"]})
    found = task(judged[name]).published
    if found is None:
        raise UserError(f"D4RL has no reference returns of {domain!r}")
    return found


def plain(name: str) -> str:
    """Without origin and version: `hopper-medium` of `hopper-medium-v2@dr1`."""
    return re.sub(r"-v\d+$", "", name.partition("@")[0])
