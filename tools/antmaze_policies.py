"""DOPE's policies of AntMaze: snapshots of behaviour cloning from a planner whose ants all go to the goal (thesis 8.4).

    python tools/antmaze_policies.py --train --only umaze --rows 200000 --steps 22000        (goes on where it was stopped)
    python tools/antmaze_policies.py --publish --only umaze --rows 200000 --steps 22000 --episodes 100

The thesis imitates in the large maze alone, and takes snapshots of DAPG in the others. These clones are clipped Gaussians: of
the planner's actions many lie at the bounds, where a tanh-Gaussian would not draw what it was shown.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import tyro

import deadreckon as dr
from deadreckon.agents.bc import BC
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect.antmaze import collect_antmaze
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.policies.library import ROOT, SNAPSHOTS
from deadreckon.runs.publish import Publish, publish

# Play and diverse logs are judged in the same environment, so the policies of one serve both.
TASKS = {"umaze": "antmaze-umaze", "medium": "antmaze-medium-play", "large": "antmaze-large-play"}


@dataclass
class Options:
    """Behaviour cloning, every field at its default."""

    only: tuple[str, ...] = tuple(TASKS)  # of these mazes
    rows: int = 1_000_000  # of the planner's log
    steps: int = 110_000  # updates, a multiple of the number of snapshots, which are spread over them
    model: Literal["clipped", "gaussian"] = "clipped"  # of the clones; runs of a tanh-Gaussian have a name of their own
    train: bool = False  # train what is not trained yet
    publish: bool = False  # write the library and measure it
    episodes: int = 1000  # a policy, with drawn and with mean actions
    out: str = "runs"  # logs and runs are OUT/antmaze-MAZE-directed-...
    library: str = str(ROOT)  # folder that is published to


def directed(maze: str, rows: int, path: Path) -> Path:
    """The log of a planner that sends every ant from the task's start to the task's goal; made if it is not there."""
    if not path.exists():
        # What is neither play nor diverse is directed, by its name.
        task = replace(dr.tasks.task(TASKS[maze]), name=f"antmaze-{maze}")
        with Bar(f"antmaze-{maze}, directed", rows, "steps") as bar:
            log = collect_antmaze(task, name=path.stem, steps=rows, scratch=path.with_suffix(".part"), progress=bar)
            write_hdf5(log, path)
    return path


def main(options: Options) -> None:
    """Does what is asked for, in this order: train, publish."""
    cache_compiled_programs()
    for maze in options.only:
        name = f"antmaze-{maze}-directed-{options.rows}"
        run = Path(options.out) / (f"bc-{name}" if options.model == "clipped" else f"bc-{options.model}-{name}")
        if options.train:
            log = directed(maze, options.rows, Path(options.out) / f"{name}.hdf5")
            with Bar(f"bc in {maze}", options.steps, "updates") as bar:
                dr.train(
                    BC(model=options.model), log, steps=options.steps, task=TASKS[maze],
                    evaluate_every=options.steps // SNAPSHOTS, episodes=5, out=run, resume=True,
                    watch=lambda progress, steps, bar=bar: bar(progress.step, steps),
                )  # fmt: skip
        if options.publish:
            asked = Publish(
                str(run), updates=options.steps, episodes=options.episodes, most=options.episodes, out=options.library
            )
            print(publish(asked, watch=print))


if __name__ == "__main__":
    main(tyro.cli(Options))
