"""SIGKILL at random moments: never more than the chunk in flight is lost, and the end is the same to the bit."""

import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from deadreckon.collect import generate
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.files import read_json
from deadreckon.runs.train import load

KILLS, STEPS, CHUNK = 20, 3000, 50


def command(log, out):
    options = ["--steps", STEPS, "--chunk", CHUNK, "--seeds", 2, "--episodes", 2, "--evaluate-every", 500, "--resume"]
    agent = ["--agent", "td3_bc", "--agent.hidden", 16, 16, "--agent.batch-size", 64]
    return [sys.executable, "-m", "deadreckon.cli.main", "train", *map(str, [*agent, "--data", log, "--out", out, *options])]


def latest_step(folder):
    steps = [int(p.stem) for p in folder.glob("[0-9]*.npz")]
    return max(steps, default=None)


def same(a, b):
    x = np.random.default_rng(0).uniform(-1, 1, (20, 4)).astype("f4")
    return (
        a.metrics.equals(b.metrics)
        and a.evaluations.equals(b.evaluations)
        and all(np.array_equal(p(x), q(x)) for p, q in zip(a.policies, b.policies, strict=True))
    )


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_killed_at_random_and_resumed_equals_unbroken(tmp_path, home):
    log = tmp_path / "log.hdf5"
    write_hdf5(generate("maze2d-umaze-v1", steps=4000, seed=0), log)
    environment = os.environ | {"DEADRECKON_HOME": str(home)}
    subprocess.run(command(log, tmp_path / "whole"), check=True, env=environment, capture_output=True)
    whole = load(tmp_path / "whole")

    chance = random.Random(0)
    kills = mid_training = finished = 0
    while kills < KILLS:
        out = tmp_path / f"run{finished}"
        while True:
            known = latest_step(out / "checkpoints") if (out / "checkpoints").exists() else None
            process = subprocess.Popen(command(log, out), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            # Some die while they start; most a random moment after their first new checkpoint.
            if chance.random() < 0.8:
                while process.poll() is None and (latest_step(out / "checkpoints") or 0) <= (known or 0):
                    time.sleep(0.005)
                time.sleep(chance.uniform(0.0, 0.4))
            else:
                time.sleep(chance.uniform(0.1, 3.0))
            if process.poll() is not None:
                assert process.returncode == 0
                break
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills += 1
            if (out / "status.json").exists() and (step := latest_step(out / "checkpoints")) is not None:
                # What was told to the world is at most one chunk ahead of what is safe.
                assert read_json(out / "status.json")["step"] - step <= CHUNK
                assert step >= (known or 0)
                mid_training += 0 < step < STEPS
            if kills >= KILLS:
                subprocess.run(command(log, out), check=True, env=environment, capture_output=True)
                break
        assert same(load(out), whole)
        finished += 1
    assert mid_training >= KILLS // 2
