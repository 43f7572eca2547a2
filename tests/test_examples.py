"""The declared runs of docs/results, on a short setting."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_maze2d_table_runs_and_resumes(tmp_path, home):
    options = {"steps": 20, "seeds": 2, "episodes": 2, "log-steps": 4000, "maze": "eval-umaze", "out": tmp_path / "runs"}
    command = [sys.executable, str(ROOT / "examples" / "maze2d_table.py"), "--hidden", "16", "16"]
    command += [str(word) for name, value in options.items() for word in (f"--{name}", value)]
    first = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert "BEAR" in first.stdout
    assert (tmp_path / "runs" / "report.html").exists()
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert again.stdout == first.stdout
