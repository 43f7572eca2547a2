"""Tables from text files larger than memory: cells are written to files as bytes, and then converted column by column.

Types are those of `pyarrow.csv.read_csv` on the whole file: the first in `_KINDS` that fits all cells of a column.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from deadreckon.data.arrow import compute as _compute
from deadreckon.data.scratch import BLOCK
from deadreckon.progress import Progress, unwatched

# In the order in which pyarrow tries them ("Column type inference" in its documentation).
_KINDS = (pa.null(), pa.int64(), pa.bool_(), pa.date32(), pa.time32("s"), pa.timestamp("s"), pa.timestamp("s", "UTC"),
          pa.timestamp("ns"), pa.timestamp("ns", "UTC"), pa.float64(), pa.string(), pa.binary())  # fmt: skip


class Spool:
    """Keeps columns in files, which are mapped into memory.

    Args:
        folder: of the files.
        progress: called repeatedly with the number of rows read.

    Attributes:
        cells: of the file that was read, as bytes.
    """

    cells: pa.Table

    def __init__(self, folder: Path, progress: Progress = unwatched):
        self.folder, self.progress, self.count = folder, progress, 0

    def keep(self, values: Any) -> pa.ChunkedArray:
        """Writes a column to a file and returns it memory-mapped."""
        values = values if isinstance(values, pa.ChunkedArray) else pa.chunked_array([values])
        chunks = (chunk.slice(start, BLOCK) for chunk in values.chunks for start in range(0, len(chunk), BLOCK))
        return self._column(chunks, values.type)

    def read(self, source: Any, read: csv.ReadOptions, parse: csv.ParseOptions, convert: dict[str, Any]) -> pa.Table:
        """Reads a file, with the result of `pyarrow.csv.read_csv`.

        Args:
            source: the file, open for reading.
            read: as for `read_csv`.
            parse: as for `read_csv`.
            convert: the arguments of `ConvertOptions`.
        """
        names = csv.open_csv(source, read, parse).schema.names
        source.seek(0)
        as_it_stands = csv.ConvertOptions(column_types=dict.fromkeys(names, pa.binary()))
        batches = csv.open_csv(source, read, parse, as_it_stands)
        self.cells = self._mapped(self._watched(batches), batches.schema)
        kinds = convert.get("column_types", {})
        typed = [self._typed(column, convert, kinds.get(name)) for name, column in zip(names, self.cells.columns, strict=True)]
        return pa.table(typed, names=names)

    def _watched(self, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        rows = 0
        for batch in batches:
            rows += batch.num_rows
            self.progress(rows, None)
            yield batch

    def _typed(self, cells: pa.ChunkedArray, convert: dict[str, Any], known: pa.DataType | None) -> pa.ChunkedArray:
        """The cells of a column with their type; `known` is the one that `convert` has under the column's own name."""
        convert = {key: value for key, value in convert.items() if key != "column_types"}  # every column is called 0 here
        if known is not None:
            given = {**convert, "column_types": {"0": known}}
            return self._column((_converted(chunk, given) for chunk in cells.chunks), known)
        kinds = [_KINDS.index(_converted(chunk, convert).type) for chunk in cells.chunks]
        for kind in _KINDS[max(kinds, default=0) :]:
            given = {**convert, "column_types": {"0": kind}}
            try:
                return self._column((_converted(chunk, given) for chunk in cells.chunks), kind)
            except pa.ArrowInvalid:  # another part of the file has cells of another type
                continue
        raise AssertionError("every cell is bytes")

    def _column(self, chunks: Iterable[pa.Array], kind: pa.DataType) -> pa.ChunkedArray:
        schema = pa.schema([("0", kind)])
        return self._mapped((pa.record_batch([chunk], schema=schema) for chunk in chunks), schema).column(0)

    def _mapped(self, batches: Iterable[pa.RecordBatch], schema: pa.Schema) -> pa.Table:
        self.count += 1
        path = self.folder / f"{self.count}.arrow"
        with open(path, "wb") as file, pa.ipc.new_stream(file, schema) as writer:
            for batch in batches:
                writer.write_batch(batch)
        with pa.memory_map(str(path)) as mapped:
            return pa.ipc.open_stream(mapped).read_all()


def _converted(cells: pa.Array, convert: dict[str, Any]) -> pa.Array:
    """Cells as pyarrow reads them in a text file of one column, of the type that fits all unless `convert` names one."""
    if not len(cells):
        return pa.array([], convert.get("column_types", {"0": pa.null()})["0"])
    text = _compute.binary_join_element_wise(b'"', _compute.replace_substring(cells, b'"', b'""'), b'"\n', b"")
    size = int(np.frombuffer(text.buffers()[1], np.int32)[len(text)])
    found = csv.read_csv(
        pa.BufferReader(text.buffers()[2].slice(0, size)),
        csv.ReadOptions(column_names=["0"], block_size=size + 1, use_threads=False),
        csv.ParseOptions(newlines_in_values=True),
        csv.ConvertOptions(**convert),
    ).column(0)
    return found.chunk(0) if found.num_chunks == 1 else found.combine_chunks()
