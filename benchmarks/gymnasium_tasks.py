"""Ten environments of Gymnasium, three of other packages: collected by chance, learned in online, evaluated.

    python benchmarks/gymnasium_tasks.py [FOLDER]

Runs the command lines that docs/tasks/gymnasium.md shows, one after the other, and prints its table. What is done already in
FOLDER is not done again.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

import deadreckon as dr

# Name of a task, and what its run is asked for beside the rest.
SPARSE = "--agent.temperature 0.03 --agent.temperature-lr 3e-3"  # for rewards that are 1 at most in an episode
TASKS = (
    ("Pendulum-v1", "--explore 1000"), ("CartPole-v1", "--explore 1000"), ("Acrobot-v1", "--explore 1000"),
    ("MountainCarContinuous-v0", "--explore 1000"), ("FrozenLake-v1?is_slippery=False", f"--explore 5000 {SPARSE}"),
    ("InvertedPendulum-v5", "--explore 1000"), ("Reacher-v5", "--explore 1000"),
    ("gymnasium_robotics:FetchReachDense-v4", "--explore 1000"),
    ("minigrid:MiniGrid-Empty-5x5-v0?max_episode_steps=100", f"--explore 2000 {SPARSE}"),
    ("ale_py:ALE/Freeway-v5?obs_type=ram&max_episode_steps=500", "--explore 1000"),
)  # fmt: skip
COMMON = "--steps 10000 --seeds 2 --evaluate-every 2000 --agent.hidden 64 64 --agent.actor-lr 1e-3 --agent.critic-lr 1e-3"


def command(*words: str) -> None:
    """One command line, shown and run."""
    print("$ deadreckon", *words, flush=True)
    subprocess.run([sys.executable, "-m", "deadreckon.cli.main", *words], check=True, stdout=subprocess.DEVNULL)


def main(folder: Path) -> None:
    """Collects, learns and evaluates; prints a line of the table for each task."""
    rows = []
    for name, own in TASKS:
        task = f"gymnasium:{name}"
        short = name.partition("?")[0].rpartition(":")[2].rpartition("/")[2]
        log, run = folder / f"{short}.hdf5", folder / short
        if not log.exists():
            command("data", "collect", "--task", task, "--steps", "10000", "--out", str(log))
        if not (run / "status.json").exists():
            words = f"{COMMON} {own}".split()
            command("train", "--agent", "sac", "--online", "--task", task, *words, "--out", str(run))
        if not (run / "after.parquet").exists():
            command("evaluate", str(run), "--task", task, "--episodes", "50", "--out", str(run / "after.parquet"))
        after = np.asarray(pq.read_table(run / "after.parquet")["return"]).reshape(2, -1)
        chance = dr.read(log).returns()
        first = dr.load_run(run).evaluations.to_pydict()
        before = np.asarray(first["return"])[np.asarray(first["step"]) == 0].reshape(2, -1)
        cells = f"{chance.mean():.2f}", f"{before.mean():.2f}", f"{after.mean():.2f}", *(f"{x:.2f}" for x in after.mean(1))
        rows.append(f"| `{task}` | {' | '.join(cells)} |")
        print(rows[-1], flush=True)
    print("\n| task | random actions | first networks | after learning | seed 0 | seed 1 |\n|---|---:|---:|---:|---:|---:|")
    print("\n".join(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/gymnasium"))
