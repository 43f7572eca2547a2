"""D4RL's hdf5 layout: one dataset per column. In files written here they are contiguous, and can be memory-mapped."""

import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from deadreckon.data.columns import COLUMNS
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.arrange import arranged
from deadreckon.data.formats.build import arrays_of, build, refuse_mmap, stem
from deadreckon.data.formats.flat_pictures import PICTURES, SHAPES, as_pictures
from deadreckon.data.formats.hdf5_inside import HEADER
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.layouts import layout_of, told
from deadreckon.data.provenance import Provenance
from deadreckon.data.scratch import BLOCK
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.files import replacing, reserve
from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size
from deadreckon.names import safe_name

TOGETHER = 64  # images per compressed chunk
_OVERHEAD = 65_536  # bytes of a file beside its columns: names, header, alignment


def read_hdf5(
    path: Path | str,
    *,
    mmap: bool = False,
    strict: bool = False,
    name: str | None = None,
    horizon: int | None = None,
    scratch: Path | str | None = None,
) -> Dataset:
    """Reads an hdf5 file in D4RL's layout, written here or elsewhere, or in another library's layout (`layouts`).

    `infos/*` and further columns with as many rows become extras (`infos/goal` is `goal`). `metadata/*` that is text or a
    single number goes to the provenance; arrays there, such as policy weights, are not read. Columns of texts are left out, and
    named in the provenance. Images that D4RL stores as rows of numbers are converted to images (`flat_pictures`), with a note
    in the provenance.

    Args:
        path: of the file.
        mmap: memory-map the columns; they must be contiguous and uncompressed, as `write_hdf5` writes them.
        strict: refuse actions out of bounds.
        name: of the log; that in the file, else the file's name, if absent.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.
        scratch: folder for copies of columns that cannot be memory-mapped; they are copied block by block, so that the file
            need not fit into memory.

    Raises:
        UserError: one line: not an hdf5 file, cut short, columns missing or wrong, or not to be memory-mapped.
    """
    held = read_apart(
        "hdf5", path, "hdf5", size=file_size(path), file=str(path), mmap=mmap, scratch=None if scratch is None else str(scratch)
    )
    header = None if held["header"] is None else Header.parse(path, held["header"])
    if (layout := held["layout"]) is not None and held["found"] is None and "columns" not in held:
        raise refuse_mmap(path, f"it has {layout}'s layout")
    if held["found"] is not None:
        found = arranged(path, held["found"])
        return build(
            path, found.columns, source="hdf5", name=name, action_space=found.space, extra=found.extra, strict=strict,
            horizon=horizon, warnings=found.told,
        )  # fmt: skip
    if held["obstacle"] is not None:
        raise refuse_mmap(path, held["obstacle"])
    called = name or stem(path)
    flat = header is None and called.partition("@")[0] in SHAPES
    # Images that are to be converted are memory-mapped, so that they are not in memory twice.
    columns = {key: _taken(value, mmap or (flat and key in PICTURES)) for key, value in held["columns"].items()}
    drawn = None
    if flat:
        refuse = partial(refuse_mmap, path) if mmap and scratch is None else None
        columns, drawn = as_pictures(path, called, columns, refuse, None if scratch is None else Path(scratch))
    notes = {"metadata": held["metadata"], "left_out": held["left_out"], "layout": layout, "observations": drawn}
    extra = {key: value for key, value in notes.items() if value}
    known = layout_of(held["names"]) if layout else None
    lines = [told(known)] if known else []
    return build(
        path, columns, header, source="d4rl-hdf5", name=name, extra=extra, strict=strict, horizon=horizon, warnings=lines
    )


def _taken(value: Any, mmap: bool) -> Any:
    """A column as an array; one that is given by its place in a file is read from there, or memory-mapped."""
    if not isinstance(value, tuple):
        return value
    path, offset, shape, kind = value
    if mmap:
        return np.memmap(path, kind, "r", offset, shape)
    dtype = np.dtype(kind)
    raw = np.fromfile(path, np.uint8 if dtype == np.bool_ else dtype, math.prod(shape), offset=offset).reshape(shape)
    return raw != 0 if dtype == np.bool_ else raw


def write_hdf5(log: Dataset, path: Path | str, compress: bool = False) -> None:
    """Writes `log` so that `read_hdf5` gives it back exactly, also memory-mapped. Atomic.

    Args:
        log: that is written.
        path: of the file.
        compress: whether images are compressed, rendered ones to about a twentieth; they cannot be memory-mapped then.

    Raises:
        UserError: a column's name would be a path in the file, or the file cannot be written.
    """
    columns = arrays_of(log)
    finals = columns.pop("final_observations"), columns.pop("final_known")
    shapes = {key: (column.shape[1:], column.dtype) for key, column in columns.items()}
    with create(path, rows=len(log), columns=shapes, header=Header.of(log), episodes=log.episodes, compress=compress) as writer:
        for key, column in columns.items():
            copy_rows(column, writer[key])
        writer.write_finals(*finals)


