"""Downloading known logs, D4RL's originals and their Minari twins, with resume, checksum and progress.

A transfer goes into a hidden part beside the place where the log will be, so that a later one continues from there. The log
gets its name only when it is complete and can be read.
"""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from deadreckon.data.catalogue import cached_path, entry, plain_name, record_path
from deadreckon.data.connection import TransferError
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import ORIGINAL, TWIN, Entry
from deadreckon.data.transfer import Progress, Received, RetryPolicy, Sums, fetch, file_size, forget, sha256_of
from deadreckon.errors import UserError, unknown
from deadreckon.files import alone, read_json, write_json
from deadreckon.interrupts import resumable

# source: (environment variable that overrides the root, the root)
ROOTS = {
    ORIGINAL: ("DEADRECKON_D4RL_URL", "http://rail.eecs.berkeley.edu/datasets/offline_rl"),
    TWIN: ("DEADRECKON_MINARI_URL", "https://huggingface.co/datasets/farama-minari"),
}
_MAGIC = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Download:
    """A downloaded log.

    Attributes:
        name: such as `hopper-medium-v2@d4rl`.
        path: in the cache.
        new: whether it was downloaded now, or was in the cache.
        sha256: of the file that came, which for a twin is Minari's `main_data.hdf5`; None where it was not recorded.
        vouched: the source of a checksum that matches the file; None if there is none.
    """

    name: str
    path: Path
    new: bool
    sha256: str | None
    vouched: str | None


def get(
    name: str,
    source: str | None = None,
    *,
    sha256: str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    retry: RetryPolicy | None = None,
) -> Download:
    """Downloads a known log into the cache, where `deadreckon.load` finds it as `NAME@d4rl` or `NAME@minari`.

    If two processes download the same log, the second is refused while the first is running.

    Args:
        name: from the catalogue, such as `hopper-medium-v2`, or its twin's id on Minari.
        source: `d4rl` for the original, `minari` for its twin, which others collected and which differs; None: what the name
            says, which is the twin for an id of Minari's, else the original.
        sha256: the required checksum, in hexadecimal; for a Minari version that of its `main_data.hdf5`.
        force: download it again if it is in the cache.
        progress: called with the bytes received, and the total bytes or None.
        retry: of the transfer.

    Raises:
        UserError: one line: no such log, or the error, the address and another way to obtain the log.
    """
    name, source = plain_name(name), source_of(name, source)
    found = _known(name, source)
    wanted = _checked_sum(sha256)
    path = cached_path(f"{found.name}@{source}")
    if path.exists() and not force:
        return _there(found, source, path, wanted)
    sums = {"the caller": ("sha256", wanted)} if wanted else {}
    if source == ORIGINAL and found.sha256:
        sums["the catalogue"] = ("sha256", found.sha256.lower())
    try:
        with alone(path), resumable(path.with_name(f".{path.name}.part")):
            if path.exists() and not force:  # another process was faster
                return _there(found, source, path, wanted)
            make = _original if source == ORIGINAL else _twin
            received = make(found, path, sums, progress or (lambda done, total: None), retry or RetryPolicy())
    except TransferError as error:
        raise UserError(f"{error}; {_offline(found)}".removesuffix("; ")) from error
    except OSError as error:  # of the disk: those of the network were told apart before
        raise UserError(f"cannot write {path}: {error.strerror or error} (the part that has arrived is kept)") from error
    return Download(f"{found.name}@{source}", path, True, received.sha256, received.vouched)


def source_of(name: str, source: str | None) -> str:
    """Where a log is downloaded from: the given source, else what its name says."""
    return source or (TWIN if plain_name(name).endswith(f"@{TWIN}") else ORIGINAL)


def _original(found: Entry, path: Path, sums: Sums, progress: Progress, retry: RetryPolicy) -> Received:
    """Downloads D4RL's file to `path`, byte for byte; where it came from is recorded beside it."""
    from deadreckon.data.formats.hdf5 import read_hdf5

    part = path.with_name(f".{path.name}.part")
    received = fetch(_address(ORIGINAL, found.original or ""), part, sums, progress=progress, retry=retry)
    with _readable(received.url, part, part):
        read_hdf5(part, name=found.name)
    with open(part, "rb+") as file:
        os.fsync(file.fileno())
    # Killed between any two of these steps, a file may lack its record, which `load` tells, but never has another's.
    record_path(path).unlink(missing_ok=True)
    part.replace(path)
    write_json(record_path(path), _record(received))
    forget(part)
    return received


def _twin(found: Entry, path: Path, sums: Sums, progress: Progress, retry: RetryPolicy) -> Received:
    """Downloads Minari's files and makes `path` of them, with the columns that every log has."""
    from deadreckon.data.formats.hdf5 import write_hdf5
    from deadreckon.data.formats.minari import read_minari

    twin = found.minari or ""
    repository, _, rest = twin.partition("/")  # on the hub the first part of an id is a repository, the rest a folder
    root = _address(TWIN, f"{repository}/resolve/main/{rest}/data")
    data = path.with_name(f".{path.name}.part") / "data"
    about, main = data / "metadata.json", data / "main_data.hdf5"
    data.mkdir(parents=True, exist_ok=True)
    try:
        forget(about)  # it is small, and that of another time might not fit
        fetch(f"{root}/{about.name}", about, retry=retry)
        steps = _checked_metadata(f"{root}/{about.name}", about)
        received = fetch(f"{root}/{main.name}", main, sums, progress=progress, retry=retry)
        with _readable(received.url, main, data):
            log = read_minari(data)
            if len(log) != steps:
                raise UserError(f"it has {len(log):,} steps, but {about.name} says {steps:,}")
            if found.twin_layout is not None:
                log = _laid_out(log, *found.twin_layout)
    except UserError:
        if not file_size(main):  # nothing that the next transfer could go on from
            shutil.rmtree(data.parent)
        raise
    extra = {**log.provenance.extra, "dataset_id": twin, **_record(received)}
    origin = replace(log.provenance, source="minari", recipe=None, path=None, extra=extra)
    log = replace(log, name=f"{found.name}@{TWIN}", provenance=origin)
    write_hdf5(log, path)
    shutil.rmtree(data.parent)
    return received


