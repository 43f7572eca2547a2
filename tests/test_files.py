"""Locks: one process at a time, and whoever waits says so. Names from outside: none leads out of its folder."""

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
    with pytest.raises(BusyError, match="another process is at work on this already"), alone(path):
        pass
    with pytest.warns(UserWarning, match="another process bakes it: waiting for it") as told, alone(path, "bakes it"):
        order.append("we")
    thread.join()
    assert order == ["other", "we"]
    assert len(told) == 1


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
