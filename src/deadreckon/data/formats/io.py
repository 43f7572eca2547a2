"""Reading and converting logs of any format; what a file is, its content says."""

import gzip
import pickle
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats import folder as folders
from deadreckon.data.formats import minari as minaris
from deadreckon.data.formats.build import refuse_mmap
from deadreckon.data.formats.open_bandit import open_bandit
from deadreckon.data.formats.rllib import files_of, is_rllib
from deadreckon.data.formats.vw import is_vw
from deadreckon.errors import UserError

FORMATS = "hdf5, Parquet, CSV, npz, pickle, RLlib's JSON lines, VW's text, a Minari data set or a folder of deadreckon's"
_ENDINGS = (".hdf5", ".h5", ".parquet", ".csv", ".npz")  # of the files that are written
_MAPPED = ("hdf5", "folder")  # columns that can be memory-mapped
_TELLING = ("folder", "minari")  # say where episodes end
_TABLES = ("csv", "parquet")  # columns have names of the user's own


def read(
    path: Path | str,
    *,
    mmap: bool = False,
    strict: bool = False,
    name: str | None = None,
    horizon: int | None = None,
    **mapping: Any,
) -> Dataset:
    """Reads a log; the format is told by content, not by name.

    Args:
        path: a file (D4RL hdf5, Parquet, CSV, npz, pickled demonstrations; CSV and pickles may be gzipped), a folder
            (Minari's or ours), or `minari:` and an id; of a data set that is installed here, the id alone.
        mmap: memory-map the columns, for logs larger than memory; our own hdf5 files and folders can.
        strict: refuse actions out of bounds instead of warning.
        name: of the log.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.
        **mapping: for tables, which column is what: see `Dataset.from_frame`.

    Raises:
        UserError: one line with the file, and column and row where they apply.
    """
    kind = sniff(path)
    mapping, told = open_bandit(path, kind, mapping)
    options = _options(path, kind, mmap, horizon, mapping)
    log = _reader(kind)(path, strict=strict, name=name, **options)
    return replace(log, warnings=(*told, *log.warnings))


def _options(path: Path | str, kind: str, mmap: bool, horizon: int | None, mapping: dict[str, Any]) -> dict[str, Any]:
    """Those options that readers of a format take; what was asked for beyond them is refused."""
    _no_mapping(path, kind, mapping)
    if mmap and kind not in _MAPPED:
        raise refuse_mmap(path, f"{kind} is not stored column by column")
    if horizon is not None and kind in _TELLING:
        raise UserError(f"{path}: {kind} says where episodes end; a horizon is for files that do not say")
    options: dict[str, Any] = mapping if kind in _TABLES else {}
    if kind in _MAPPED:
        options = {**options, "mmap": mmap}
    return options if kind in _TELLING else {**options, "horizon": horizon}


def _reader(kind: str) -> Callable[..., Dataset]:
    """What reads a format. Its library is loaded only where there is such a file."""
    if kind == "folder":
        return folders.read_folder
    if kind == "minari":
        return minaris.read_minari
    if kind == "hdf5":
        from deadreckon.data.formats.hdf5 import read_hdf5 as reader
    elif kind == "pickle":
        from deadreckon.data.formats.pickles import read_pickle as reader
    elif kind == "npz":
        from deadreckon.data.formats.npz import read_npz as reader
    elif kind == "rllib":
        from deadreckon.data.formats.rllib import read_rllib as reader
    elif kind == "vw":
        from deadreckon.data.formats.vw import read_vw as reader
    elif kind == "parquet":
        from deadreckon.data.formats.tables import read_parquet as reader
    else:
        from deadreckon.data.formats.tables import read_csv as reader
    return reader


def sniff(path: Path | str) -> str:
    """The format of a log: hdf5, parquet, npz, pickle, csv, rllib, vw, minari or folder.

    Raises:
        UserError: there is nothing, it is empty, or no format that we read.
    """
    if str(path).startswith(minaris.PREFIX) or (not Path(path).exists() and minaris.installed(str(path))):
        return "minari"
    path = Path(path)
    if path.is_dir():
        if (path / folders.HEADER).is_file():
            return "folder"
        if (path / "metadata.json").is_file() or (path / "data" / "metadata.json").is_file():
            return "minari"
        if files_of(path):
            return "rllib"
        raise UserError(f"{path}: this folder holds no log ({folders.HEADER} or Minari's data/metadata.json)")
    packed = False
    try:
        with open(path, "rb") as file:
            head = file.read(4096)
            if packed := head[:2] == b"\x1f\x8b":
                file.seek(0)
                head = gzip.GzipFile(fileobj=file).read(4096)
    except FileNotFoundError as error:
        raise UserError(f"no file {path}") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UserError(f"{path}: cannot be unpacked, it is damaged or cut short ({error})") from error
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror or error}") from error
    if not head:
        raise UserError(f"{path}: the file is empty")
    for magic, kind in ((b"\x89HDF\r\n\x1a\n", "hdf5"), (b"PAR1", "parquet"), (b"PK\x03\x04", "npz")):
        if head.startswith(magic) and packed:
            raise UserError(f"{path}: a gzipped {kind} file; unpack it first (gunzip)")
        if head.startswith(magic):
            return kind
    if _is_pickle(head):
        return "pickle"
    for kind, test in (("vw", is_vw), ("rllib", is_rllib)):
        if test(head):
            return kind
    line = head.partition(b"\n")[0].strip()
    if b"\0" not in head and b"," in line:
        return "csv"
    for separator, words in ((b";", "semicolons"), (b"\t", "tabs")):
        if b"\0" not in head and separator in line[:-1]:
            raise UserError(f"{path}: not CSV: its columns are separated by {words}, a comma is needed as separator")
    raise UserError(f"{path}: not a log in a format that is read ({FORMATS})")


