"""Whether `deadreckon recommend` keeps its word: `python benchmarks/recommend.py`, then `... --table`.

20 runs of the command: logs of 1,000 to 200,000 rows, of one step and of many, with discrete and continuous actions, and
budgets of two to five minutes; each once on the machine as it is and once beside a busy loop on every core. Every run begins
with an empty home folder, so that all programs are compiled in it, as for a new user. A run is one small file, so what is there
is not done again.

What is asked: always a card, never later than 1.1 times the budget; and a judged one, not "not enough time", in nine of ten
runs on the machine as it is.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.bench.idle import measuring

ROWS, BUDGETS = (1_000, 10_000, 50_000, 100_000, 200_000), (2, 3, 5)  # minutes
LATEST, NEEDED = 1.1, 0.9
LENGTH, OBSERVED, ACTIONS = 20, 8, 4  # steps of an episode, numbers of an observation, discrete actions
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Trial(NamedTuple):
    """One run: a log, a budget in minutes, and whether every core is busy."""

    rows: int
    steps: int
    discrete: bool
    budget: int
    busy: bool

    @property
    def name(self) -> str:
        """Of its file."""
        kind = f"{'bandit' if self.steps == 1 else 'sequential'}-{'discrete' if self.discrete else 'continuous'}"
        return f"{kind}-{self.rows}-{self.budget}m-{'busy' if self.busy else 'quiet'}"


def trials() -> list[Trial]:
    """All 20; quiet ones first."""
    kinds = [(rows, steps, (i + j) % 2 == 0) for i, rows in enumerate(ROWS) for j, steps in enumerate((1, LENGTH))]
    return [Trial(*kind, BUDGETS[i % len(BUDGETS)], busy) for busy in (False, True) for i, kind in enumerate(kinds)]


def log(trial: Trial) -> Any:
    """The reward is higher the better the action fits the first number of the observation; the log acts at random."""
    import deadreckon as dr

    rng, rows = np.random.default_rng([trial.rows, trial.steps]), trial.rows // trial.steps * trial.steps
    observations = rng.normal(size=(rows, OBSERVED)).astype(np.float32)
    noise = 0.1 * rng.normal(size=rows)
    if trial.discrete:
        actions = rng.integers(0, ACTIONS, rows)
        rewards = (actions == np.digitize(observations[:, 0], [-0.7, 0.0, 0.7])) + noise
    else:
        actions = rng.uniform(-0.9, 0.9, (rows, 3)).astype(np.float32)
        rewards = 1.0 - np.abs(actions[:, 0] - np.tanh(observations[:, 0])) + noise
    ends = np.arange(1, rows + 1) % trial.steps == 0
    how = {"terminals": ends} if trial.steps == 1 else {"timeouts": ends}
    return dr.Dataset.from_arrays(
        observations=observations, actions=actions, rewards=rewards.astype(np.float32), name=trial.name, **how
    )


def run(trial: Trial) -> dict[str, Any]:
    """The command, timed from outside."""
    from deadreckon.data.formats.folder import write_folder
    from deadreckon.files import read_json

    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder) / "log", Path(folder) / "out"
        write_folder(log(trial), data)
        cores = range(os.cpu_count() or 1) if trial.busy else ()
        loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in cores]
        try:
            before, began = os.getloadavg()[0], time.perf_counter()
            asked = ["recommend", data, "--budget", f"{trial.budget}m", "--out", out]
            environment = os.environ | ONE_THREAD | {"DEADRECKON_HOME": str(Path(folder) / "home")}
            command = [sys.executable, "-m", "deadreckon.cli.main", *map(str, asked)]
            said = subprocess.run(command, capture_output=True, text=True, env=environment)
            seconds = time.perf_counter() - began
        finally:
            for loop in loops:
                loop.kill()
                loop.wait()
        there = (out / "estimates.json").exists() and (out / "report.html").exists() and "DEPLOY" in said.stdout
        told = read_json(out / "estimates.json") if there else {}
    tried = told.get("recommend", {})
    return trial._asdict() | {
        "seconds": seconds, "card": there, "judged": bool(told.get("results")), "code": said.returncode, "load": before,
        "deploy": told.get("choice", {}).get("deploy"), "reason": told.get("choice", {}).get("reason"),
        "candidates": {each["name"]: each["updates"] for each in tried.get("candidates", [])},
        "stdout": said.stdout, "stderr": said.stderr[-2000:],
    }  # fmt: skip


def table(found: list[dict[str, Any]]) -> str:
    """Runs as a table, and whether what is asked holds."""
    lines = [
        "| log | rows | budget | machine | card after | of the budget | evaluated | candidates | updates each |",
        "|---|--:|--:|---|--:|--:|---|--:|--:|",
    ]
    for each in found:
        kind = f"{'one step' if each['steps'] == 1 else 'many steps'}, {'discrete' if each['discrete'] else 'continuous'}"
        share = each["seconds"] / (60 * each["budget"])
        updates = sorted(each["candidates"].values()) or [0]
        judged = "yes" if each["judged"] else "no" if each["card"] else "no card"
        lines.append(
            f"| {kind} | {each['rows']:,} | {each['budget']} min | {'busy' if each['busy'] else 'quiet'} | "
            f"{each['seconds']:.0f} s | {share:.2f} | {judged} | {len(updates)} | {updates[0]:,} to {updates[-1]:,} |"
        )
    late = [each for each in found if each["seconds"] > LATEST * 60 * each["budget"]]
    quiet = [each for each in found if not each["busy"]]
    cards, judged = (sum(each[what] for each in part) for what, part in (("card", found), ("judged", quiet)))
    busy = sum(each["judged"] for each in found if each["busy"])
    lines += [
        "",
        f"{len(found)} runs of {len(trials())}: {cards} cards, {len(late)} later than {LATEST:g} times the budget; judged were "
        f"{judged} of {len(quiet)} quiet runs ({NEEDED:.0%} asked) and {busy} of {len(found) - len(quiet)} busy ones.",
    ]
    return "\n".join(lines)


def main() -> int:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--out", type=Path, default=Path("runs/recommend-bench"))
    add("--only", nargs="*", default=None, help="names of trials, or parts of these")
    add("--table", action="store_true", help="print what is there, and do nothing")
    options = parser.parse_args()

    from deadreckon.files import read_json, write_json

    wanted = [t for t in trials() if options.only is None or any(part in t.name for part in options.only)]
    if not options.table:
        for trial in wanted:
            if not (path := options.out / f"{trial.name}.json").exists():
                write_json(path, found := run(trial))
                shown = "judged" if found["judged"] else "not judged" if found["card"] else "NO CARD"
                print(f"{trial.name}: {found['seconds']:.0f} s, {shown}", flush=True)
    there = [path for trial in wanted if (path := options.out / f"{trial.name}.json").exists()]
    print(table([read_json(path) for path in there]))
    return 0


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
