"""Locks: one process at a time, and whoever waits says so. Names from outside: none leads out of its folder."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from deadreckon.errors import BusyError, UserError
from deadreckon.files import LONGEST, alone, file_part, safe_name


def test_who_waits_for_another_process_says_so_once_and_goes_on_after_it(tmp_path):
    path, began, order = tmp_path / "made" / "it", threading.Event(), []

    def other():
        with alone(path):
            began.set()
            time.sleep(0.5)
            order.append("other")

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
from deadreckon.files import alone
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


@pytest.mark.parametrize("name", ["speed", "a b", "é", ".hidden", "x..y", "maze2d-umaze-v1@dr1", "a" * LONGEST])
def test_plain_names_are_names_of_files(name):
    assert safe_name(name, "column") == file_part(name) == name


HOSTILE = {
    "": "is empty", ".": "another folder", "..": "another folder", "../x": "another folder", "/abs/x": "another folder",
    "a/b": "another folder", "a/": "another folder", "C:\\x": "another folder", "C:x": "another folder",
    "..\\x": "another folder", "nul\0": "control characters", "two\nlines": "control characters",
    "\ud800": "control characters", "é" * 101: "longer than 200 bytes",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_names_that_lead_elsewhere_are_refused_or_made_plain(name):
    with pytest.raises(UserError, match=f"^column '.*{HOSTILE[name]}, so no file can be called that; rename it$") as told:
        safe_name(name, "column")
    assert len(str(told.value)) < 200
    assert str(told.value).isprintable()
    made = file_part(name)
    assert safe_name(made, "folder") == made != name


def test_a_name_made_plain_can_still_be_read():
    assert file_part("mujoco/hopper/medium-v0") == "mujoco-hopper-medium-v0"
    assert file_part("bc-x/../../../RUN") == "bc-x-..-..-..-RUN"
    assert file_part("é" * 150) == "é" * 100
