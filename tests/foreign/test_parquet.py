"""What a Parquet file unpacks to is counted before it is read, by whatever reads one."""

import os

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.bench.store import Store
from deadreckon.data.formats.stream import convert_table, streamed_format
from deadreckon.errors import UserError
from deadreckon.foreign.parquet import check_parquet, read_parquet
from deadreckon.runs.folder import Folder
from tests.data.formats.any_file import read_table

FEW = "unpacks to .* DEADRECKON_MAX_UNPACKED"
LONG = "a" * 10_000


def written(path, **columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pa.table(columns), path, compression="zstd", dictionary_pagesize_limit=1 << 24)
    return path


@pytest.mark.parametrize(
    ("values", "size"),
    [
        (pa.array([LONG] * 1_000), 10_000_000),
        (pa.array([LONG] * 1_000, pa.large_string()), 10_000_000),
        (pa.array([LONG.encode()] * 1_000), 10_000_000),
        (pa.array([[LONG, "b"]] * 1_000), 10_000_000),
        (pa.array([{"a": LONG, "b": 1}] * 1_000), 10_000_000),
        (pa.array([[("a", LONG)]] * 1_000, pa.map_(pa.string(), pa.string())), 10_000_000),
        (pa.array([LONG.encode()] * 1_000, pa.binary(10_000)), 10_000_000),
        (pa.array(np.zeros(1_000_000)), 8_000_000),
        (pa.array([np.zeros(100_000)] * 10), 8_000_000),
        (pa.array(np.arange(1_000) % 7), 8_000),
        (pa.array(["a", None] * 500), 8_000),
    ],
    ids=["texts", "large", "bytes", "lists", "structs", "maps", "fixed", "numbers", "long lists", "few", "short"],
)
def test_what_repeats_is_counted_as_often_as_it_is_there(tmp_path, monkeypatch, values, size):
    path = written(tmp_path / "x.parquet", x=values)
    if size > 8_000:
        assert path.stat().st_size < size / 40
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", str(int(0.9 * size)))
    with pytest.raises(UserError, match=FEW):
        check_parquet(path)
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", str(int(2.5 * size)))
    assert read_parquet(path)["x"].to_pylist() == values.to_pylist()


def test_every_reader_counts(tmp_path, monkeypatch):
    step = np.zeros(1_000_000, np.int64)
    part = written(tmp_path / "metrics" / "0000000010.parquet", step=step, seed=step)
    written(tmp_path / "results" / "job.parquet", cell=[LONG] * 1_000)
    written(tmp_path / "log.parquet", mode=[LONG] * 1_000, reward=np.zeros(1_000))
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "5M")
    for read in (Folder(tmp_path).table, read_table):
        with pytest.raises(UserError, match=FEW):
            read("metrics" if read is not read_table else tmp_path / "log.parquet")
    with pytest.raises(UserError, match=FEW):
        Store(tmp_path).results()
    with pytest.raises(UserError, match=FEW):
        convert_table(tmp_path / "log.parquet", tmp_path / "out", "parquet")
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "12M")
    check_parquet(part, whole=False)  # what goes to the disk part by part may be larger
    with pytest.raises(UserError, match=FEW):
        check_parquet(part)


def test_nobody_waits_for_a_pipe(tmp_path):
    for folder in ("log", "results", "metrics"):
        (tmp_path / folder).mkdir()
        os.mkfifo(tmp_path / folder / "x.parquet")
    for read in (lambda: streamed_format(tmp_path / "log"), Store(tmp_path).results, lambda: Folder(tmp_path).table("metrics")):
        with pytest.raises(UserError, match=r"x\.parquet is a named pipe, and a file is needed"):
            read()


def test_columns_of_one_name_are_refused(tmp_path):
    parquet.write_table(pa.Table.from_arrays([pa.array([1]), pa.array([2])], names=["x", "x"]), tmp_path / "x.parquet")
    with pytest.raises(UserError, match=r"x\.parquet: two of its columns are called 'x'"):
        read_parquet(tmp_path / "x.parquet")


@pytest.mark.parametrize("encoding", ["DELTA_BYTE_ARRAY", "DELTA_LENGTH_BYTE_ARRAY"])
def test_texts_in_delta_encodings_are_read_and_counted(tmp_path, monkeypatch, encoding):
    """Which other writers choose; their pages hold no dictionary."""
    table = pa.table({"text": [f"{'same' * 50}{i}" for i in range(5_000)], "number": list(range(5_000))})
    path = tmp_path / "x.parquet"
    parquet.write_table(table, path, use_dictionary=False, column_encoding={"text": encoding, "number": "PLAIN"})
    assert read_parquet(path).equals(table)
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "500k")
    with pytest.raises(UserError, match="unpacks to"):
        read_parquet(path)
