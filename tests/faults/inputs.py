"""What the commands of the study are given: small logs, tables, policies and suites, the same for all cases."""

from pathlib import Path

import numpy as np

from tests.faults.process import run

SUITE = """
seeds = 2
steps = 60
evaluations = 2
episodes = 2
logs = ["log.npz"]

[methods]
BC = { agent = "bc", fields = { hidden = [8], batch_size = 16 } }
TD3 = { agent = "td3", fields = { hidden = [8], batch_size = 16 } }
"""
QUEUE = 'suites = ["study.toml"]\n'
STUDY = """
about = "A study."
kind = "study"
ledger = "ledger"
seeds = 6
cases = ["a", "b"]

[methods]
one = { agent = "studies_of_tests:measure", fields = { size = 1.0 } }

[metrics]
value = { words = "a value", digits = 2 }
"""
CODE = """
import time

def measure(case, *, seed, size):
    time.sleep(0.1)
    with open("done.txt", "a") as file:
        file.write(f"{case} {size} {seed}\\n")
    return {"value": size + seed / 100 + (case == "b")}
"""
SUITE_FILES = {"queue.toml": QUEUE, "study.toml": STUDY, "studies_of_tests.py": CODE, "small.toml": SUITE}


def make(folder: Path) -> Path:
    """Makes what is not there yet, and gives the folder.

    Raises:
        RuntimeError: a command failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    if not (folder / "rows.csv").exists():
        drawn = enumerate(rng.normal(size=(1600, 3)))
        rows = [f"{i // 8},{i % 8},{a:.4f},{b:.4f},{c:.4f},{a - c * c:.4f}" for i, (a, b, c) in drawn]
        (folder / "rows.csv").write_text("\n".join(["episode,day,x,y,dose,gain", *rows]) + "\n")
    if not (folder / "designs.csv").exists():
        rows = [f"{a:.4f},{b:.4f},{-(a - 0.3) ** 2 - (b - 0.6) ** 2:.5f}" for a, b in rng.uniform(size=(60, 2))]
        (folder / "designs.csv").write_text("\n".join(["a,b,score", *rows]) + "\n")
    log, roles = str(folder / "log.npz"), ["--episode", "episode", "--action", "dose", "--reward", "gain"]
    train = ["train", "--agent", "bc", "--agent.hidden", "16", "--data", str(folder / "rows.csv"), *roles, "--steps", "100"]
    for argv, made in (
        (["data", "convert", str(folder / "rows.csv"), log, *roles], log),
        ([*train, "--out", str(folder / "policy")], folder / "policy" / "run.json"),
    ):
        if not Path(made).exists() and (done := run(argv, folder)).code != 0:
            raise RuntimeError(f"{' '.join(argv)}: {done.lines()}")
    return folder
