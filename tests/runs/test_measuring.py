"""Policies measured in batches, by one process or several."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.runs.measuring import Measuring, _joined, measured_enough


def test_batches_join_to_the_mean_and_error_of_all():
    rng = np.random.default_rng(0)
    x = rng.normal(5.0, 2.0, 60)
    parts, done, known = np.split(x, [7, 25]), 0, (0.0, 0.0)
    for part in parts:
        known = _joined(done, known, part)
        done += len(part)
    assert known == pytest.approx((x.mean(), x.std(ddof=1) / 60**0.5))


def test_no_process_cannot_measure():
    with pytest.raises(UserError, match="processes must be 1 or more, got 0"):
        measured_enough("battery", {}, {}, Measuring(processes=0), print)
    with pytest.raises(UserError, match="episodes must be 2 or more, got 1"):
        measured_enough("battery", {}, {}, Measuring(episodes=1), print)


SIDE_BY_SIDE = """
from deadreckon.runs.measuring import Measuring, measured_enough

if __name__ == "__main__":
    def keep(key, mode, returns):
        print("kept", flush=True)

    many = {(str(i), "sampled"): None for i in range(200)}
    measured_enough("hopper", many, {}, Measuring(episodes=10, most=10, processes=2), keep)
"""


@pytest.mark.slow
def test_processes_end_with_their_parent(tmp_path):
    (tmp_path / "measure.py").write_text(SIDE_BY_SIDE)
    parent = subprocess.Popen([sys.executable, tmp_path / "measure.py"], stdout=subprocess.PIPE, text=True)
    assert parent.stdout.readline() == "kept\n"
    children = [int(pid) for pid in subprocess.check_output(["ps", "-o", "pid=", "--ppid", str(parent.pid)], text=True).split()]
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 20
    while time.monotonic() < end and any(_runs(pid) for pid in children):
        time.sleep(0.2)
    assert children
    assert not any(_runs(pid) for pid in children)


def _runs(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
