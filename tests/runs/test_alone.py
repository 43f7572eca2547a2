"""A run folder belongs to one process at a time, and a killed one's is free."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deadreckon import read, train_together
from deadreckon.agents import BC
from deadreckon.cli.main import main
from deadreckon.errors import BusyError, UserError
from deadreckon.files import alone
from deadreckon.runs.exported import building
from deadreckon.runs.folder import Folder
from deadreckon.runs.offline import judge


def small_csv(path):
    rng = np.random.default_rng(0)
    rows = [f"{i // 10},{rng.normal():.3f},{rng.uniform(-1, 1):.3f},{rng.normal():.3f}" for i in range(100)]
    path.write_text("\n".join(["episode,observation,action_0,reward", *rows]) + "\n")
    return path


@pytest.mark.slow
def test_two_commands_into_one_folder(tmp_path, capsys):
    log, out = small_csv(tmp_path / "log.csv"), tmp_path / "run"
    options = ["train", "--agent", "bc", "--agent.hidden", "16", "--data", str(log), "--out", str(out), "--steps", "100000000"]
    with subprocess.Popen([sys.executable, "-m", "deadreckon.cli.main", *options], stdout=subprocess.DEVNULL) as first:
        while not (out / "run.json").exists():
            assert first.poll() is None
            time.sleep(0.05)
        before = sorted(path.name for path in tmp_path.iterdir())
        assert main([*options, "--resume"]) == 2
        [line] = capsys.readouterr().err.splitlines()
        assert f"another process is at work on {out} already" in line
        assert sorted(path.name for path in tmp_path.iterdir()) == before
        first.send_signal(signal.SIGKILL)
    assert main(options) == 2
    *_, line = capsys.readouterr().err.splitlines()  # before it JAX may warn of a program that the kill left half in its cache
    assert f"{out} holds a run already" in line  # which is told by a process that has the folder for itself


@pytest.mark.parametrize("name", ["both", "both/a"])
def test_runs_side_by_side_are_locked_with_their_folders(tmp_path, name):
    with Folder(tmp_path / name).alone(), pytest.raises(BusyError, match=f"at work on .*{name} already"):
        train_together({"a": BC(), "b": BC()}, small_csv(tmp_path / "log.csv"), out=tmp_path / "both", steps=1)
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "home") == ["log.csv"]


def test_a_folder_is_one_by_whatever_path(tmp_path, monkeypatch):
    (tmp_path / "run").mkdir()
    (tmp_path / "link").symlink_to("run")
    monkeypatch.chdir(tmp_path / "run")
    for path in (tmp_path / "link", Path("."), Path("../link"), Path("../run")):
        with Folder(tmp_path / "run").alone(), pytest.raises(BusyError, match="at work on .* already"), Folder(path).alone():
            pass
    with pytest.raises(UserError, match="/ is the root of all folders; choose another --out"), Folder(Path("/")).alone():
        pass


def test_estimates_are_written_by_one_process_at_a_time(tmp_path):
    out = tmp_path / "estimates"
    with alone(out), pytest.raises(BusyError, match=f"at work on {out} already"):
        judge([], read(small_csv(tmp_path / "log.csv")), out=out)
    assert not out.exists()


@pytest.mark.parametrize(("words", "place"), [
    ("design designs.csv --target score --out out", "out"), ("data convert log.csv out.npz", "out.npz"),
    ("data convert log.csv out", "out"), ("theory cnml --out out", "out"), ("demo --out out", "out"),
    ("data collect maze2d-umaze-v1 --steps 10 --out out.hdf5", "out.hdf5"), ("recommend log.csv --out out", "out"),
    ("ope --data log.csv --policies run --out out", "out"),
])  # fmt: skip
def test_every_folder_is_written_by_one_command_at_a_time(words, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small_csv(tmp_path / "log.csv")
    (tmp_path / "designs.csv").write_text("a,b,score\n" + "".join(f"{i},{i * i % 7},{i % 5}\n" for i in range(20)))
    with alone(tmp_path / place):
        assert main(words.split()) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert f"another process is at work on {place}" in line or f"another process is at work on {tmp_path / place}" in line
    assert not (tmp_path / place).exists()


def test_exports_are_written_by_one_process_at_a_time(tmp_path):
    with alone(tmp_path / "out"), pytest.raises(BusyError, match="at work on .*out already"), building(tmp_path / "out"):
        pass
    with building(tmp_path / "out") as folder:
        (folder / "policy").touch()
    with pytest.raises(UserError, match="exists already"), building(tmp_path / "out"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "home") == ["out"]