class Writer:
    """An hdf5 log that is being written; `writer["observations"][a:b] = ...` fills rows.

    Attributes:
        provenance: stored when the file is closed; may be replaced until then.
    """

    def __init__(self, file: h5py.File, header: Header, compress: bool = False):
        self.file, self._compress = file, compress
        self._header = header
        self.provenance = header.provenance

    def __getitem__(self, column: str) -> h5py.Dataset:
        """The column's writable h5py dataset, by `Dataset.from_arrays` name."""
        found = self.file.get(_place(column))
        if not isinstance(found, h5py.Dataset):
            raise KeyError(column)
        return found

    def add(self, column: str, shape: tuple[int, ...], dtype: Any) -> h5py.Dataset:
        """Creates and returns a column of this shape, rows included; it is contiguous, except for images with compression."""
        if self._compress and np.dtype(dtype) == np.uint8 and len(shape) == 4 and shape[0]:
            parts = (min(shape[0], TOGETHER), *shape[1:])
            return self.file.create_dataset(_place(column), shape, dtype, chunks=parts, compression="gzip", compression_opts=1)
        # The space is not filled with zeros first, because the caller writes every row.
        return self.file.create_dataset(_place(column), shape, dtype, fill_time="never")

    def write_finals(self, observations: np.ndarray, known: np.ndarray | None = None) -> None:
        """Stores the observation after each episode's last action, (episodes, *shape), and (episodes,) bool whether it is known
        (None: all are). To be called after the last row.

        Raises:
            UserError: their number is not that of the episodes.
        """
        known = np.ones(len(observations), bool) if known is None else np.asarray(known, bool)
        ends = np.zeros(len(self["actions"]), bool)
        for key in ("terminals", "timeouts"):
            if key in self.file:
                ends |= np.asarray(self[key][()], bool)
        episodes = int(ends.sum()) + (not ends[-1])
        if not len(observations) == len(known) == episodes:
            raise UserError(f"{len(observations)} final observations for {episodes} episodes; one each is needed")
        for key, column in {"final_observations": np.asarray(observations), "final_known": known}.items():
            self.add(key, column.shape, column.dtype)[()] = column

    def close(self) -> None:
        """Stores the header; `create` calls it."""
        self.file.attrs[HEADER] = json.dumps(replace(self._header, provenance=self.provenance).to_json())


@contextlib.contextmanager
def create(
    path: Path | str,
    *,
    rows: int,
    columns: Mapping[str, tuple[tuple[int, ...], Any]],
    name: str = "log",
    action_space: Box | Discrete | None = None,
    provenance: Provenance | None = None,
    header: Header | None = None,
    episodes: int | None = None,
    compress: bool = False,
) -> Iterator[Writer]:
    """Context manager for an hdf5 log of known length, filled in any order; it appears at `path` only if there is no error.

    Args:
        path: of the file.
        rows: of every column.
        columns: {name: (shape of one row, dtype)} by `from_arrays` names; others become extras.
        name: of the log.
        action_space: bounds of the environment.
        provenance: where the log comes from; `writer.provenance` may replace it before the end.
        header: replaces the last three.
        episodes: their number, for the space of their final observations; None: `rows`, the largest possible.
        compress: see `write_hdf5`.

    Raises:
        UserError: a column's name would be a path in the file, the file cannot be written, or the number of final
            observations is wrong.
    """
    for key in columns:
        safe_name(key, f"{path}: column")
    header = header or Header(name, action_space, provenance or Provenance())
    sizes = {key: math.prod(shape) * np.dtype(dtype).itemsize for key, (shape, dtype) in columns.items()}
    finals = (rows if episodes is None else episodes) * (sizes.get("observations", 0) + 1)
    with replacing(path) as temporary:
        # The HDF5 library crashes when the disk is full, so the space is reserved first.
        reserve(temporary, rows * sum(sizes.values()) + finals + _OVERHEAD)
        # Columns are aligned, so that a memory map of one is as fast as an array. `replacing` has locked the file already.
        with h5py.File(temporary, "w", locking=False, alignment_threshold=1, alignment_interval=64) as file:
            writer = Writer(file, header, compress)
            for key, (shape, dtype) in columns.items():
                writer.add(key, (rows, *shape), dtype)
            yield writer
            writer.close()


def copy_rows(source: Any, target: Any) -> None:
    """Copies rows block by block, so that neither side is ever in memory as a whole."""
    for start in range(0, len(source), BLOCK):
        target[start : start + BLOCK] = source[start : start + BLOCK]


def _place(column: str) -> str:
    return column if column in COLUMNS else f"infos/{column}"
