import json
import os
from pathlib import Path

import numpy as np
import pytest
from small_logs import make_log

from deadreckon.data.formats.folder import read_folder, write_folder
from deadreckon.data.formats.io import read
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
        with pytest.raises(UserError, match=r"rewards\.npy (is cut short|has a header)"):
            read_folder(folder)
    column.unlink()
    with pytest.raises(UserError, match=r"column file rewards\.npy is missing"):
        read_folder(folder)
    header = json.loads((folder / "log.json").read_text())
    (folder / "log.json").write_text(json.dumps({**header, "columns": ["../secret"]}))
    with pytest.raises(UserError, match="is missing"):
        read_folder(folder)
    (folder / "log.json").write_text("{")
    with pytest.raises(UserError, match="not valid JSON"):
        read(folder)


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