def convert(
    source: Path | str,
    target: Path | str,
    *,
    force: bool = False,
    strict: bool = False,
    horizon: int | None = None,
    **mapping: Any,
) -> Dataset:
    """Reads `source` and writes it as `target`; gives the log.

    Args:
        source: as for `read`.
        target: .hdf5, .parquet, .csv or .npz by its ending; `minari:ns/name-v0`; a folder if it has no ending or ends
            in a slash.
        force: replace `target` if it exists.
        strict: refuse actions out of bounds.
        horizon: as for `read`.
        **mapping: as for `read`.

    Raises:
        UserError: `target` exists or has an unknown ending, or reading or writing fails.
    """
    write = _writer(target)
    place = Path(target)
    exists = not str(target).startswith(minaris.PREFIX) and place.exists()
    if exists and not force:
        raise UserError(f"{target} exists already; --force replaces it")
    if exists and place.is_dir() and not (place / folders.HEADER).is_file():
        raise UserError(f"{target} is a folder that holds no log, so it is not replaced; choose another name")
    if exists and Path(source).exists() and place.samefile(source):
        raise UserError(f"{target} is the source itself; choose another name")
    kind = sniff(source)
    _no_mapping(source, kind, mapping)
    if kind != "hdf5":
        log = read(source, mmap=kind == "folder", strict=strict, horizon=horizon, **mapping)
        write(log, target, force)
        return log
    from deadreckon.data.formats.hdf5 import read_hdf5

    # A file larger than memory can be converted: its columns go through copies on disk, beside the target because the
    # system's temporary folder may be in memory, and nobody sees them afterwards.
    beside = None if str(target).startswith(minaris.PREFIX) else place.parent
    try:
        if beside is not None:
            beside.mkdir(parents=True, exist_ok=True)
        scratch = tempfile.TemporaryDirectory(prefix=".deadreckon-", dir=beside)
    except OSError as error:
        raise UserError(f"cannot write {target}: {error.strerror or error}") from error
    with scratch as folder:
        log = read_hdf5(source, mmap=True, strict=strict, name=mapping.get("name"), horizon=horizon, scratch=folder)
        write(log, target, force)
    return log


def _writer(target: Path | str) -> Callable[[Dataset, Any, bool], Any]:
    """What writes `target`, called with the log, the target and whether it may be replaced."""
    if str(target).startswith(minaris.PREFIX):
        return lambda log, path, force: minaris.write_minari(log, str(path), force=force)
    ending = Path(target).suffix.lower()
    if str(target).endswith("/") or not ending:
        return lambda log, path, force: folders.write_folder(log, path, force=force)
    if ending in (".hdf5", ".h5"):
        from deadreckon.data.formats.hdf5 import write_hdf5

        return lambda log, path, force: write_hdf5(log, path)
    if ending == ".npz":
        from deadreckon.data.formats.npz import write_npz

        return lambda log, path, force: write_npz(log, path)
    if ending in _ENDINGS:
        from deadreckon.data.formats.tables import write_csv, write_parquet

        return lambda log, path, force: (write_csv if ending == ".csv" else write_parquet)(log, path)
    known = ", ".join(_ENDINGS)
    raise UserError(f"{target}: unknown ending {ending}; known: {known}, none (a folder), minari:ns/name-v0")


def _no_mapping(path: Path | str, kind: str, mapping: dict[str, Any]) -> None:
    """Refuses names of columns for formats whose columns have names of their own."""
    given = sorted(key for key, value in mapping.items() if value is not None and key != "name")
    if given and kind not in _TABLES:
        raise UserError(f"{path}: {given[0]} names a column of a table, but this is {kind}, which has its own")


def _is_pickle(head: bytes) -> bool:
    """Protocols 2 and up begin with their number; older ones with the text of a list or a dict."""
    if head[:1] == pickle.PROTO and len(head) > 1:
        return head[1] <= pickle.HIGHEST_PROTOCOL
    starts = (b"c__", b"ccopy_reg\n", b"cnumpy", b"cos\n", b"cposix\n")
    return head[:2] in (b"(l", b"(d", b"(i", b"]q", b"}q") or head.startswith(starts)
