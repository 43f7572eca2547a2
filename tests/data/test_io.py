import gzip
import json
import os
from pathlib import Path

import numpy as np
import pytest
from small_logs import images, make_log, same

from deadreckon.data import io
from deadreckon.data.folder import read_folder, write_folder
from deadreckon.data.hdf5 import write_hdf5
from deadreckon.data.io import convert, read
from deadreckon.errors import UserError


def test_folders_come_back_exactly_and_memory_mapped(variant, tmp_path):
    write_folder(variant, tmp_path / "log")
    again = read_folder(tmp_path / "log")
    assert again.fingerprint == variant.fingerprint
    assert isinstance(again.observations, np.memmap)
    assert not isinstance(read(tmp_path / "log").observations, np.memmap)
    with pytest.raises(UserError, match="exists already"):
        write_folder(variant, tmp_path / "log")
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == ["log"]


def test_folders_that_are_damaged(log, tmp_path):
    folder = tmp_path / "log"
    write_folder(log, folder)
    column = folder / "rewards.npy"
    whole = column.read_bytes()
    for size in (10, len(whole) - 4):
        column.write_bytes(whole[:size])
        with pytest.raises(UserError, match=r"rewards\.npy: cannot be read"):
            read_folder(folder)
    column.unlink()
    with pytest.raises(UserError, match=r"column file rewards\.npy is missing"):
        read_folder(folder)
    (folder / "log.json").write_text('{"deadreckon": 1, "columns": ["../secret"]}')
    with pytest.raises(UserError, match="is missing"):
        read_folder(folder)
    (folder / "log.json").write_text("{")
    with pytest.raises(UserError, match="not valid JSON"):
        read(folder)


@pytest.mark.parametrize("target", ["log.hdf5", "log.h5", "log.parquet", "log.npz", "log", "sub/log/", "minari:mine/maze-v0"])
def test_convert_to_everything_and_back(log, tmp_path, monkeypatch, target):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    write_hdf5(log, "source.hdf5")
    assert convert("source.hdf5", target).fingerprint == log.fingerprint
    assert read(target).fingerprint == log.fingerprint
    with pytest.raises(UserError, match="exists already"):
        convert("source.hdf5", target)
    convert("source.hdf5", target, force=True)
    same(log, convert(target, "back.hdf5"))
    assert read("back.hdf5", mmap=True).fingerprint == log.fingerprint
    assert not list(tmp_path.glob(".*"))


def test_csv_needs_no_header_of_ours(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    convert(tmp_path / "a.hdf5", tmp_path / "a.csv")
    np.testing.assert_array_equal(read(tmp_path / "a.csv").actions, log.actions)


def test_content_decides_not_the_name(log, tmp_path):
    write_hdf5(log, tmp_path / "log.csv")
    assert io.sniff(tmp_path / "log.csv") == "hdf5"
    assert read(tmp_path / "log.csv").fingerprint == log.fingerprint


def test_convert_refuses_what_would_lose_data(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="is the source itself"):
        convert(tmp_path / "a.hdf5", tmp_path / "a.hdf5", force=True)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("meow")
    with pytest.raises(UserError, match="holds no log, so it is not replaced"):
        convert(tmp_path / "a.hdf5", tmp_path / "photos", force=True)
    with pytest.raises(UserError, match=r"unknown ending .xlsx; known: .hdf5"):
        convert(tmp_path / "a.hdf5", tmp_path / "a.xlsx")
    write_hdf5(images(), tmp_path / "pictures.hdf5")
    (tmp_path / "b.csv").write_text("old")
    with pytest.raises(UserError, match="do not fit into CSV"):
        convert(tmp_path / "pictures.hdf5", tmp_path / "b.csv", force=True)
    assert (tmp_path / "b.csv").read_text() == "old"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no file"),
        (b"", "the file is empty"),
        (b"just a sentence\nand another", "not a log in a format that is read"),
        (bytes(range(256)), "not a log in a format that is read"),
        (b"\x1f\x8b\x08\x00garbage", "cannot be unpacked"),
        (gzip.compress(b"PAR1", mtime=0), "a gzipped parquet file; unpack it first"),
        (b"\x89HDF\r\n\x1a\n", "cannot be read as hdf5"),
        (b"PAR1", "cannot be read as Parquet"),
        (b"PK\x03\x04", "cannot be read as npz"),
        (b"\x80\x04", "cannot be read as a pickle"),
    ],
)
def test_files_that_are_no_logs(tmp_path, content, words):
    path = tmp_path / "log"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_do_not_fit(log, tmp_path):
    with pytest.raises(UserError, match="this folder holds no log"):
        read(tmp_path)
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="action names a column of a table, but this is hdf5"):
        read(tmp_path / "a.hdf5", action="a")
    convert(tmp_path / "a.hdf5", tmp_path / "a.npz")
    with pytest.raises(UserError, match="npz is not stored column by column, so it cannot be memory-mapped"):
        read(tmp_path / "a.npz", mmap=True)


def test_folders_that_cannot_be_written_leave_nothing_and_the_old_one_stays(log, tmp_path, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "save", full)
        with pytest.raises(UserError, match="cannot write .*No space left"):
            write_folder(log, tmp_path / "new" / "deep" / "log")
    assert not (tmp_path / "new").exists()

    folder = tmp_path / "log"
    write_folder(log, folder)
    rename = Path.rename
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", lambda self, to: full() if self.suffix == ".tmp" else rename(self, to))
        with pytest.raises(UserError, match="cannot write"):
            write_folder(make_log((2,)), folder, force=True)
    assert read_folder(folder).fingerprint == log.fingerprint
    write_folder(make_log((2,)), folder, force=True)
    assert len(read_folder(folder)) == 2
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == ["log"]


def test_folders_are_on_disk_before_they_appear(log, tmp_path, monkeypatch):
    synced, fsync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (synced.append((tmp_path / "log").exists()), fsync(handle)))
    write_folder(log, tmp_path / "log")
    assert synced == [False] * len(list((tmp_path / "log").iterdir()))


@pytest.mark.parametrize("columns", [3, None, [3], [["a"]], {"a": 1}])
def test_wrong_columns_in_a_folder(log, tmp_path, columns):
    write_folder(log, tmp_path / "log")
    header = tmp_path / "log" / "log.json"
    header.write_text(json.dumps({**json.loads(header.read_text()), "columns": columns}))
    with pytest.raises(UserError, match=r"log.json: its header is damaged \(no list of columns\)"):
        read(tmp_path / "log")


def test_convert_refuses_names_of_columns_before_it_makes_anything(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="action names a column of a table"):
        convert(tmp_path / "a.hdf5", tmp_path / "new" / "b.hdf5", action="a")
    assert not (tmp_path / "new").exists()


def test_a_horizon_is_for_files_that_do_not_say(log, tmp_path):
    write_folder(log, tmp_path / "log")
    with pytest.raises(UserError, match="folder says where episodes end"):
        read(tmp_path / "log", horizon=3)
