"""Temporary files of processes that live stay, those of dead ones go, and what was put aside comes back."""

import os
import subprocess
import sys
import time

import pytest

from deadreckon import temporaries
from deadreckon.files import replacing
from deadreckon.temporaries import SUFFIX, beside, clear, put, recover


@pytest.fixture(autouse=True)
def _not_cleared(monkeypatch):
    monkeypatch.setattr(temporaries, "_cleared", set())


WRITER = """
import sys, time
from pathlib import Path
from deadreckon.temporaries import beside
with beside(Path(sys.argv[1])) as file, beside(Path(sys.argv[2]), folder=True) as folder:
    (folder / "part").write_text("half")
    print(file, folder, flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_leaves_is_removed_by_the_next_writer_and_what_a_living_one_writes_is_not(tmp_path):
    words = [sys.executable, "-c", WRITER, str(tmp_path / "a.txt"), str(tmp_path / "b")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        made = process.stdout.readline().split()
        clear(tmp_path)
        assert all(os.path.exists(path) for path in made)
        process.kill()
    with replacing(tmp_path / "c.txt") as temporary:  # looked through already: once in the life of a process
        temporary.write_text("whole")
    assert all(os.path.exists(path) for path in made)
    temporaries._cleared.clear()
    with replacing(tmp_path / "c.txt") as temporary:
        temporary.write_text("whole")
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == ["c.txt"]


def test_files_of_other_programs_and_links_stay(tmp_path):
    (tmp_path / ".a.txt.12345678.tmp").write_text("of another program")
    (tmp_path / f"seen{SUFFIX}").write_text("not hidden")
    (tmp_path / "precious").write_text("kept")
    (tmp_path / f".link{SUFFIX}").symlink_to(tmp_path / "precious")
    clear(tmp_path)
    assert len([path for path in tmp_path.iterdir() if path.name != "home"]) == 4
    assert (tmp_path / "precious").read_text() == "kept"


def test_what_was_put_aside_by_a_killed_process_comes_back(tmp_path, monkeypatch):
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "old").touch()
    (tmp_path / "log").rename(tmp_path / ".log.old")  # as far as a kill came
    recover(tmp_path / "log")
    assert (tmp_path / "log" / "old").exists()
    with beside(tmp_path / "log", folder=True) as new:
        (new / "new").touch()
        put(new, tmp_path / "log")
    assert [path.name for path in (tmp_path / "log").iterdir()] == ["new"]
    assert not (tmp_path / ".log.old").exists()
    recover(tmp_path / "log")
    assert [path.name for path in (tmp_path / "log").iterdir()] == ["new"]


def test_many_writers_beside_each_other_lose_nothing(tmp_path):
    # Each removes what it takes for dead while others make theirs: one that was taken between its making and its lock is made
    # again.
    code = """
import sys
from pathlib import Path
from deadreckon import temporaries
from deadreckon.files import replacing
for i in range(60):
    temporaries._cleared.clear()
    with replacing(Path(sys.argv[1]) / f"{sys.argv[2]}-{i}") as file:
        file.write_text("whole")
"""
    began = time.monotonic()
    writers = [subprocess.Popen([sys.executable, "-c", code, str(tmp_path), str(k)]) for k in range(3)]
    assert [writer.wait() for writer in writers] == [0, 0, 0], f"after {time.monotonic() - began:.1f} s"
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "home") == sorted(
        f"{k}-{i}" for k in range(3) for i in range(60)
    )
