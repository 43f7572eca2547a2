"""The controllers and data of the two morphology problems: how they were made.

    python examples/morphologies.py --train          (a quarter of an hour a robot on one core; goes on where it was stopped)
    python examples/morphologies.py --collect          (half an hour a robot on one core)
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import deadreckon as dr
from deadreckon.agents.sac import SAC
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect.online import Online
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.mbo.problems.morphology import STEPS, designs_of, returns, stored
from deadreckon.policies import save
from deadreckon.tasks.morphology import ANT, KITTY, Morphology

ROBOTS = {"ant": ANT, "dkitty": KITTY}
SETTINGS = Online(copies=16, explore=9600, updates_per_step=0.25)
AGENT = SAC(hidden=(128, 128))
RUNS, POPULATION, DEVIATION = 10, 24, 0.1  # of CMA-ES: runs, designs an iteration, first deviation in half ranges
DESIGNS = 25_009  # as many as Design-Bench has


@dataclass
class Options:
    """Controllers by online SAC, data by CMA-ES."""

    only: tuple[str, ...] = tuple(ROBOTS)  # of these
    train: bool = False  # train controllers and ship them
    steps: int = 400_000  # environment steps of the training
    collect: bool = False  # run CMA-ES and ship what it tried out
    designs: int = DESIGNS  # how many that are
    out: str = "runs"  # training runs are OUT/sac-ROBOT


def main(options: Options) -> None:
    """Does what is asked for."""
    cache_compiled_programs()
    for name in options.only:
        task = ROBOTS[name]
        if options.train:
            train(task, options.steps, Path(options.out) / f"sac-{task.name}")
        if options.collect:
            collect(task, options.designs)


def train(task: Morphology, steps: int, out: Path) -> None:
    """Trains, and ships the last policy."""
    with Bar(f"sac in {task.name}", SETTINGS.updates(steps), "updates") as bar:
        run = dr.train_online(
            AGENT, task, steps=steps, settings=SETTINGS, evaluate_every=20_000, episodes=32, out=out, resume=True,
            watch=lambda progress, updates: bar(progress.step, updates),
        )  # fmt: skip
    save(stored(task, "controller"), run.policy, {"task": task.name, "environment_steps": steps}, half=True)
    print(stored(task, "controller"))


def collect(task: Morphology, count: int) -> None:
    """CMA-ES from the default design on; ships every design that it tried out."""
    try:
        import cma
    except ImportError:
        raise UserError("--collect needs CMA-ES: pip install cma") from None
    steps, scores = [], []
    each = -(-count // RUNS)
    with Bar(f"CMA-ES on {task.name}", count, "designs") as bar:
        for seed in range(RUNS):
            settings = {"popsize": POPULATION, "seed": seed + 1, "bounds": [-1, 1], "verbose": -9}
            evolution = cma.CMAEvolutionStrategy(task.unit(task.usual), DEVIATION, settings)
            done = 0
            while done < each:
                asked = evolution.ask()
                whole = np.round((np.array(asked) + 1) / 2 * STEPS).astype(np.uint8)
                found = returns(task, designs_of(task, whole))
                evolution.tell(asked, list(-found))
                steps.append(whole)
                scores.append(found)
                done += len(whole)
                bar(min(sum(map(len, scores)), count), count)
    order = np.sort(np.random.default_rng(0).permutation(sum(map(len, scores)))[:count])
    with replacing(stored(task, "data")) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, steps=np.concatenate(steps)[order], scores=np.concatenate(scores)[order].astype(np.float32))
    print(stored(task, "data"))


if __name__ == "__main__":
    main(tyro.cli(Options))
