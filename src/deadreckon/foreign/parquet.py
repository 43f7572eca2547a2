"""Parquet files: what they unpack to is counted before they are read, as the sizes that they say are those of packed pages.

A text that stands once in a file's dictionary may be meant by millions of rows, and a number that is repeated takes no bytes.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from deadreckon.errors import UserError, reading
from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked
from deadreckon.names import repeated

if TYPE_CHECKING:
    import pyarrow as pa

ROWS = 65_536  # of a batch, as those are read that go to the disk part by part
_CELLS = 1 << 22  # of a batch
_FEW = 1024  # rows of a batch of which each may be as long as all that was read before
_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "INT96": 8, "FLOAT": 4, "DOUBLE": 8, "BYTE_ARRAY": 8}


def read_parquet(path: Path | str, kind: str = "Parquet", *, threads: bool = True) -> "pa.Table":
    """The table of a file, whose values are valid.

    Args:
        path: of the file; names of its folders are no columns.
        kind: what it should be, in words, for errors.
        threads: read columns side by side.

    Raises:
        UserError: see `check_parquet`; or two columns have one name.
    """
    from pyarrow import parquet

    check_parquet(path, kind)
    with reading(path, kind), parquet.ParquetFile(path) as file:
        found = file.read(use_threads=threads)
        found.validate(full=True)  # texts that are no UTF-8 would fail wherever they are first looked at
    if twice := repeated(found.column_names):
        raise UserError(f"{path}: two of its columns are called {twice[0]!r}, and only one can be meant; rename one")
    return found


def check_parquet(path: Path | str, kind: str = "Parquet", *, whole: bool = True) -> None:
    """Refuses a file whose values would take more memory than they may.

    Columns of texts are read for this, with every text once: that takes no more memory than their pages do.

    Args:
        path: of the file.
        kind: what it should be, in words, for errors.
        whole: whether it is read at once; otherwise `ROWS` rows at a time must not take more than they may.

    Raises:
        UserError: it is no file, is damaged, or unpacks to more than it may (`foreign.limits`).
    """
    from pyarrow import parquet

    size = file_size(path)
    most = max_unpacked(size)
    # Arrow ends the process where it is asked what a damaged file says of a column.
    told = read_apart("parquet", path, kind, size=size, file=str(path))["columns"]
    with reading(path, kind):
        with parquet.ParquetFile(path) as file:
            leaves = [file.schema.column(i) for i in range(len(file.schema))]
        total = 0
        for leaf, column in zip(leaves, told, strict=True):
            # Texts have 8 bytes that say where they are, and so have lists; decimals have 16, however few are stored.
            known = _WIDTHS.get(leaf.physical_type, max(leaf.length, 16))
            width = (max(known, 16) if leaf.logical_type.type == "DECIMAL" else known) + 8 * leaf.max_repetition_level
            total += width * (column["values"] if whole else min(column["most"], ROWS))
        if total > most:
            raise beyond(path, total, most, UNPACKED, "unpacks to")
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
        if not texts:
            return
        # Texts that are told from the one before (delta encodings) cannot be read as a dictionary, and may all be long.
        deltas = {leaf.path for leaf, column in zip(leaves, told) if column["delta"]}
        with parquet.ParquetFile(path, read_dictionary=[name for name in texts if name not in deltas]) as file:
            rows = max(min(_CELLS // len(texts), _FEW if deltas & set(texts) else ROWS), 1)
            for batch in file.iter_batches(rows, columns=texts):
                size = sum(map(_size, batch.columns))
                total = total + size if whole else size * (ROWS // rows)
                if total > most:
                    raise beyond(path, total, most, UNPACKED, "unpacks to")


def columns_of(file: str, shared: Any) -> dict[str, Any]:
    """What a file says of its columns, for the process that reads.

    Args:
        file: its path.
        shared: not used, for there are no arrays.

    Returns:
        `columns`, for each its number of `values`, the `most` of a row group, and whether it has a `delta` encoding.
    """
    from pyarrow import parquet

    columns = []
    with parquet.ParquetFile(file) as opened:
        about = opened.metadata
        groups = [about.row_group(i) for i in range(about.num_row_groups)]
        for i in range(len(opened.schema)):
            parts = [group.column(i) for group in groups]
            counts = [max(part.num_values, group.num_rows) for part, group in zip(parts, groups)]
            delta = any(name.startswith("DELTA") for part in parts for name in part.encodings)
            columns.append({"values": sum(counts), "most": max(counts, default=0), "delta": delta})
    return {"columns": columns}


def _size(values: Any) -> int:
    """Bytes of the texts of a column, each as often as it occurs."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(values.type):
        lengths = pc.call_function("binary_length", [values.dictionary]).cast(pa.int64())
        return pc.call_function("sum", [lengths.take(values.indices)]).as_py() or 0
    if pa.types.is_struct(values.type):
        return sum(map(_size, values.flatten()))
    if pa.types.is_map(values.type):
        return _size(values.keys) + _size(values.items)
    return _size(values.flatten()) if pa.types.is_nested(values.type) else values.nbytes
