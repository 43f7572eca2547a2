"""The contents of an hdf5 file, read in a separate process: the library can hang and crash on a damaged file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
from h5py import h5o

from deadreckon.data.columns import COLUMNS, METADATA, NEEDED, d4rl_metadata, d4rl_name, extra_name
from deadreckon.data.formats.layouts import layout_of
from deadreckon.data.scratch import BLOCK
from deadreckon.errors import UserError, naming, reading
from deadreckon.files import digest
from deadreckon.foreign.door import file_size
from deadreckon.foreign.limits import DEPTH, MEMBERS, UNPACKED, beyond, max_unpacked
from deadreckon.foreign.parcel import Placed, Shared
from deadreckon.foreign.reader import alive

HEADER = "deadreckon"  # attribute that holds the header as JSON
_NUMBERS = "fiub"
_WIDEST = 1 << 26  # largest number of bytes copied at a time


def contents(file: str, mmap: bool, scratch: str | None, shared: Shared) -> dict[str, Any]:
    """The columns of a file, and its metadata.

    Args:
        file: its path.
        mmap: columns are to be memory-mapped; without a `scratch`, the first that cannot be is reported as `obstacle`.
        scratch: folder for copies of columns that cannot be memory-mapped.
        shared: memory for the other columns.

    Returns:
        `header`: text or None; `layout`: the library whose layout it is, or None; `found`: all columns and attributes if the
        layout has names other than D4RL's, else None. Without these names also `names` of all columns; `columns`: {name: an
        array, or (path, offset, shape, type) of one that is stored contiguously in a file}; `metadata`, `left_out`, `obstacle`.

    Raises:
        UserError: as `read_hdf5` does.
    """
    path = Path(file)
    size = file_size(path)
    with reading(path, "hdf5"), h5py.File(path, "r") as opened:
        leaves = dict(datasets_of(path, opened))
        header = str(opened.attrs[HEADER]) if HEADER in opened.attrs else None
        if header is None and "episode_0" in opened:
            raise UserError(f"{path}: the inside of a Minari data set; give its folder, which holds metadata.json")
        layout = None if header is not None else layout_of(leaves)
        into = _Columns(path, size, mmap, scratch, shared)
        if layout is not None and not layout.ours:
            everything = None if mmap and scratch is None else _everything(opened, leaves, into)
            return {"header": None, "layout": layout.library, "found": everything}
        said = {"header": header, "found": None, "layout": layout and layout.library, "names": list(leaves)}
        return said | _log(path, leaves, header is not None, into)


def _log(path: Path, leaves: dict[str, h5py.Dataset], ours: bool, into: "_Columns") -> dict[str, Any]:
    """The columns and metadata of a file in D4RL's layout."""
    actions = leaves.get("actions")
    if actions is None or not actions.ndim:
        found = ", ".join(leaves) or "nothing"
        raise UserError(f"{path}: no column actions; a D4RL file has {', '.join(NEEDED)}, this one has {found[:200]}")
    rows = len(actions)
    columns: dict[str, Any] = {key: into.column(key, value) for key, value in leaves.items() if key in COLUMNS}
    metadata: dict[str, Any] = {}
    left_out: list[str] = []
    for key, dataset in leaves.items():
        if key.startswith(METADATA):
            metadata |= d4rl_metadata(key, dataset)
        elif key not in COLUMNS and dataset.shape[:1] == (rows,) and dataset.dtype.kind not in _NUMBERS:
            left_out.append(key)
        elif key not in COLUMNS and dataset.shape[:1] == (rows,):
            with naming(path, ""):
                extra = (extra_name if ours else d4rl_name)(key, columns)
            columns[extra] = into.column(key, dataset)
    return {"columns": columns, "metadata": metadata, "left_out": left_out, "obstacle": into.obstacle}


def _everything(file: h5py.File, leaves: dict[str, h5py.Dataset], into: "_Columns") -> dict[str, Any]:
    """All attributes and columns, for the layout of another library."""
    said = {key: _known(value) for key, value in file.attrs.items() if not isinstance(value, h5py.Empty)}
    numbers = {key: value.dtype.kind in _NUMBERS for key, value in leaves.items()}
    return said | {key: into.array(value) if numbers[key] else _known(value[()]) for key, value in leaves.items()}


def _known(value: Any) -> Any:
    """Texts, which are an array of objects in h5py, as a list; other values are unchanged."""
    return value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind == "O" else value


