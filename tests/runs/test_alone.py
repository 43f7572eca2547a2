"""A run folder belongs to one process at a time, and a killed one's is free."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from deadreckon import read, train_together
from deadreckon.agents import BC
from deadreckon.cli.main import main
from deadreckon.errors import BusyError
from deadreckon.files import alone
from deadreckon.runs.folder import Folder
from deadreckon.runs.offline import judge


def small_csv(path):
    rng = np.random.default_rng(0)
    rows = [f"{i // 10},{rng.normal():.3f},{rng.uniform(-1, 1):.3f},{rng.normal():.3f}" for i in range(100)]
    path.write_text("\n".join(["episode,observation,action_0,reward", *rows]) + "\n")
    return path


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


def test_estimates_are_written_by_one_process_at_a_time(tmp_path):
    out = tmp_path / "estimates"
    with alone(out), pytest.raises(BusyError, match=f"at work on {out} already"):
        judge([], read(small_csv(tmp_path / "log.csv")), out=out)
    assert not out.exists()
