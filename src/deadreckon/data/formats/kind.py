"""The format of a file, detected from its content and not from its name, and the options of each format."""

import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

from deadreckon.data.formats import folder as folders
from deadreckon.data.formats import minari_ids as minaris
from deadreckon.data.formats.dialect import is_table, text_of
from deadreckon.data.formats.json_table import begins_object, is_json_table, without_mark
from deadreckon.data.formats.rllib import files_of, is_rllib
from deadreckon.data.formats.vw import is_vw
from deadreckon.errors import UserError, reading
from deadreckon.foreign.door import opened, unpacked

FORMATS = (
    "hdf5, Parquet, CSV with commas, semicolons, tabs or bars, JSON lines, spreadsheets, SQLite, DuckDB, npz, pickle, "
    "RLlib's batches, VW's text, a Minari data set or a folder of deadreckon's"
)
TABLES = ("csv", "json", "parquet", "excel", "sqlite", "duckdb")  # formats whose columns may have any names
# Options of the readers, and the formats that have them.
READING = {
    "separator": ("csv",), "decimal": ("csv",), "thousands": ("csv",), "encoding": ("csv",),
    "dates": ("csv", "json", "parquet", "excel", "sqlite", "duckdb"), "sheet": ("excel",), "query": ("sqlite", "duckdb"),
    "table": ("sqlite", "duckdb"),
}  # fmt: skip
DIALECT = ("separator", "decimal", "thousands", "encoding", "dates")  # those on how values are written
_WORDS = {
    "csv": "CSV", "json": "JSON", "rllib": "RLlib's JSON", "parquet": "Parquet", "excel": "a spreadsheet", "sqlite": "SQLite",
    "duckdb": "DuckDB",
}  # fmt: skip
_MAGIC = ((b"\x89HDF\r\n\x1a\n", "hdf5"), (b"PAR1", "parquet"), (b"PK\x03\x04", "npz"), (b"SQLite format 3\0", "sqlite"),
          (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "excel"))  # fmt: skip
_HEAD, _ROW = 4096, 2**24  # bytes of a file, and further ones of a long object of JSON, by which its format is detected
_CONTENTS = "[Content_Types].xml"


def sniff(path: Path | str, separator: str | None = None) -> str:
    """The format of a log: hdf5, parquet, npz, pickle, csv, json, excel, sqlite, duckdb, rllib, vw, minari or
    folder.

    Args:
        path: of the file or folder.
        separator: of the columns of a text file, if it is known; else a common one must occur.

    Raises:
        UserError: the file does not exist, is empty, or has none of these formats.
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
        why = f"this folder holds no log ({folders.HEADER} or Minari's data/metadata.json)"
        parts = any(each.suffix == ".parquet" for each in path.rglob("*"))
        how = f"; `deadreckon data convert {path} OUT` makes one of its Parquet files" if parts else ""
        raise UserError(f"{path}: {why}{how}")
    if minaris.is_id(str(path)) and not path.exists():
        raise UserError(minaris.missing(str(path)))
    with opened(path) as file, reading(path, "gzip"):
        packed = file.read(2) == b"\x1f\x8b"
        content = unpacked(path, file)
        head = content.read(_HEAD)
        if begins_object(head) and b"\n" not in without_mark(head):  # a batch or a row, which is seen as a whole
            head += content.read(_ROW)
    if not head:
        raise UserError(f"{path}: the file is empty")
    kind = next((kind for magic, kind in _MAGIC if head.startswith(magic)), "duckdb" if head[8:12] == b"DUCK" else "")
    if kind and packed:
        raise UserError(f"{path}: a gzipped {kind} file; unpack it first (gunzip)")
    if kind == "npz" and _is_spreadsheet(path, head):
        return "excel"
    if kind == "npz" and (name := _no_array(path)) is not None:
        raise UserError(f"{path}: a zip archive that holds {name}; unpack it first (unzip), and give the file in it")
    if kind:
        return kind
    if _is_pickle(head):
        return "pickle"
    if separator is None and is_vw(head):  # whose bars may separate columns, too
        return "vw"
    if is_rllib(head):
        return "rllib"
    if is_json_table(head):
        return "json"
    if re.match(rb"\s*\[\s*\[", head):
        raise UserError(f"{path}: a list of lists in JSON has no names of columns; write a list of objects, or CSV")
    if is_table(head, separator):
        return "csv"
    one = "; a table of one column is read from Parquet or a spreadsheet, not from text" if text_of(head) is not None else ""
    raise UserError(f"{path}: not a log in a format that is read ({FORMATS}){one}")


def no_options(path: Path | str, kind: str, given: dict[str, Any]) -> None:
    """Refuses options of other formats, and roles of columns for formats whose columns have fixed names.

    Args:
        path: named in errors.
        kind: its format.
        given: {option: its value, or None}.

    Raises:
        UserError: one line with the option and the format.
    """
    for key in sorted(key for key, value in given.items() if value is not None and key != "name"):
        if key in READING and kind not in READING[key]:
            formats = " or ".join(_WORDS[each] for each in READING[key])
            raise UserError(f"{path}: --{key} is for {formats}, but this is {_WORDS.get(kind, kind)}")
        if kind not in TABLES:
            raise UserError(f"{path}: {key} names a column of a table, but this is {_WORDS.get(kind, kind)}, which has its own")


def _is_spreadsheet(path: Path, head: bytes) -> bool:
    """Whether a zip archive is a spreadsheet of Excel or OpenDocument; a damaged one is recognised by its first bytes."""
    names = _members(path)
    if names is None:
        return any(name in head for name in (_CONTENTS.encode(), b"opendocument.spreadsheet", b"xl/"))
    return (_CONTENTS in names and any(name.startswith("xl/") for name in names)) or b"opendocument.spreadsheet" in head


def _no_array(path: Path) -> str | None:
    """The first file in a zip archive of files none of which is an array; None for other and for damaged archives."""
    names = [name for name in _members(path) or () if not name.endswith("/")]
    return None if not names or any(name.endswith(".npy") for name in names) else names[0]


def _members(path: Path) -> list[str] | None:
    """The names in a zip archive; None for a damaged one, which its reader will refuse."""
    try:
        with reading(path, "a zip archive"), zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except UserError:
        return None


def _is_pickle(head: bytes) -> bool:
    """Whether a file is a pickle: protocols 2 and up begin with their number, older ones with the text of a list or a dict."""
    if head[:1] == pickle.PROTO and len(head) > 1:
        return head[1] <= pickle.HIGHEST_PROTOCOL
    starts = (b"c__", b"ccopy_reg\n", b"cnumpy", b"cos\n", b"cposix\n", b"]q", b"}q")
    # A pickled list or dict is followed by its memo; a name of a column such as (dose) begins alike and is not.
    return head.startswith(starts) or re.match(rb"\((?:[ld]p\d+\n|i[\w.]+\n\w+\n)", head) is not None
