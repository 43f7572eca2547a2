"""Parquet files: what they unpack to is counted before they are read, as the sizes that they say are those of packed pages.

A text that stands once in a file's dictionary may be meant by millions of rows, and a number that is repeated takes no bytes.
"""

from collections.abc import Sequence
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
    check_names(path, found.column_names)
    return found


def check_names(path: Path | str, names: Sequence[str]) -> None:
    """Refuses a table with two columns of one name."""
    if twice := repeated(names):
        raise UserError(f"{path}: two of its columns are called {twice[0]!r}, and only one can be meant; rename one")


def check_parquet(path: Path | str, kind: str = "Parquet", *, whole: bool = True) -> None:
    """Refuses a file whose values would take more memory than they may.

    Columns of texts are read for this, with every text once: that takes no more memory than their pages do. Before that a row
    of each part is read: Arrow ends the process where it is asked what a damaged file says of a column, and not where it reads.

    Args:
        path: of the file.
        kind: what it should be, in words, for errors.
        whole: whether it is read at once; otherwise `ROWS` rows at a time must not take more than they may.

    Raises:
        UserError: it is no file, is damaged, or unpacks to more than it may (`foreign.limits`).
    """
    from pyarrow import parquet

    most = max_unpacked(file_size(path))
    with reading(path, kind):
        with parquet.ParquetFile(path, pre_buffer=False, buffer_size=1 << 16) as file:  # reads few bytes for a row
            about, leaves = file.metadata, [file.schema.column(i) for i in range(len(file.schema))]
            if any(leaf.max_repetition_level for leaf in leaves):  # a row of lists may hold very many values
                read_apart("parquet", path, kind, size=file_size(path), file=str(path))
            else:
                for i in range(about.num_row_groups):
                    next(file.iter_batches(1, row_groups=[i]), None)
            groups = [about.row_group(i) for i in range(about.num_row_groups)]
        total = 0
        for i, leaf in enumerate(leaves):
            # Texts have 8 bytes that say where they are, and so have lists; decimals have 16, however few are stored.
            known = _WIDTHS.get(leaf.physical_type, max(leaf.length, 16))
            width = (max(known, 16) if leaf.logical_type.type == "DECIMAL" else known) + 8 * leaf.max_repetition_level
            counts = [max(group.column(i).num_values, group.num_rows) for group in groups]
            total += width * (sum(counts) if whole else min(max(counts, default=0), ROWS))
        if total > most:
            raise beyond(path, total, most, UNPACKED, "unpacks to")
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
        if not texts:
            return
        # Texts that are told from the one before (delta encodings) cannot be read as a dictionary, and may all be long.
        deltas = {
            leaf.path for i, leaf in enumerate(leaves)
            if any(name.startswith("DELTA") for group in groups for name in group.column(i).encodings)
        }  # fmt: skip
        with parquet.ParquetFile(path, read_dictionary=[name for name in texts if name not in deltas]) as file:
            rows = max(min(_CELLS // len(texts), _FEW if deltas & set(texts) else ROWS), 1)
            for batch in file.iter_batches(rows, columns=texts):
                size = sum(map(_size, batch.columns))
                total = total + size if whole else size * (ROWS // rows)
                if total > most:
                    raise beyond(path, total, most, UNPACKED, "unpacks to")


def said(file: str, shared: Any) -> dict[str, Any]:
    """Asks for what a file says of its columns, in the process that may end with it; `file` is its path."""
    from pyarrow import parquet

    with parquet.ParquetFile(file) as opened:
        for i in range(opened.metadata.num_row_groups):
            for column in range(opened.metadata.num_columns):
                opened.metadata.row_group(i).column(column)
    return {}


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
