"""DOPE's policies of Maze2D and Adroit (thesis 8.4): how the runs of DAPG were made, and how their snapshots are published.

    python tools/dapg_policies.py --train --only maze2d-umaze-dense --budget cpu       (goes on where it was stopped)
    python tools/dapg_policies.py --publish --only maze2d-umaze-dense --budget cpu --episodes 200
    python tools/dapg_policies.py --table

Demonstrations are the planner's in Maze2D, people's of the door, and of the other hands, whose human demonstrations are not at
hand, episodes of the policy that DAPG's authors published.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import tyro

import deadreckon as dr
from deadreckon.agents.dapg import DAPG
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect import generate
from deadreckon.collect.maze2d import demonstrations
from deadreckon.data.dataset import Dataset
from deadreckon.online import Online
from deadreckon.policies.library import ROOT, SNAPSHOTS, library, library_tasks
from deadreckon.runs.publish import Publish, publish
from deadreckon.tasks.maze2d import Maze2D

# Episodes an iteration, side by side, and what the iterations are divided by; DAPG's authors take 200 of Adroit, 100 times.
BUDGETS = {"full": (200, 1), "cpu": (96, 2)}
SHOWN = 25  # demonstrations of the mazes' planner


class Made(NamedTuple):
    """A run. The demonstrations are those of the maze's planner where there is no log of them."""

    agent: DAPG
    iterations: int  # natural gradients
    log: str | None = None  # recipe of the demonstrations
    rows: int | None = None  # of it; None: all


# Cloned for a moment only, the runs of the mazes and the hammer begin low enough for their snapshots to span something.
RUNS = {
    "maze2d-umaze-dense": Made(DAPG(bc_steps=30), 40),
    "maze2d-medium-dense": Made(DAPG(bc_steps=30), 60),
    "maze2d-large-dense": Made(DAPG(bc_steps=30), 80),
    "door": Made(DAPG(demonstration_weight=0.01), 100, "door-human-v1"),
    "pen": Made(DAPG(hidden=(64, 64)), 100, "pen-expert-v1", 2500),
    "hammer": Made(DAPG(bc_steps=250), 100, "hammer-expert-v1", 5000),
    "relocate": Made(DAPG(), 100, "relocate-expert-v1", 5000),
}


@dataclass
class Options:
    """DAPG on the tasks whose policies DOPE made with it."""

    only: tuple[str, ...] = tuple(RUNS)  # of these tasks
    budget: Literal["full", "cpu"] = "full"  # 200 episodes an iteration, or 96 and half the iterations
    iterations: int | None = None  # of the run, a multiple of ten; None: as declared. A run may go on to more
    train: bool = False  # train what is not trained yet
    publish: bool = False  # write the library and measure it
    episodes: int = 1000  # a policy, with drawn and with mean actions
    most: int | None = None  # episodes at most, where the error is still large; None: as many
    table: bool = False  # print what the package's policies return
    out: str = "runs"  # the runs are OUT/dapg-TASK, or OUT/dapg-cpu-TASK
    library: str = str(ROOT)  # folder that is published to


def shown(name: str) -> Dataset:
    """The demonstrations of a task's run."""
    made, task = RUNS[name], dr.tasks.task(name)
    if made.log is None:
        assert isinstance(task, Maze2D)
        return demonstrations(task, SHOWN)
    return generate(made.log, steps=made.rows)


def settings(name: str, budget: str) -> Online:
    """Blocks as long as episodes; before the first, a step of each copy that only says what observations are like."""
    copies, _ = BUDGETS[budget]
    block = copies * dr.tasks.task(name).horizon
    return dataclasses.replace(Online(**DAPG.acting(name)), copies=copies, explore=copies, block=block)


def main(options: Options) -> None:
    """Does what is asked for, in this order: train, publish, table."""
    cache_compiled_programs()
    for name in options.only:
        made, turns = RUNS[name], settings(name, options.budget)
        iterations = options.iterations or made.iterations // BUDGETS[options.budget][1]
        folder = Path(options.out) / ("dapg-cpu" if options.budget == "cpu" else "dapg")
        folder = folder.with_name(f"{folder.name}-{name}")
        updates = iterations * turns.updates_per_block
        if options.train:
            with Bar(f"dapg in {name}", updates, "updates") as bar:
                dr.train_online(
                    made.agent, name, steps=turns.steps(updates), settings=turns, demonstrations=shown(name),
                    evaluate_every=turns.block, episodes=5, out=folder, resume=True, chunk=turns.updates_per_block,
                    watch=lambda progress, whole, bar=bar: bar(progress.step, whole),
                )  # fmt: skip
        if options.publish:
            most = options.most or options.episodes
            asked = Publish(str(folder), updates=updates, episodes=options.episodes, most=most, out=options.library)
            print(publish(asked, watch=print))
    if options.table:
        print(table(options.only))


def table(names: tuple[str, ...]) -> str:
    """Returns of the package's snapshots with drawn actions, a row a task."""
    lines = ["| task | " + " | ".join(f"{i:02d}" for i in range(SNAPSHOTS)) + " |", "|---|" + "---:|" * SNAPSHOTS]
    for name in (name for name in names if name in library_tasks()):
        cells = [f"{s.sampled.mean:,.1f} ± {s.sampled.error:.1f}" for s in library(name)]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main(tyro.cli(Options))
