import socket

import numpy as np
import pytest
from small_logs import make_log

from deadreckon.cli import progress
from deadreckon.cli.data import Mapping, data, mapping_options
from deadreckon.cli.main import main
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.formats.io import read
from deadreckon.errors import UserError


@pytest.mark.parametrize("out", ["x.csv", "sub/x.parquet", "x", "x.npz"])
def test_logs_are_collected_into_hdf5_alone(tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=rf"^--out {out}: .* then `deadreckon data convert (sub/)?x.hdf5 {out}`$"):
        data(["collect", "maze2d-umaze-v1", "--steps", "10", "--out", out])
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == []


def test_the_mapping_of_a_table(tmp_path, capsys):
    path = tmp_path / "clicks.csv"
    path.write_text("when,u_0,u_1,id,arm,click\n2026-01-01,1,2,a,x,1\n2026-01-02,3,4,b,y,0\n")
    data(["info", str(path), "--action", "arm", "--reward", "click", "--ignore", "id"])
    shown = capsys.readouterr().out
    assert "observations  (2,)" in shown
    assert "! timestamps are left out of the observations: when" in shown
    data(["info", str(path), "--action", "arm", "--reward", "click", "--observations", "u", "id"])
    assert "observations  (4,)" in capsys.readouterr().out
    assert mapping_options(Mapping(reward="r", ignore=("id",))) == {"reward": "r", "ignore": ("id",)}


def test_a_horizon(tmp_path, capsys):
    log = make_log((12,), terminal=(True,))
    write_hdf5(log, tmp_path / "log.hdf5")
    plain = tmp_path / "plain.npz"
    np.savez(plain, observations=log.observations, actions=log.actions, rewards=log.rewards, terminals=log.terminals)
    data(["info", str(plain)])
    assert "time limits that are not marked would be crossed" in capsys.readouterr().out
    data(["info", str(plain), "--horizon", "4"])
    assert "12 in 3 episodes" in capsys.readouterr().out
    data(["convert", str(plain), str(tmp_path / "cut.hdf5"), "--horizon", "4"])
    assert read(tmp_path / "cut.hdf5").lengths.tolist() == [4, 4, 4]
    assert "2 of 12 rows are left out" in capsys.readouterr().err


@pytest.mark.parametrize("source", ["d4rl", "minari"])
def test_a_server_that_is_gone_names_the_recipe_that_always_works(monkeypatch, capsys, home, source):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("no_proxy", "127.0.0.1")
        monkeypatch.setenv(f"DEADRECKON_{source.upper()}_URL", f"http://127.0.0.1:{free.getsockname()[1]}")
        assert main(["data", "get", "hopper-medium-v2", "--source", source]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("deadreckon: http://127.0.0.1:")
    assert err.endswith(": connection refused; `deadreckon data collect hopper-medium-v2` makes it here\n")
    assert not (home / "data").exists()


def test_progress_in_bytes(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.Bar("downloading x", None, "bytes") as bar:
        for done, total in ((1_000_000, None), (9_000_000, None), (17_000_000, 34_000_000), (34_000_000, 34_000_000)):
            bar(done, total)
            now[0] += 20.0
    assert capsys.readouterr().err.splitlines() == [
        "downloading x: 9.0 MB, 0.4 MB/s",
        "downloading x: 17.0 MB of 34.0 MB, 0.4 MB/s, 42 s left",
        "downloading x: 34.0 MB of 34.0 MB, 0.6 MB/s",
    ]
