"""Episodes on their way to a log: columns that grow on disk, so that an interrupted collection goes on."""

import json
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import numpy as np

from deadreckon._version import __version__
from deadreckon.data.dataset import Dataset
from deadreckon.data.provenance import Provenance
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_at, write_json
from deadreckon.tasks.task import Task
from deadreckon.versions import differences

SCHEME = 1  # of how draws follow from the seed; a collection begun under another one is not resumed
FLUSH = 4096  # rows that are kept in memory before they go to the disk


class Episode(NamedTuple):
    """Rows of one episode by column, and what was seen after the last of them."""

    columns: dict[str, np.ndarray]
    final: np.ndarray

    @property
    def length(self) -> int:
        """Rows."""
        return len(self.columns["rewards"])


def collected(
    recipe: str | None, seed: int, packages: Iterable[str], extra: Mapping[str, Any], more: Mapping[str, str] | None = None
) -> Provenance:
    """Where a collected log comes from.

    Args:
        recipe: its name; None: there is no recipe.
        seed: random seed.
        packages: that its numbers depend on, beside this one.
        extra: what else the log says of itself.
        more: {package: version} of further ones.
    """
    versions = {each: metadata.version(each) for each in packages} | {"deadreckon": __version__, **(more or {})}
    return Provenance("collected", recipe, seed, versions, extra=extra)


def asked_for(name: str, seed: int, rows: list[int], provenance: Provenance) -> dict[str, Any]:
    """What tells one collection from another, as JSON values."""
    what = {"scheme": SCHEME, "name": name, "seed": seed, "rows": rows}
    return json.loads(json.dumps(what | {"versions": provenance.versions, "extra": provenance.extra}))


def same_collection(scratch: Path, asked: dict[str, Any]) -> None:
    """Notes in `scratch` what is collected there, or makes sure that it is this.

    Raises:
        UserError: it is something else.
    """
    note = scratch / "asked.json"
    if not note.exists():
        write_json(note, asked)
    elif different := differences(read_json(note, dict), asked):
        raise UserError(f"{scratch} holds the beginning of another collection ({different[0]}); delete it to start again")


class _State(TypedDict):
    """How much counts, as its file has it."""

    rows: int
    finals: int
    episodes: list[int]


class GrowingLog:
    """Columns that grow on disk: a raw file each, and a JSON file that says how many rows of them count."""

    def __init__(self, folder: Path, task: Task, kinds: dict[str, tuple[tuple[int, ...], Any]], asked: dict[str, Any]):
        self.folder, self.task = folder, task
        self.rows, self.finals = 0, 0
        self.episodes: list[int] = []
        self.kinds = {**kinds, "final_observations": (task.observation_shape, np.dtype(task.observation_dtype))}
        same_collection(folder, asked)
        if self._state.exists():
            found = read_json(self._state, _State)
            self.rows, self.finals, self.episodes = found["rows"], found["finals"], found["episodes"]

    @property
    def _state(self) -> Path:
        return self.folder / "state.json"

    def append(self, episodes: list[Episode], room: int, segment: int) -> None:
        """Adds episodes of a segment, at most `room` rows of them, and says so once they are on the disk."""
        parts, finals = [], []
        for columns, final in episodes:
            length = min(len(columns["rewards"]), room)
            if length == 0:
                break
            part = {key: column[:length] for key, column in columns.items()}
            if length < len(columns["rewards"]):  # where the rows ran out: what followed is its own next observation
                part["timeouts"][-1] = True
                final = columns["observations"][length]
            parts.append(part)
            finals.append(final)
            room -= length
        for key in parts[0]:
            self._write(key, np.concatenate([part[key] for part in parts]), self.rows)
        self._write("final_observations", np.stack(finals), self.finals)
        self.rows += sum(len(part["rewards"]) for part in parts)
        self.finals += len(finals)
        self.episodes += [0] * (segment + 1 - len(self.episodes))
        self.episodes[segment] += len(finals)
        write_json(self._state, {"rows": self.rows, "finals": self.finals, "episodes": self.episodes})

    def _write(self, key: str, rows: np.ndarray, at: int) -> None:
        shape, dtype = self.kinds[key]
        each = int(np.prod(shape)) * np.dtype(dtype).itemsize
        write_at(self.folder / f"{key}.bin", at * each, np.ascontiguousarray(rows, dtype).data)

    def log(self, name: str, provenance: Provenance, densities: bool) -> Dataset:
        """The log of all rows so far, memory-mapped, with the densities of actions or without."""
        columns: dict[str, Any] = {}
        for key, (shape, dtype) in self.kinds.items():
            if key == "behavior_log_probs" and not densities:
                continue
            count = self.finals if key == "final_observations" else self.rows
            columns[key] = np.memmap(self.folder / f"{key}.bin", dtype, "r", shape=(count, *shape))
        return Dataset.from_arrays(**columns, action_space=self.task.action_space, name=name, provenance=provenance)