def _laid_out(log: Dataset, width: int, kept: tuple[int, ...], constants: tuple[float, ...]) -> Dataset:
    """The log with these columns of each observation and constants behind them; the provenance says so.

    Raises:
        UserError: observations have not the `width` that the layout is for.
    """
    if log.spec.observation_size != width:
        raise UserError(f"it has {log.spec.observation_size} numbers per observation, but it should have {width}")

    def change(seen: np.ndarray | None) -> np.ndarray | None:
        if seen is None:
            return None
        behind = np.broadcast_to(np.asarray(constants, seen.dtype), (len(seen), len(constants)))
        return np.concatenate([seen[:, list(kept)], behind], 1)

    columns: dict[str, Any] = {key: change(getattr(log, key)) for key in ("observations", "final_observations", "successors")}
    note = f"columns {_ranges(kept)} of {width}, then {len(constants)} constants"
    return replace(log, **columns, provenance=replace(log.provenance, extra={**log.provenance.extra, "observations": note}))


def _ranges(columns: tuple[int, ...]) -> str:
    """Columns that follow each other as `first-last`."""
    breaks = [i for i in range(1, len(columns)) if columns[i] != columns[i - 1] + 1]
    return ", ".join(f"{columns[a]}-{columns[b - 1]}" for a, b in pairwise([0, *breaks, len(columns)]))


def _checked_metadata(url: str, about: Path) -> int:
    """The number of steps that Minari's metadata says; refuses metadata that our reader could not take safely."""
    try:
        metadata = read_json(about)
        if not isinstance(metadata, dict) or not isinstance(metadata.get("total_steps"), int):
            raise UserError("it is not the metadata of a Minari data set")
        if metadata.get("data_format") != "hdf5":
            raise UserError(f"the data set is stored as {metadata.get('data_format')}; hdf5 is needed")
        # Without them Minari makes the environment that the metadata names, which runs code that a server chose.
        if not all(isinstance(metadata.get(key), str) for key in ("observation_space", "action_space")):
            raise UserError("it names no observation_space and action_space")
    except UserError as error:
        forget(about)
        raise TransferError(f"{url}: {str(error).removeprefix(f'{about} ')}") from error
    return metadata["total_steps"]


@contextlib.contextmanager
def _readable(url: str, part: Path, place: Path) -> Iterator[None]:
    """Removes a part that is no log, and says so with its address in place of `place`, which is read."""
    try:
        with open(part, "rb") as file:
            head = file.read(40)
        if not head.startswith(_MAGIC):
            begins = f"begins with {head.decode('latin-1')!r}" if head else "is empty"
            raise UserError(f"what the server sent is no hdf5 file, it {begins}")
        yield
    except UserError as error:
        forget(part)
        raise TransferError(f"{url}: {str(error).removeprefix(f'{place}: ')}; the file was removed") from error


def _record(received: Received) -> dict[str, Any]:
    """What the provenance of a downloaded log says."""
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return {"url": received.url, "sha256": received.sha256, "vouched": received.vouched, "bytes": received.size, "date": date}


def _known(name: str, source: str) -> Entry:
    """The entry of a log that can be had from `source`."""
    if source not in ROOTS:
        raise unknown("source", source, ROOTS)
    base, _, version = name.partition("@")
    found = entry(base)
    if version not in ("", source):
        raise UserError(f"{name} and the source {source} contradict each other; leave @{version} out")
    if source not in found.sources:
        what = {ORIGINAL: "original at D4RL's", TWIN: "Minari twin"}
        others = [f"--source {other} downloads its {what[other]}" for other in found.sources]
        raise UserError(f"{base} has no {what[source]}: {', '.join(each for each in [*others, _offline(found)] if each)}")
    return found


def _offline(found: Entry) -> str:
    """How a log is had without a network; empty where there is no recipe."""
    return "" if found.recipe is None else f"`deadreckon data collect {found.recipe}` makes it here"


def _checked_sum(sha256: str | None) -> str | None:
    if sha256 is not None and not re.fullmatch("[0-9a-fA-F]{64}", sha256):
        raise UserError(f"sha256 must be 64 hexadecimal digits, got {sha256!r}")
    return sha256 and sha256.lower()


def _there(found: Entry, source: str, path: Path, wanted: str | None) -> Download:
    """The log that is at `path` already, if it is the wanted one."""
    if source == ORIGINAL:
        record = read_json(record_path(path)) if record_path(path).exists() else None
        have = sha256_of(path) if wanted else None
    else:
        from deadreckon.data.formats.hdf5 import read_hdf5

        record, have = read_hdf5(path, mmap=True).provenance.extra, None
    record = record if isinstance(record, Mapping) else {}
    have = have or record.get("sha256")
    if wanted and have != wanted:
        raise UserError(f"{path} is there with another sha256: expected {wanted}, got {have}; --force downloads it again")
    return Download(f"{found.name}@{source}", path, False, have, "the caller" if wanted else record.get("vouched"))


def _address(source: str, place: str) -> str:
    """The address of `place` below the root of `source`."""
    variable, root = ROOTS[source]
    root = os.environ.get(variable) or root
    if not re.match(r"https?://[^/]", root):
        raise UserError(f"{variable} must be an address that begins with http:// or https://, got {root!r}")
    return f"{root.rstrip('/')}/{quote(place)}"
