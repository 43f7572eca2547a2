"""Locks: one process at a time, and whoever waits says so."""

import threading
import time

import pytest

from deadreckon.errors import BusyError
from deadreckon.files import alone


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
