"""Damage to Parquet files by their own library: columns of other types, names and metadata."""

import io
import json

import numpy as np
import pyarrow as pa
from pyarrow import parquet as pq

from tests.fuzz.mutate import Rng, havoc, pick, tree

_NAMES = ("", "reward", "action", "observation_0", "\x1b[31m", "../x", "a/b", "x" * 300, "episode", "terminal", "legal_0", "\n")


def parquet(data: bytes, rng: Rng) -> bytes:
    """A Parquet file with one to three odd columns, or whose footer or bytes are damaged."""
    if rng.random() < 0.5:
        if rng.random() < 0.5:
            return havoc(data, rng)
        size = min(int.from_bytes(data[-8:-4], "little") + 8, len(data))
        return data[:-size] + havoc(data[-size:-8], rng, 4) + data[-8:]
    table = pq.read_table(io.BytesIO(data))
    for _ in range(int(rng.integers(1, 4))):
        rows, at = table.num_rows, int(rng.integers(max(table.num_columns, 1)))
        match int(rng.integers(6)):
            case 0 if table.num_columns > 1:
                table = table.remove_column(at)
            case 1:
                names = [*table.column_names]
                names[at] = pick(rng, (*_NAMES, pick(rng, names)))
                table = table.rename_columns(names)
            case 2:
                table = table.append_column(pick(rng, _NAMES), _column(rows, rng))
            case 3:
                table = table.set_column(at, table.column_names[at], _column(rows, rng))
            case 4:
                table = table.slice(0, int(pick(rng, (0, 1, rows // 2))))
            case _:
                about = dict(table.schema.metadata or {})
                try:
                    said = json.loads(about.get(b"deadreckon", b"{}"))
                except ValueError:
                    said = {}
                about[b"deadreckon"] = pick(rng, (json.dumps(tree(said, rng)).encode(), b"{", b"\xff", b"[]", b"[" * 9000))
                table = table.replace_schema_metadata(about)
    made = io.BytesIO()
    pq.write_table(table, made, store_schema=bool(rng.random() < 0.7))
    return made.getvalue()


def _column(rows: int, rng: Rng) -> pa.Array:
    kinds = (
        lambda: pa.array([None] * rows), lambda: pa.array([[1.0]] * rows), lambda: pa.array([{"a": 1}] * rows),
        lambda: pa.array(["\ud7ff\x1b[2J"] * rows), lambda: pa.array([b"\xff"] * rows), lambda: pa.array([True] * rows),
        lambda: pa.array([2**63 - 1] * rows), lambda: pa.array([2**64 - 1] * rows, pa.uint64()),
        lambda: pa.array(np.full(rows, np.inf)), lambda: pa.array(np.full(rows, np.nan)),
        lambda: pa.array([10**18] * rows, pa.timestamp("ns")), lambda: pa.array([10**16] * rows, pa.timestamp("s")),
        lambda: pa.array([1] * rows, pa.date32()), lambda: pa.array([1] * rows, pa.duration("s")),
        lambda: pa.array([1] * rows, pa.time64("ns")), lambda: pa.array([1] * rows, pa.decimal128(38, 30)),
        lambda: pa.array(["a", "b"] * rows)[:rows].dictionary_encode(), lambda: pa.array([[[1]]] * rows),
        lambda: pa.array(np.arange(rows, dtype=np.float16)), lambda: pa.array([[]] * rows, pa.list_(pa.float32())),
        lambda: pa.array([list(range(i % 3)) for i in range(rows)]), lambda: pa.array(["2020-13-45"] * rows),
    )  # fmt: skip
    return pick(rng, kinds)()
