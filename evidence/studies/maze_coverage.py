"""Where the logs of the mazes have been: trajectories (thesis D.7), and AntMaze beside Maze2D (thesis D.6).

    python evidence/studies/maze_coverage.py --trajectories antmaze-trajectories.svg --coverage antmaze-coverage.svg

Logs that are missing are collected first.
"""

from dataclasses import dataclass

import tyro

import deadreckon as dr
from deadreckon import tasks
from deadreckon.collect import collect
from deadreckon.data.dataset import Dataset
from deadreckon.report import maze
from deadreckon.report.picture import sheet
from deadreckon.tasks.mazes import Maze

TRAJECTORIES = (
    "antmaze-umaze-v2", "antmaze-medium-play-v2", "antmaze-large-play-v2",
    "antmaze-umaze-diverse-v2", "antmaze-medium-diverse-v2", "antmaze-large-diverse-v2",
)  # fmt: skip
COVERAGE = ("umaze", "medium", "large")


@dataclass
class Options:
    """What is drawn."""

    steps: int | None = None  # rows of each log; None: all
    shown: int = 20  # episodes of each log among the trajectories
    trajectories: str | None = None  # SVG file
    coverage: str | None = None  # SVG file


def main(options: Options) -> None:
    """Draws what is asked for, and prints how much of the free ground the logs have been to."""
    if options.trajectories:
        panels = {}
        for name in TRAJECTORIES:
            task, log = found(name, options.steps)
            shown = [log.select([i]).observations[:, :2] for i in range(min(options.shown, log.episodes))]
            panels[name] = maze.picture(task, shown, [i % 8 for i in range(len(shown))], name, False)
        sheet(options.trajectories, panels, [], columns=3)
    if options.coverage:
        panels = {}
        for size in COVERAGE:
            for name in (f"maze2d-{size}-v1", f"antmaze-{size}{'' if size == 'umaze' else '-diverse'}-v2"):
                task, log = found(name, options.steps)
                visits = maze.visits(task, log.observations[:, :2])
                print(f"{name}: {(visits > 0).sum() / (maze.BINS**2 * len(task.cells)):.0%} of the free ground")
                panels[name] = maze.density(task, visits, name)
        sheet(options.coverage, panels, [])


def found(name: str, steps: int | None) -> tuple[Maze, Dataset]:
    """A log, and its task."""
    task = tasks.registry.of_log(name)
    assert isinstance(task, Maze)
    return task, dr.load(collect(name, steps=steps))


if __name__ == "__main__":
    main(tyro.cli(Options))
