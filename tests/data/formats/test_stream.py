"""Tables converted part by part: the log of the reader in memory, after a kill too, and in little memory."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet

from deadreckon.cli.main import main
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats import stream
from deadreckon.data.formats.build import arrays_of
from deadreckon.data.formats.folder import read_folder
from deadreckon.data.formats.io import convert, read
from deadreckon.data.frame import _order
from deadreckon.errors import UserError


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(stream, "_PART", 50)


def the_table(rows: int = 300, seed: int = 0) -> pa.Table:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=rows)
    y = [None if value < 0.1 else value for value in rng.random(rows)]
    return pa.table({
        "user": np.sort(rng.integers(0, 30, rows)), "step": rng.permutation(rows), "x": x, "y": pa.array(y, pa.float64()),
        "kind": pa.array(rng.choice(["b", "a", "c"], rows)), "count": rng.integers(0, 9, rows),
        "day": pa.array(rng.integers(0, 10**9, rows), pa.timestamp("s")), "next_x": rng.normal(size=rows),
        "a": rng.choice(["left", "right"], rows), "force": rng.normal(size=rows), "r": rng.normal(size=rows),
        "p": rng.uniform(0.1, 1, rows), "end": rng.random(rows) < 0.1,
    })  # fmt: skip


ASKED: dict[str, dict[str, Any]] = {
    "bandit": {"action": "a", "reward": "r", "observations": ("x", "y", "kind"), "propensity": "p"},
    "unsorted": {"action": "a", "reward": "r", "observations": ("x", "y", "kind"), "episode": "user", "time": "step"},
    "dates": {"action": "force", "reward": "r", "observations": ("x", "count"), "episode": "user", "time": "day"},
    "stream": {"action": "a", "reward": "r", "observations": ("y", "kind"), "terminal": "end", "keep": ("count", "kind")},
    "next": {"action": ("force", "p"), "reward": "r", "observations": ("x",), "next_observations": ("next_x",)},
    "groups": {"action": "a", "reward": "r", "observations": ("x",), "group": "user", "cost": ("p",), "kinds": {"x": "number"}},
    "names": {"action": "a", "reward": "r"},
}


def same(streamed: Dataset, whole: Dataset) -> None:
    assert arrays_of(streamed).keys() == arrays_of(whole).keys()
    for key, column in arrays_of(whole).items():
        found = arrays_of(streamed)[key]
        assert found.dtype == column.dtype, key
        np.testing.assert_array_equal(found, column, key)
    assert streamed.action_space == whole.action_space
    assert streamed.provenance.extra == whole.provenance.extra


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_streamed_log_is_the_one_in_memory(tmp_path, asked):
    table = the_table()
    parquet.write_table(table, tmp_path / "log.parquet", row_group_size=40)
    told = convert(tmp_path / "log.parquet", tmp_path / "log", **asked)
    whole = Dataset.from_frame(table, **asked)
    same(read_folder(tmp_path / "log"), whole)
    assert [line for line in told.warnings if "horizon" not in line] == list(whole.warnings)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "log.parquet"]


def test_files_of_a_folder_are_in_the_order_of_the_numbers_in_their_names(tmp_path):
    (tmp_path / "parts").mkdir()
    for i in range(12):
        rows = {"x": [2.0 * i, 2.0 * i + 1], "action": [0, 1], "reward": [1.0, 0.0], "timeout": [False, i == 11]}
        parquet.write_table(pa.table(rows), tmp_path / "parts" / f"part.{i}.parquet")
    log = convert(tmp_path / "parts", tmp_path / "log", timeout="timeout", action="action", reward="reward")
    np.testing.assert_array_equal(log.observations[:, 0], np.arange(24))


def test_partitioned_folder_and_arrow(tmp_path):
    table = the_table()
    parquet.write_to_dataset(table, tmp_path / "parts", partition_cols=["kind"])
    feather.write_feather(table, tmp_path / "log.arrow", chunksize=40)
    asked = ASKED["bandit"]
    convert(tmp_path / "parts", tmp_path / "a", **asked)
    convert(tmp_path / "log.arrow", tmp_path / "b", **asked)
    same(read_folder(tmp_path / "a"), Dataset.from_frame(parquet.read_table(tmp_path / "parts"), **asked))
    same(read_folder(tmp_path / "b"), Dataset.from_frame(table, **asked))


def test_files_with_other_columns_and_types(tmp_path):
    (tmp_path / "parts").mkdir()
    first = the_table(90).set_column(2, "x", pa.array(np.arange(90)))
    late = the_table(60, seed=1).append_column("late", pa.array(np.arange(60.0))).drop_columns(["kind"])
    parquet.write_table(first, tmp_path / "parts" / "0.parquet", row_group_size=40)
    parquet.write_table(late, tmp_path / "parts" / "1.parquet", row_group_size=40)
    asked = ASKED["bandit"] | {"observations": ("x", "y", "kind", "late")}
    told = convert(tmp_path / "parts", tmp_path / "log", **asked)
    whole = pa.concat_tables([first, late], promote_options="permissive")
    same(read_folder(tmp_path / "log"), Dataset.from_frame(whole, **asked))
    for name, file in (("late", "0"), ("kind", "1")):
        line = f"column {name} is missing in 1 of 2 files, such as {file}.parquet, and its cells are empty there"
        assert line in told.warnings
    parquet.write_table(late.set_column(2, "x", pa.array(["a"] * 60)), tmp_path / "parts" / "1.parquet")
    with pytest.raises(UserError, match="its files hold different types in a column .*x"):
        convert(tmp_path / "parts", tmp_path / "no", **asked)


def test_a_table_of_our_names(tmp_path):
    rng = np.random.default_rng(0)
    table = pa.table({"observation_0": rng.normal(size=200), "observation_1": rng.normal(size=200),
                      "action_0": rng.normal(size=200), "reward": rng.normal(size=200),
                      "terminals": np.arange(200) % 20 == 19})  # fmt: skip
    parquet.write_table(table, tmp_path / "log.parquet", row_group_size=40)
    convert(tmp_path / "log.parquet", tmp_path / "streamed")
    convert(tmp_path / "log.parquet", tmp_path / "whole.npz")
    same(read_folder(tmp_path / "streamed"), read(tmp_path / "whole.npz"))


def test_a_refused_table_leaves_nothing(tmp_path):
    table = the_table().set_column(2, "x", pa.array([None] * 300, pa.float64()))
    parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(UserError, match="column x is empty"):
        convert(tmp_path / "log.parquet", tmp_path / "log", **ASKED["bandit"])
    (tmp_path / "broken.parquet").write_bytes((tmp_path / "log.parquet").read_bytes()[:-50])
    with pytest.raises(UserError, match="broken.parquet"):
        convert(tmp_path / "broken.parquet", tmp_path / "log", **ASKED["bandit"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.parquet", "log.parquet"]


@pytest.mark.parametrize("swapped", [False, True])
def test_rows_in_order_are_not_sorted_again(monkeypatch, swapped):
    monkeypatch.setattr("deadreckon.data.frame.BLOCK", 7)
    codes, moments = np.repeat(np.arange(10), 5), np.tile(np.arange(5.0), 10) + np.repeat(np.arange(10), 5) // 3
    if swapped:
        moments[[34, 35]] = moments[[34, 35]][::-1] - 9  # at the edge of two blocks
    order, _ = _order(50, codes, moments)
    first = np.array([moments[codes == code].min() for code in range(10)])
    assert isinstance(order, slice) is not swapped
    np.testing.assert_array_equal(np.arange(50)[order], np.lexsort((moments, codes, first[codes])))


KILLED = """
import os, signal, sys
from deadreckon.data.formats import stream
from deadreckon.data.formats.io import convert

