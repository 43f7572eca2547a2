"""From a log to a better policy online in an environment of one's own: the heated room of `examples/own_environment.py`.

    python benchmarks/own_online.py [FOLDER]
    python benchmarks/own_online.py --degrees [FOLDER]                 # observed in plain degrees instead of units of five
    python benchmarks/own_online.py --degrees --standardise [FOLDER]   # and Cal-QL standardises them, by the log

Cal-QL learns from 10,000 steps of uniform actions and goes on for 6,000 steps of its own, beside SAC from nothing with as many;
five seeds. Rule: it has risen if the interval of the last return less that of the policy before it acts lies above 0.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import deadreckon as dr
from deadreckon.collect.in_task import collect_in_task
from deadreckon.data.spec import Box
from deadreckon.online import Online
from deadreckon.runs.run import Run
from deadreckon.stats.crossed import mean_interval

SEEDS, OFFLINE, ONLINE, EVERY, EPISODES = 5, 2_000, 6_000, 1_000, 20
NETS = {"hidden": (64, 64), "critic_hidden": (64, 64)}


def returns(run: Run) -> np.ndarray:
    """(seeds, evaluations) mean returns, the first before the policy acts."""
    table = run.evaluations.to_pandas()
    return table.groupby(["seed", "step"])["return"].mean().unstack("step").to_numpy()


def main(folder: Path, degrees: bool, standardise: bool) -> None:
    """Runs both and prints a line each."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))
    import own_environment
    from own_environment import DAY, Room

    if degrees:
        own_environment.MIDDLE, own_environment.UNIT = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    scale = dr.tasks.Reference(random=-422.0, expert=-23.0, source="uniform actions, a thermostat")
    dr.tasks.register(Room("room", "own", DAY, (3,), Box((0.0,), (1.0,)), "own/Room-v0", scale))
    log = dr.read(collect_in_task("room", steps=10_000, out=folder / "room.hdf5", force=True))
    first = dr.train(
        dr.agents.CalQL(samples=4, standardise=standardise, **NETS), log, task="room", steps=OFFLINE, seeds=SEEDS,
        out=folder / "log", episodes=EPISODES,
    )  # fmt: skip
    more = {"steps": ONLINE, "evaluate_every": EVERY, "episodes": EPISODES}
    found = {"Cal-QL, from the log": dr.train_online(start=first, task="room", out=folder / "online", **more)}
    found["SAC, from nothing"] = dr.train_online(
        dr.agents.SAC(hidden=NETS["hidden"]), "room", seeds=SEEDS, out=folder / "nothing",
        settings=Online(explore=1_000), **more,
    )  # fmt: skip
    print("| | before it acts | at the end | rise | lowest |\n|---|---:|---:|---:|---:|")
    for name, run in found.items():
        each = returns(run)
        columns = (each[:, 0], each[:, -1], each[:, -1] - each[:, 0], each.min(1))
        print(f"| {name} | " + " | ".join(f"{mean_interval(column):.1f}" for column in columns) + " |")


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    main(Path(words[0]) if words else Path(tempfile.mkdtemp()), "--degrees" in sys.argv, "--standardise" in sys.argv)
