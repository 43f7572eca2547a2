"""The gaits and the data of the two morphology problems: how they were made.

    python tools/morphologies.py --gait
    python tools/morphologies.py --collect          (three quarters of an hour for the kitty on one core)

The ant's data were made when some of its runs stopped one iteration earlier than here.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from deadreckon.cli.progress import Bar
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.mbo.problems.morphology import STEPS, Gait, designs_of, returns, stored
from deadreckon.tasks.morphology import ANT, KITTY, Morphology

ROBOTS = {"ant": ANT, "dkitty": KITTY}
SWING = {"ant": 0.3, "dkitty": 0.1}  # of the gait that the search begins with; a kitty falls over large ones
ITERATIONS = {"ant": (80, 80), "dkitty": (150, 80)}  # of the search, on the default body, then on bodies around it
GAITS, BODIES = 16, 6  # of CMA-ES for a gait, an iteration. The first iterations know the default body alone.
# CMA-ES for data: runs, designs an iteration, first deviation in half ranges.
RUNS, POPULATION, DEVIATION = 10, 24, 0.1


@dataclass
class Options:
    """Gaits and data by CMA-ES."""

    only: tuple[str, ...] = tuple(ROBOTS)  # of these
    gait: bool = False  # find gaits
    collect: bool = False  # try out designs
    designs: int = 25_009  # how many; as many as Design-Bench has
    runs: tuple[int, ...] = tuple(range(RUNS))  # of CMA-ES, so that several processes can share them
    out: str = "runs/morphologies"  # folder of what each run tried out; what is there is not done again
    seed: int = 0  # of everything random


def main(options: Options) -> None:
    """Does what is asked for."""
    try:
        import cma
    except ImportError:
        raise UserError("tools/morphologies.py searches with CMA-ES: pip install cma") from None
    for name in options.only:
        if options.gait:
            find_gait(ROBOTS[name], SWING[name], ITERATIONS[name], options.seed, cma.CMAEvolutionStrategy)
        if options.collect:
            collect(ROBOTS[name], options, cma.CMAEvolutionStrategy)


def keep(task: Morphology, **arrays: np.ndarray) -> None:
    """Changes some of what the package has of a robot."""
    there = stored(task)
    old = dict(np.load(there)) if there.exists() else {}
    with replacing(there) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **{**old, **arrays})
    print(there)


def find_gait(task: Morphology, swing: float, parts: tuple[int, int], seed: int, evolution) -> None:
    """The gait of the greatest mean return on bodies that are drawn anew in every iteration."""
    low, high = task.bounds
    rng = np.random.default_rng(seed)
    # Middles, swings, phases, then the logarithms of frequency and stiffness.
    best = np.concatenate([np.zeros(12), np.full(12, swing), np.random.default_rng(0).uniform(-1, 1, 12), np.log([1.5, 0.5])])
    with Bar(f"gait of {task.name}", sum(parts), "iterations") as bar:
        done = 0
        for iterations, bodies, deviation in zip(parts, (1, BODIES), (swing, 0.1)):
            search = evolution(best, deviation, {"popsize": GAITS, "seed": seed + 1, "verbose": -9})
            for _ in range(iterations):
                x = task.usual + task.spread * (high - low) * rng.standard_normal((bodies, len(low)))
                x[0] = task.usual
                asked = np.array(search.ask())
                gaits = Gait.of(np.repeat(asked, bodies, 0))
                found = returns(task, np.tile(np.clip(x, low, high), (GAITS, 1)), gaits).reshape(GAITS, bodies)
                search.tell(list(asked), list(-found.mean(1)))
                done += 1
                bar(done, sum(parts), f"mean {found.mean():.0f}, default body at best {found[:, 0].max():.0f}")
            best = search.result.xfavorite
    keep(task, gait=best.astype(np.float32))


def collect(task: Morphology, options: Options, evolution) -> None:
    """CMA-ES from the default design on; what it tries out is kept run by run, and shipped when all runs are there."""
    gait = Gait.of(np.load(stored(task))["gait"])
    iterations = -(-options.designs // (RUNS * POPULATION))
    parts = [Path(options.out) / f"{task.name}-{run}.npz" for run in range(RUNS)]
    for run in options.runs:
        if parts[run].exists():
            continue
        settings = {"popsize": POPULATION, "seed": options.seed + run + 1, "bounds": [-1, 1], "verbose": -9}
        search = evolution(task.unit(task.usual), DEVIATION, settings)
        steps, scores = [], []
        with Bar(f"CMA-ES on {task.name}, run {run}", iterations * POPULATION, "designs") as bar:
            for i in range(iterations):
                asked = search.ask()
                whole = np.round((np.array(asked) + 1) / 2 * STEPS).astype(np.uint8)
                found = returns(task, designs_of(task, whole), gait)
                search.tell(asked, list(-found))
                steps.append(whole)
                scores.append(found)
                bar((i + 1) * POPULATION, iterations * POPULATION, f"best {found.max():.0f}")
        with replacing(parts[run]) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, steps=np.concatenate(steps), scores=np.concatenate(scores).astype(np.float32))
    if all(part.exists() for part in parts):
        made = [np.load(part) for part in parts]
        keep(task, **{name: np.concatenate([part[name] for part in made])[: options.designs] for name in ("steps", "scores")})


if __name__ == "__main__":
    main(tyro.cli(Options))
