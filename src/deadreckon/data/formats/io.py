"""Reading and converting logs of any format, which is detected from the content."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats import folder as folders
from deadreckon.data.formats import minari as minaris
from deadreckon.data.formats.build import refuse_mmap
from deadreckon.data.formats.kind import DIALECT, READING, TABLES, no_options, sniff
from deadreckon.data.formats.minari_ids import PREFIX
from deadreckon.data.formats.open_bandit import open_bandit
from deadreckon.data.schema import Schema, as_schema
from deadreckon.data.schema_file import is_schema
from deadreckon.errors import UserError, cannot_write
from deadreckon.files import alone
from deadreckon.progress import Progress, unwatched
from deadreckon.temporaries import beside, recover

_ENDINGS = (".hdf5", ".h5", ".parquet", ".csv", ".npz")  # of the files that are written
_MAPPED = ("hdf5", "folder")  # columns that can be memory-mapped
LARGE = 2**30  # bytes of a folder's columns above which they are memory-mapped by default
_TELLING = ("folder", "minari")  # formats that mark where episodes end


def read(
    path: Path | str,
    *,
    mmap: bool | None = None,
    strict: bool = False,
    name: str | None = None,
    horizon: int | None = None,
    **mapping: Any,
) -> Dataset:
    """Reads a log; the format is detected from the content, not from the name.

    Args:
        path: a file (D4RL hdf5, Parquet, CSV in any dialect, JSON, spreadsheets, SQLite, DuckDB, npz, RLlib's batches, VW's
            text, pickled demonstrations; CSV, JSON and pickles may be gzipped), a folder (Minari's or ours), `minari:` and an
            id (only the id if the data set is installed here), or the TOML file of a schema that names a table beside it.
        mmap: memory-map the columns, for logs larger than memory; only hdf5 files and folders written here. None: only folders
            whose columns take more than 1 GiB, on any machine, because the default held-out part depends on it.
        strict: refuse actions out of bounds instead of warning.
        name: of the log.
        horizon: steps after which an episode is cut by a timeout, for files that do not mark their time limits.
        **mapping: for tables, the roles of columns: see `Dataset.from_frame`; and options of the reader, if they are not
            detected correctly: `separator`, `decimal`, `thousands`, `encoding`, `dates` (CSV), `sheet` (spreadsheets), `query`,
            `table` (databases): see `formats.any_table.table_of_kind`.

    Raises:
        UserError: one line with the file, and column and row where they apply.
    """
    path, kind, mapping = _looked_at(path, mapping)
    return _read(path, kind, mmap, strict, name, horizon, mapping)


def _looked_at(path: Path | str, mapping: Mapping[str, Any]) -> tuple[Path | str, str, dict[str, Any]]:
    """The file to read, its format, and the mapping with the options of a schema."""
    path, mapping = _meant(path, mapping)
    ways: dict[str, Any] = {}
    if "schema" in mapping:
        mapping["schema"] = schema = as_schema(mapping["schema"])
        ways = schema.options()
    kind = sniff(path, mapping.get("separator", ways.get("separator")))
    # A schema drafted for a CSV file also applies to the same table in another format, which needs no dialect.
    return path, kind, {key: value for key, value in ways.items() if key not in DIALECT or kind in READING[key]} | mapping


def _meant(path: Path | str, mapping: Mapping[str, Any]) -> tuple[Path | str, dict[str, Any]]:
    """The table that a schema's file stands for, or any other path itself, and what is given of the mapping with the schema."""
    mapping = {key: value for key, value in mapping.items() if value is not None}
    if not is_schema(path):
        return path, mapping
    if "schema" in mapping:
        raise UserError(f"{path} is a schema itself; give the table, and --schema {path}")
    schema = Schema.load(path)
    return schema.file_beside(path), {**mapping, "schema": schema}


def _read(
    path: Path | str, kind: str, mmap: bool | None, strict: bool, name: str | None, horizon: int | None, mapping: dict[str, Any]
) -> Dataset:
    """See `read`; for a file of known format."""
    mapping, told = open_bandit(path, kind, mapping)
    if mmap is None:
        mmap = kind == "folder" and folders.folder_bytes(path) > LARGE
    options = _options(path, kind, mmap, horizon, mapping)
    log = _reader(kind)(path, strict=strict, name=name, **options)
    return replace(log, warnings=(*told, *log.warnings))


def _options(path: Path | str, kind: str, mmap: bool, horizon: int | None, mapping: dict[str, Any]) -> dict[str, Any]:
    """The options for the reader of a format; others that were given are refused."""
    no_options(path, kind, mapping)
    if mmap and kind not in _MAPPED:
        raise refuse_mmap(path, f"{kind} is not stored column by column")
    if horizon is not None and kind in _TELLING:
        raise UserError(f"{path}: {kind} says where episodes end; a horizon is for files that do not say")
    options: dict[str, Any] = mapping if kind in TABLES else {}
    if kind in _MAPPED:
        options = {**options, "mmap": mmap}
    return options if kind in _TELLING else {**options, "horizon": horizon}


def _reader(kind: str) -> Callable[..., Dataset]:
    """The reader of a format. Its library is imported only if there is such a file."""
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
    else:
        from deadreckon.data.formats.tables import read_tabular

        return partial(read_tabular, kind=kind)
    return reader


def convert(
    source: Path | str,
    target: Path | str,
    *,
    force: bool = False,
    strict: bool = False,
    horizon: int | None = None,
    progress: Progress = unwatched,
    **mapping: Any,
) -> Dataset:
    """Reads `source`, writes it as `target`, and returns the log.

    Logs in hdf5 may be larger than memory, and so may tables in Parquet, Arrow and CSV if the target is a folder.

    Args:
        source: as for `read`.
        target: .hdf5, .parquet, .csv or .npz by its ending; `minari:ns/name-v0`; a folder if it has no ending or ends
            in a slash.
        force: replace `target` if it exists.
        strict: refuse actions out of bounds.
        horizon: as for `read`.
        progress: called, while a table is converted part by part, with the number of rows read and the total.
        **mapping: as for `read`.

    Raises:
        BusyError: another process writes `target`.
        UserError: `target` exists or has an unknown ending, or reading or writing fails.
    """
    if not str(target):
        raise UserError("the target is an empty text; name a file or a folder")
    asked: dict[str, Any] = {"force": force, "strict": strict, "horizon": horizon, "progress": progress, **mapping}
    if str(target).startswith(PREFIX):
        return _convert(source, target, **asked)
    with alone(Path(target), what=str(target)):
        return _convert(source, target, **asked)


def _convert(
    source: Path | str, target: Path | str, force: bool, strict: bool, horizon: int | None, progress: Progress, **mapping: Any
) -> Dataset:
    """See `convert`; called while the target is locked."""
    write = _writer(target)
    place = Path(target)
    recover(place)
    exists = not str(target).startswith(PREFIX) and place.exists()
    if exists and not force:
        raise UserError(f"{target} exists already; --force replaces it")
    if exists and place.is_dir() and not (place / folders.HEADER).is_file():
        raise UserError(f"{target} is a folder that holds no log, so it is not replaced; choose another name")
    table, given = _meant(source, mapping)
    if exists and Path(table).exists() and place.samefile(table):
        what = "the source itself" if table == source else f"the table that {source} stands for"
        raise UserError(f"{target} is {what}; choose another name")
    in_folder = str(target).endswith("/") or not (place.suffix or str(target).startswith(PREFIX))
    if in_folder and not str(source).startswith(PREFIX):
        from deadreckon.data.formats.stream import convert_table, streamed_format

        ways = as_schema(given["schema"]).options() if "schema" in given else {}
        if (streamed := streamed_format(table, given.get("separator", ways.get("separator")))) is not None:
            no_options(table, "csv" if streamed == "csv" else "parquet", given)
            return convert_table(
                table, target, streamed, force=force, strict=strict, horizon=horizon, progress=progress, **given
            )
    name = given.pop("name", None)
    source, kind, mapping = _looked_at(table, given)
    if kind != "hdf5":
        log = _read(source, kind, kind == "folder", strict, name, horizon, mapping)
        write(log, target, force)
        return log
    no_options(source, kind, mapping)
    from deadreckon.data.formats.hdf5 import read_hdf5

    # A file larger than memory can be converted: its columns are copied to disk, beside the target because the system's
    # temporary folder may be in memory, and the copies are deleted afterwards.
    try:
        if str(target).startswith(PREFIX):
            scratch = tempfile.TemporaryDirectory()
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            scratch = beside(place, folder=True)
        with scratch as folder:
            log = read_hdf5(source, mmap=True, strict=strict, name=name, horizon=horizon, scratch=folder)
            write(log, target, force)
    except OSError as error:
        raise cannot_write(target, error) from error
    return log


def _writer(target: Path | str) -> Callable[[Dataset, Any, bool], Any]:
    """The function that writes `target`, called with the log, the target and whether it may be replaced."""
    if str(target).startswith(PREFIX):
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
