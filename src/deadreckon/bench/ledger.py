"""A ledger: results as one small JSON file per finished cell, which is added once and never changed.

    CELLS/KIND/ON/METHOD-CELL.json

Such a folder can lie in a repository, as files are only added. Runs and failures lie elsewhere.
"""

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import pyarrow as pa

from deadreckon.bench.checked import OBJECTS
from deadreckon.bench.jobs import Job, file_name
from deadreckon.bench.store import CURVE, RESULT, Store
from deadreckon.bench.suite import Suite
from deadreckon.errors import UserError, reading
from deadreckon.files import read_json, replacing
from deadreckon.foreign.shapes import wrong


class _Cell(TypedDict):
    """A file of a ledger."""

    cell: str
    content: NotRequired[str]
    suite: str
    kind: str
    method: str
    agent: str
    settings: dict[str, Any]
    preset: NotRequired[str | None]
    on: str
    data: NotRequired[str | None]
    asked: dict[str, Any]
    seed: int
    score: float | None
    raw: NotRequired[float | None]
    more: NotRequired[dict[str, Any]]
    episodes: NotRequired[list[float | None] | None]
    log: NotRequired[str | None]
    failure: str
    seconds: float
    steps: int
    revisions: NotRequired[dict[str, Any] | None]
    versions: dict[str, Any]
    finished: str
    job: str
    curve: list[list[float | None]]


@dataclass(frozen=True)
class Ledger(Store):
    """A store whose results are files of cells.

    Attributes:
        cells: folder of the finished cells; `path` is that of runs and failures.
    """

    cells: Path

    @property
    def place(self) -> Path:
        """Where results lie."""
        return self.cells

    def _file(self, row: dict[str, Any]) -> Path:
        return self.cells / row["kind"] / file_name(row["on"]) / f"{file_name(row['method'])}-{row['cell']}.json"

    def _write(self, job: Job, rows: list[dict[str, Any]], curves: list[dict[str, Any]]) -> None:
        for row in rows:
            path = self._file(row)
            curve = [[point[name] for name in CURVE.names[1:]] for point in curves if point["cell"] == row["cell"]]
            whole = {name: json.loads(value) if name in OBJECTS else value for name, value in row.items()}
            exact = {name: whole.pop(name) for name in ("settings", "asked")}  # which identify the cell
            text = json.dumps(_short(whole | {"curve": curve}) | exact, sort_keys=True, allow_nan=False)
            with replacing(path, keep=True) as temporary:
                temporary.write_text(text + "\n")

    def results(self) -> pa.Table:
        """All rows, the oldest first."""
        with reading(self.cells, "a ledger"):
            return _results(self._files())

    def curves(self) -> pa.Table:
        """All curves."""
        with reading(self.cells, "a ledger"):
            return self._curves()

    def _curves(self) -> pa.Table:
        points = [(cell["cell"], *point) for cell in map(_read, self._files()) for point in cell["curve"]]
        return pa.Table.from_pylist([dict(zip(CURVE.names, point)) for point in points], schema=CURVE)

    def _files(self) -> tuple[str, ...]:
        kinds = _inside(str(self.cells.absolute()))
        return tuple(sorted(file for kind in kinds for on in _inside(kind) for file in _inside(on) if file.endswith(".json")))


@dataclass(frozen=True)
class Snapshot(Ledger):
    """A ledger as it was when its results were first asked for, for what asks for them many times."""

    @cached_property
    def _whole(self) -> pa.Table:
        return super().results()

    def results(self) -> pa.Table:
        """All rows that there were, the oldest first."""
        return self._whole


def store_of(suites: Sequence[Suite], path: Path) -> Store:
    """Where the results of suites lie that are run together: in the ledger that they name, or in a folder.

    Args:
        suites: that are run together.
        path: folder of runs, failures and, where the suites have no ledger, results.

    Raises:
        UserError: the suites have different ledgers.
    """
    ledgers = {suite.ledger for suite in suites}
    if len(ledgers) > 1:
        raise UserError(f"suites of one queue must have one ledger, got {', '.join(sorted(map(str, ledgers)))}")
    ledger = ledgers.pop()
    return Store(path) if ledger is None else Ledger(path, ledger)


def _inside(folder: str) -> list[str]:
    """What lies in a folder and is not hidden, as files are while they are written; nothing of what is no folder."""
    try:
        with os.scandir(folder) as found:
            return [entry.path for entry in found if not entry.name.startswith(".")]
    except (FileNotFoundError, NotADirectoryError):
        return []


@cache
def _read(file: str) -> dict[str, Any]:
    cell = read_json(path := Path(file), _Cell)
    if any(len(point) != len(CURVE.names) - 1 for point in cell["curve"]):
        raise wrong(path, "curve", f"points of {len(CURVE.names) - 1} numbers", cell["curve"])
    return cell


@lru_cache(maxsize=1)
def _results(files: tuple[str, ...]) -> pa.Table:
    """The rows of these files, which never change: made again only where there is another file."""
    cells = sorted(map(_read, files), key=lambda cell: (cell["finished"], cell["cell"]))
    return pa.Table.from_pylist([{name: _flat(cell, name) for name in RESULT.names} for cell in cells], schema=RESULT)


def _flat(cell: dict[str, Any], name: str) -> Any:
    if name in OBJECTS and name in cell:
        return json.dumps(cell[name])
    return math.nan if name == "score" and cell[name] is None else cell.get(name)


def _short(value: Any) -> Any:
    """Numbers with seven digits, which is what they were computed with, and None for what is no number: JSON has no NaN."""
    if isinstance(value, dict):
        return {name: _short(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_short(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.7g}") if math.isfinite(value) else None
    return value