class _Columns:
    """Reads columns: by their places in the file if they are contiguous, else unpacked, within a limit for all together."""

    def __init__(self, path: Path, size: int, mmap: bool, scratch: str | None, shared: Shared):
        self.path, self.size, self.mmap, self.scratch, self.shared = path, size, mmap, scratch, shared
        self.most, self.taken = max_unpacked(size), 0
        self.obstacle: str | None = None

    def column(self, key: str, dataset: h5py.Dataset) -> Any:
        """A column: an array, or its place in a file."""
        if dataset.dtype.kind not in _NUMBERS:
            return _known(dataset[()])
        place = self._place(dataset)
        if not self.mmap:
            return self.array(dataset) if place is None else place
        obstacle = None
        if dataset.chunks is not None or dataset.compression is not None:
            obstacle = "is stored in chunks or compressed"
        elif key in COLUMNS and dataset.dtype not in (np.float32, np.uint8, np.int32, np.bool_):
            # A column that must be converted would be in memory as a whole, which `mmap` is to avoid.
            obstacle = f"holds {dataset.dtype}"
        if obstacle and self.scratch is None:
            self.obstacle = self.obstacle or f"column {key} {obstacle}"
            return None
        if obstacle and dataset.ndim and dataset.size:
            place_of_copy = Path(self.scratch or "") / digest(key, 16)  # a key is a path in the file
            return self._copied(dataset, place_of_copy, key in COLUMNS)
        return self.array(dataset) if place is None else place

    def array(self, dataset: h5py.Dataset) -> Any:
        """A column unpacked into shared memory."""
        self._check(dataset.nbytes)
        shape, dtype = dataset.shape, dataset.dtype
        placed = Placed(self.shared.take(dataset.nbytes), shape, dtype)
        if not dataset.size:
            return placed
        target = self.shared.mapped(placed.at, shape, dtype)
        if not shape:
            target[()] = dataset[()]
        for start, stop in _blocks(dataset) if shape else ():
            dataset.read_direct(target, np.s_[start:stop], np.s_[start:stop])
            alive()
        return placed

    def _check(self, more: int) -> None:
        self.taken += more
        if self.taken > self.most:
            raise beyond(self.path, self.taken, self.most, UNPACKED, "unpacks to")

    def _place(self, dataset: h5py.Dataset) -> tuple[str, int, tuple[int, ...], str] | None:
        """(path, offset, shape, type) of a column that is stored contiguously in the file; None for others."""
        if dataset.chunks is not None or dataset.compression is not None:
            return None
        offset = dataset.id.get_offset()
        if offset is None or offset + dataset.nbytes > self.size or dataset.id.get_storage_size() != dataset.nbytes:
            return None  # never written, or stored within the column's header
        return str(self.path), offset, dataset.shape, dataset.dtype.str

    def _copied(self, dataset: h5py.Dataset, place: Path, core: bool) -> tuple[str, int, tuple[int, ...], str]:
        """Copies a column to a file and returns its place; float64 becomes float32 in the main columns of a log (`core`)."""
        dtype = np.dtype(np.float32) if core and dataset.dtype == np.float64 else dataset.dtype
        try:
            with open(place, "wb") as file:  # written, not mapped: a full disk is then an error and not a killed process
                for start, stop in _blocks(dataset):
                    with np.errstate(over="ignore"):  # an infinity is refused, with its row, by later checks
                        file.write(np.ascontiguousarray(dataset[start:stop], dtype).data)
                    alive()
        except OSError as error:
            text = error.strerror or str(error)
            raise UserError(f"cannot copy column {dataset.name} to {place}: {text}") from error
        return str(place), 0, dataset.shape, dtype.str


def _blocks(dataset: h5py.Dataset) -> Iterator[tuple[int, int]]:
    """(first row, row after the last) of parts that take little memory; if possible, each chunk is within one part."""
    row = max(dataset.nbytes // max(len(dataset), 1), 1)
    step = max(min(BLOCK, _WIDEST // row), 1)
    if dataset.chunks is not None and dataset.chunks[0] < step:
        step = step // dataset.chunks[0] * dataset.chunks[0]
    for start in range(0, len(dataset), step):
        yield start, min(start + step, len(dataset))


def datasets_of(path: Path, file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """(path, column) of all columns, in the order of their names, after all links have been checked.

    Raises:
        UserError: a link or a column refers to another file, or there are too many objects or nested groups.
    """
    _check_links(path, file)
    for name, place in sorted(_objects(path, file)):
        found = place.get(name.rpartition("/")[2])
        if isinstance(found, h5py.Dataset) and found.shape is not None:
            if found.is_virtual or found.external:
                how = f"where both are, h5repack {path.name} NEW makes one that holds it"
                raise UserError(f"{path}: column {name} lies in another file, which is not opened; {how}")
            yield name, found


def _check_links(path: Path, file: h5py.File) -> None:
    """Refuses a file with a link to another one; raises as `datasets_of`."""
    for name, group in _objects(path, file):
        if isinstance(group.get(name.rpartition("/")[2], getlink=True), h5py.ExternalLink):
            how = "give a file that holds its columns itself"
            raise UserError(f"{path}: {name} is a link to another file, which is not followed; {how}")


def _objects(path: Path, file: h5py.File) -> list[tuple[str, h5py.Group]]:
    """(path, group that contains it) of all links; a group that was visited before is not entered again."""
    found: list[tuple[str, h5py.Group]] = []
    most, deepest = MEMBERS.value, DEPTH.value
    seen = {_address(file)}
    stack: list[tuple[str, h5py.Group, int]] = [("", file, 1)]
    while stack:
        prefix, group, depth = stack.pop()
        if depth > deepest:
            raise beyond(path, depth, deepest, DEPTH, "has groups within groups in")
        for key in group:
            if len(found) >= most:
                raise beyond(path, len(found) + 1, most, MEMBERS, "holds")
            name = f"{prefix}{key}"
            found.append((name, group))
            link = group.get(key, getlink=True)
            if isinstance(link, h5py.HardLink) and group.get(key, getclass=True) is h5py.Group:
                inner = cast(h5py.Group, group[key])
                if (address := _address(inner)) not in seen:
                    seen.add(address)
                    stack.append((f"{name}/", inner, depth + 1))
        alive()
    return found


def _address(group: h5py.Group) -> Any:
    return h5o.get_info(group.id).addr