stream._PART = 50
convert(sys.argv[1], sys.argv[2], action="a", reward="r", observations=("x", "y", "kind"), propensity="p",
        progress=lambda done, rows: done >= 100 and os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.slow
def test_goes_on_after_a_kill(tmp_path, monkeypatch):
    source = tmp_path / "log.parquet"
    parquet.write_table(the_table(), source, row_group_size=25)
    killed = subprocess.run([sys.executable, "-c", KILLED, source, tmp_path / "log"])
    assert killed.returncode == -signal.SIGKILL
    assert not (tmp_path / "log").exists()
    read: list[int] = []
    batches = stream._batches
    monkeypatch.setattr(stream, "_batches", lambda *given: read.append(1) or batches(*given))
    told: list[tuple[int, int | None]] = []
    convert(source, tmp_path / "log", progress=lambda *done: told.append(done), **ASKED["bandit"])
    assert len(read) == 4  # of six parts of 50 rows two were there
    assert told == [(done, 300) for done in range(50, 301, 50)]
    same(read_folder(tmp_path / "log"), Dataset.from_frame(the_table(), **ASKED["bandit"]))


@pytest.mark.slow
def test_parts_of_another_source_are_not_taken(tmp_path):
    source = tmp_path / "log.parquet"
    parquet.write_table(the_table(), source, row_group_size=25)
    subprocess.run([sys.executable, "-c", KILLED, source, tmp_path / "log"])
    parquet.write_table(the_table(seed=1), source, row_group_size=25)
    convert(source, tmp_path / "log", **ASKED["bandit"])
    same(read_folder(tmp_path / "log"), Dataset.from_frame(the_table(seed=1), **ASKED["bandit"]))


def test_tables_that_are_large_for_the_memory_are_told(tmp_path, monkeypatch, capsys):
    parquet.write_table(the_table(), tmp_path / "log.parquet")
    words = ["data", "info", str(tmp_path / "log.parquet"), "--action", "a", "--reward", "r"]
    assert main(words) == 0
    assert "data convert" not in capsys.readouterr().err
    monkeypatch.setattr(stream, "SHARE", 1e-9)
    assert main(words) == 0
    told = f"! {tmp_path / 'log.parquet'} holds 0.0 GB, more than 0% of the memory: `deadreckon data convert"
    assert told in capsys.readouterr().err
    parquet.write_table(the_table(), tmp_path / "a log.parquet")
    line = stream.advice(tmp_path / "a log.parquet")
    assert f"`deadreckon data convert '{tmp_path / 'a log.parquet'}' FOLDER`" in str(line)
    convert(tmp_path / "log.parquet", tmp_path / "log", action="a", reward="r")
    assert main(["data", "info", str(tmp_path / "log")]) == 0
    assert "data convert" not in capsys.readouterr().err


BOUND = """
import sys, threading, time
from pathlib import Path
from deadreckon.data.formats.io import convert
import pyarrow.dataset, deadreckon.data.formats.stream

def anonymous():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("RssAnon"))

before, peak, running = anonymous(), 0, True
def watch():
    global peak
    while running:
        peak = max(peak, anonymous())
        time.sleep(0.005)
thread = threading.Thread(target=watch)
thread.start()
convert(sys.argv[1], sys.argv[2], action="a", reward="r", episode="e", time="t")
running = False
thread.join()
print(peak - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="measured by Linux")
def test_memory_is_bounded(tmp_path):
    rows, rng = 2_000_000, np.random.default_rng(0)
    columns = {f"x{index}": rng.normal(size=rows) for index in range(40)}
    table = pa.table({**columns, "a": rng.normal(size=rows), "r": rng.normal(size=rows), "e": np.arange(rows) // 1000,
                      "t": np.arange(rows) % 1000})  # fmt: skip
    size = table.nbytes
    parquet.write_table(table, tmp_path / "log.parquet", row_group_size=100_000)
    del table, columns
    command = [sys.executable, "-c", BOUND, tmp_path / "log.parquet", tmp_path / "log"]
    told = subprocess.run(command, capture_output=True, text=True)
    assert int(told.stdout) < 0.6 * size, told


def test_levels_of_a_schema_that_look_like_dates_stay_texts(tmp_path):
    days = ["03.04.2024", "04.04.2024"]
    table = pa.table({"day": days * 100, "x": np.arange(200.0), "a": [0, 1] * 100, "r": np.ones(200)})
    columns = {"day": {"role": "observation", "kind": "category", "levels": days}, "x": {"role": "observation"},
               "a": {"role": "action", "kind": "integer"}, "r": {"role": "reward"}}  # fmt: skip
    parquet.write_table(table, tmp_path / "log.parquet", row_group_size=40)
    feather.write_feather(table, tmp_path / "log.arrow", chunksize=40)
    convert(tmp_path / "log.parquet", tmp_path / "log.npz", schema={"columns": columns})
    for source in ("log.parquet", "log.arrow"):
        streamed = convert(tmp_path / source, tmp_path / "log", schema={"columns": columns}, force=True)
        same(streamed, read(tmp_path / "log.npz"))
        schema = {"columns": columns, "table": {"sheet": "one", "separator": ";"}}
        with pytest.raises(UserError, match="--sheet is for a spreadsheet, but this is Parquet"):
            convert(tmp_path / source, tmp_path / "log", schema=schema, force=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "log.arrow", "log.npz", "log.parquet"]
