"""Columns and logs whose names come from outside: none writes elsewhere than it was asked to."""

import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet
from small_logs import make_log, same

from deadreckon.cli.main import main
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.npz import write_npz
from deadreckon.errors import UserError

HOSTILE = ["../x", "../victim/important", "ABSOLUTE", "a/b", "..", ".", "", "C:\\x", "nul\0", "two\nlines", "x" * 300]
TARGETS = ["log", "log.hdf5", "log.npz", "minari:mine/log-v0", "log.parquet", "log.csv"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with something beside it that must stay."""
    (tmp_path / "victim").mkdir()
    for name in ("important", "important.npy"):
        (tmp_path / "victim" / name).write_text("mine")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "work" / "minari"))
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def writer(target: str):
    from deadreckon.data.formats.io import _writer

    return lambda log: _writer(target)(log, target, False)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_of_a_column_writes_elsewhere(place, target, name):
    name = str(place / "victim" / "important") if name == "ABSOLUTE" else name
    column: dict[str, Any] = {name: np.arange(13.0)}
    log = make_log(**column)
    before = files(place)
    if Path(target).suffix in (".parquet", ".csv"):  # where a name is text and no path
        writer(target)(log)
        assert files(place).keys() - before.keys() == {str(place / "work" / target)}
        if target == "log.parquet":
            same(log, read(target))
    else:
        with pytest.raises(UserError, match="rename it") as told:
            writer(target)(log)
        assert f"{target}: column {repr(name)[:40]}" in str(told.value)
        assert files(place) == before
        assert not list(Path("minari").glob("*"))
    assert {path: files(place)[path] for path in before} == before


def hostile_file(kind: str, name: str) -> Path:
    """A log as others would write it, with a column of that name."""
    log, path = make_log(), Path(f"evil.{kind}")
    if kind == "npz":
        columns = {"observations": log.observations, "actions": log.actions, "rewards": log.rewards}
        np.savez(path, **columns, terminals=log.terminals, **{name: np.arange(13)})
    elif kind == "pkl":
        demonstration = {"observations": log.observations, "actions": log.actions, "rewards": log.rewards, name: np.arange(13)}
        path.write_bytes(pickle.dumps(demonstration))
    else:
        columns = {"observation": np.arange(13.0), "action": np.arange(13.0), "reward": np.ones(13), name: np.arange(13)}
        (parquet.write_table if kind == "parquet" else csv.write_csv)(pa.table(columns), path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("target", ["out", "out.hdf5", "out.npz"])
@pytest.mark.parametrize("kind", ["npz", "parquet", "csv", "pkl"])
def test_converting_a_strangers_log_writes_nowhere_else(place, kind, target, capsys):
    """In files of arrays a slash parts groups, and becomes an underscore; in a table it is part of a name, which is refused."""
    for name in ("../victim/important", str(place / "victim" / "important"), "a/b"):
        path = hostile_file(kind, name)
        before = files(place)
        if kind in ("npz", "pkl"):
            assert main(["data", "convert", str(path), target]) == 0
            assert name.replace("/", "_") in read(target).extras
            made = {file: held for file, held in files(place).items() if Path(file).is_relative_to(place / "work" / target)}
            assert made
            assert {file: held for file, held in files(place).items() if file not in made} == before
            shutil.rmtree(target) if target == "out" else Path(target).unlink()
        else:
            assert main(["data", "convert", str(path), target]) == 2
            [line] = capsys.readouterr().err.splitlines()
            assert f"{target}: column {repr(name)[:40]}" in line
            assert "would lead to another folder" in line
            assert files(place) == before


def test_npz_takes_names_that_numpy_would_take_for_its_own(place):
    log = make_log(file=np.arange(13.0), allow_pickle=np.arange(13.0))
    write_npz(log, "log.npz")
    same(log, read("log.npz"))
    with pytest.raises(UserError, match="column deadreckon has the name of the header"):
        write_npz(make_log(deadreckon=np.arange(13.0)), "other.npz")


def test_copies_of_two_columns_never_share_a_file(place):
    """Of a file too large for memory, columns that cannot be memory-mapped are copied; names alike but for a slash too."""
    import h5py

    log = make_log()
    with h5py.File("source.hdf5", "w") as file:
        for key in ("observations", "actions", "rewards", "terminals", "timeouts"):
            file[key] = getattr(log, key)
        for at, key in enumerate(("infos/a/b", "infos_a/b")):
            file.create_dataset(key, data=np.full(13, at), chunks=True)
    made = convert("source.hdf5", "out.hdf5")
    assert {key: column[0] for key, column in made.extras.items()} == {"a_b": 0, "infos_a_b": 1}
    with h5py.File("source.hdf5", "a") as file:
        file["infos_a_b"] = np.full(13, 2)
    with pytest.raises(UserError, match=r"^source.hdf5: two columns would be called infos_a_b, .*; rename one$"):
        read("source.hdf5")
