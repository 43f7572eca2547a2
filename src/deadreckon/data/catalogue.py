"""What is known of every named log: task, original file, Minari twin, our recipe. Pure data and look-up."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.io import read
from deadreckon.errors import UserError, unknown
from deadreckon.files import home

VERSION = "dr1"  # of our recipes; a log that we collected carries it in its name, so that none passes for the original


@dataclass(frozen=True)
class Entry:
    """One named log.

    Attributes:
        name: D4RL's.
        domain: such as `maze2d`.
        task: where policies learned from it are judged.
        recipe: name that `deadreckon data collect` takes.
        rows: steps in the full log.
        original: path of D4RL's file below its download root.
        minari: id of the Minari twin, which was collected anew and differs.
        version: of our recipe.
    """

    name: str
    domain: str
    task: str
    recipe: str
    rows: int
    original: str
    minari: str | None
    version: str = VERSION

    @property
    def collected(self) -> str:
        """The name of the log as our recipe collects it."""
        return f"{self.name}@{self.version}"


def _maze2d(size: str, rows: int, dense: bool) -> Entry:
    middle = "-dense" if dense else ""
    name = f"maze2d-{size}{middle}-v1"
    file = name if dense else f"maze2d-{size}-sparse-v1"
    twin = None if size.startswith("eval-") else f"D4RL/pointmaze/{size}{middle}-v2"
    return Entry(name, "maze2d", f"maze2d-{size}{middle}", name, rows, f"maze2d/{file}.hdf5", twin)


# Rows: thesis Table D.1. The original has logs of the evaluation mazes too, though no Minari twin does.
_MAZES = tuple(
    (f"{split}{size}", rows)
    for split in ("", "eval-")
    for size, rows in (("umaze", 1_000_000), ("medium", 2_000_000), ("large", 4_000_000))
)
ENTRIES: dict[str, Entry] = {
    entry.name: entry for dense in (False, True) for size, rows in _MAZES for entry in (_maze2d(size, rows, dense),)
}


def entry(name: str) -> Entry:
    """The entry of a log, by D4RL's name or the collected one (`maze2d-umaze-v1@dr1`).

    Raises:
        UserError: no such name, with the nearest.
    """
    base, _, version = name.partition("@")
    if base not in ENTRIES:
        raise unknown("data set", base, ENTRIES)
    if version and version != ENTRIES[base].version:
        raise UserError(f"unknown version {version!r} of {base}: this deadreckon collects {ENTRIES[base].collected}")
    return ENTRIES[base]


def cached_path(name: str) -> Path:
    """Where the log `name` is kept, whether it is there or not: a catalogue name means the collected version.

    Raises:
        UserError: the name would lead out of the cache.
    """
    if name in ("", ".", "..") or name.startswith("~") or any(bad in name for bad in "/\\\0"):
        raise UserError(f"{name!r} is no file here and not the name of a log, such as maze2d-umaze-v1")
    if name in ENTRIES:
        name = ENTRIES[name].collected
    return home() / "data" / f"{name}.hdf5"


def load(name: Path | str, mmap: bool = False, strict: bool = False, **options: Any) -> Dataset:
    """The log `name` from the cache, or the log in the file `name`.

    Args:
        name: from the catalogue, or an existing file or folder, or `minari:` and an id.
        mmap: memory-map the columns.
        strict: refuse actions out of bounds instead of warning.
        **options: more that `read` takes.

    Raises:
        UserError: one line: no such name, or how the log can be had.
    """
    text = str(name)
    if text.startswith("minari:") or Path(name).exists():
        return read(name, mmap=mmap, strict=strict, **options)
    looks_like_a_file = Path(text).suffix in (".hdf5", ".h5", ".parquet", ".csv", ".npz", ".pickle", ".pkl", ".gz")
    if isinstance(name, Path) or looks_like_a_file:
        raise UserError(f"no file {text}")
    path = cached_path(text)
    if path.exists():
        return read(path, mmap=mmap, strict=strict, **options)
    found = entry(text)
    how = f"`deadreckon data collect {found.recipe}` makes it offline ({found.rows:,} steps)"
    raise UserError(f"{found.name} is not here yet: {how}")
