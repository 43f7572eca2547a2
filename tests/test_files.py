"""Locks: one process at a time, and whoever waits says so."""

import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest

from deadreckon.errors import BusyError, UserError, cannot_write
from deadreckon.files import alone, read_json, replacing, write_json


def test_who_waits_for_another_process_says_so_once_and_goes_on_after_it(tmp_path, monkeypatch):
    path, began, said, order = tmp_path / "made" / "it", threading.Event(), threading.Event(), []

    def other():
        with alone(path):
            began.set()
            assert said.wait(60)
            time.sleep(0.5)  # the lock is tried for again, twice or so
            order.append("other")

    def warn(*text, warn=warnings.warn, **options):
        warn(*text, **options)
        said.set()

    monkeypatch.setattr(warnings, "warn", warn)
    thread = threading.Thread(target=other)
    thread.start()
    began.wait()
    with pytest.raises(BusyError, match="another process is at work on .* already"), alone(path):
        pass
    with pytest.warns(UserWarning, match="another process bakes it: waiting for it") as told, alone(path, "bakes it"):
        order.append("we")
    thread.join()
    assert order == ["other", "we"]
    assert len(told) == 1


HOLD = """
import sys, time
from pathlib import Path
from deadreckon.files import alone, read_json, replacing, write_json
with alone(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_another_process_is_refused_and_the_lock_of_a_killed_one_is_free(tmp_path):
    path = tmp_path / "made" / "it"
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        words = r"^another process is at work on the cake already: .*\.it\.lock is locked$"
        with pytest.raises(BusyError, match=words), alone(path, what="the cake"):
            pass
        other.send_signal(signal.SIGKILL)
    assert (path.parent / ".it.lock").exists()  # what a killed process leaves
    with alone(path):
        assert path.parent.exists()
    assert not list(path.parent.iterdir())


@pytest.mark.filterwarnings("ignore:another process is at it")
def test_many_threads_are_there_one_at_a_time(tmp_path):
    """Also where the one before removes file and folder of the lock while others open them."""
    path, inside, worst = tmp_path / "made" / "it", [], []

    def work():
        for _ in range(5):
            with alone(path, "is at it"):
                inside.append(None)
                worst.append(len(inside))
                time.sleep(0.002)
                inside.pop()

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert worst == [1] * 20
    assert not list(tmp_path.rglob("*.lock"))


def test_a_folder_that_is_removed_while_it_is_made_is_made_again(tmp_path, monkeypatch):
    """`Path.mkdir` reports that a folder exists if it is removed between the attempt and the look at what is there."""
    make, calls = Path.mkdir, []

    def late(self, *given, **options):
        calls.append(self)
        if len(calls) == 1:
            raise FileExistsError(17, "File exists", str(self))
        return make(self, *given, **options)

    monkeypatch.setattr(Path, "mkdir", late)
    with alone(tmp_path / "made" / "it"):
        assert (tmp_path / "made").is_dir()
    assert len(calls) > 1


@pytest.mark.parametrize("kind", ["file", "link to nothing"])
def test_no_lock_is_made_below_what_is_no_folder(kind, tmp_path):
    if kind == "file":
        (tmp_path / "made").write_text("")
    else:
        (tmp_path / "made").symlink_to(tmp_path / "nothing")
    with pytest.raises(UserError, match=r"^cannot write .*it: File exists$"), alone(tmp_path / "made" / "it"):
        pass


@pytest.mark.parametrize("path", ["x" * 300, "a" * 300 + "/log", "/".join(["long"] * 2000), "zero\0byte", "half\ud800"])
def test_what_can_be_no_path_is_refused_in_one_line(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="^cannot write "):
        write_json(path, {})
    with pytest.raises(UserError, match="^cannot write "), alone(tmp_path / path):
        pass
    assert not list(tmp_path.iterdir())


def test_a_text_that_no_encoding_has_leaves_nothing_half_written(tmp_path):
    write_json(tmp_path / "kept.json", 1)
    with pytest.raises(UserError, match="holds half a character"), replacing(tmp_path / "kept.json") as temporary:
        temporary.write_text("a column called \ud800", encoding="utf-8")
    assert read_json(tmp_path / "kept.json") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["kept.json"]


def test_what_numpy_says_of_a_full_disk_is_told_as_such():
    short = OSError("4800 requested and 3040 written")  # of numpy.save: without a number
    assert str(cannot_write("x", short)) == "cannot write x: 4800 requested and 3040 written, the disk may be full"
    assert str(cannot_write("x", OSError(28, "No space left on device"))) == "cannot write x: No space left on device"
