"""What a record batch of an Arrow file unpacks to is asked before it is read."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.data.formats.stream import convert_table
from deadreckon.errors import UserError
from deadreckon.foreign.arrow import check_arrow

ROLES = {"action": "dose", "reward": "gain", "episode": "episode"}


def written(path, compression, rows=100_000):
    zeros = np.zeros(rows)
    table = pa.table({"episode": np.arange(rows) // 10, "x": zeros, "dose": zeros, "gain": zeros})
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=rows // 2)
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4", None])
def test_a_batch_that_unpacks_to_more_than_it_may_is_refused(tmp_path, monkeypatch, compression):
    path = written(tmp_path / "x.arrow", compression)
    assert compression is None or path.stat().st_size < 3_200_000 / 2
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "1500k")  # a batch of the two has 1.6 MB
    with pytest.raises(UserError, match=r"x.arrow: has a record batch that unpacks to 0.0016 GB, .* DEADRECKON_MAX_UNPACKED"):
        convert_table(path, tmp_path / "log", "ipc", **ROLES)
    assert [each.name for each in tmp_path.iterdir()] == ["x.arrow"]
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "1700k")
    assert len(convert_table(path, tmp_path / "log", "ipc", **ROLES).rewards) == 100_000


def test_what_is_unpacked_is_counted_and_not_what_rows_refer_to(tmp_path, monkeypatch):
    table = pa.table({"x": pa.array(["a" * 50] * 40_000, pa.string_view())}).slice(0, 40_000)
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.OSFile(str(tmp_path / "x"), "wb") as file, pa.ipc.new_file(file, table.schema, options=options) as writer:
        writer.write_table(table)
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "2M")
    with pytest.raises(UserError, match="has a record batch that unpacks to 0.00264 GB"):
        check_arrow(tmp_path / "x")
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "3M")
    check_arrow(tmp_path / "x")


def test_a_damaged_file_is_refused_in_one_line(tmp_path):
    path = written(tmp_path / "x.arrow", "zstd", 1_000)
    data = bytearray(path.read_bytes())
    data[len(data) // 4 : len(data) // 2] = bytes(len(data) // 2 - len(data) // 4)
    path.write_bytes(data)
    with pytest.raises(UserError, match=r"x\.arrow") as told:
        convert_table(path, tmp_path / "log", "ipc", **ROLES)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("kind", ["ipc", "parquet"])
def test_two_columns_of_one_name_are_named_as_such(tmp_path, kind):
    path, table = tmp_path / "x", pa.table([[1.0], [2.0]], names=["x", "x"])
    if kind == "parquet":
        parquet.write_table(table, path)
    else:
        with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
            writer.write_table(table)
    with pytest.raises(UserError, match="two of its columns have one name"):
        convert_table(path, tmp_path / "log", kind, **ROLES)
