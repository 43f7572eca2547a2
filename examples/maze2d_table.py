"""A table of results on one maze: collect the full log, train every agent, judge, report. Resumes where it was stopped.

    python examples/maze2d_table.py --steps 20000 --seeds 3 --out runs/maze2d-umaze           (CPU budget)
    python examples/maze2d_table.py --steps 500000 --seeds 8 --episodes 100 --out runs/maze2d-umaze-full        (a GPU)
"""

from dataclasses import dataclass
from pathlib import Path

import tyro

import deadreckon as dr
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect import collect
from deadreckon.report import table, write

# What is compared: a folder's name, the agent, and the fields that differ from its defaults.
COMPARED = {
    "bc": ("bc", {}),
    "td3": ("td3", {}),
    "sac": ("sac", {}),
    "td3_bc": ("td3_bc", {}),
    "bear": ("bear", {}),
    "bear_vae": ("bear", {"behavior": "vae"}),
}


@dataclass
class Options:
    """Results on one maze."""

    maze: str = "umaze"  # umaze, medium, large, or one of the evaluation mazes such as eval-umaze
    steps: int = 20_000  # updates an agent
    seeds: int = 3  # an agent
    episodes: int = 50  # an evaluation
    log_steps: int | None = None  # of the log; None: all of it
    hidden: tuple[int, ...] = (256, 256)  # layers of actor and critics
    only: tuple[str, ...] = tuple(COMPARED)  # which of the compared
    out: str = "runs/maze2d-umaze"  # folder of log, runs and report


def main(options: Options) -> None:
    """Trains what is not trained yet and writes the page."""
    cache_compiled_programs()
    out = Path(options.out)
    log = out / "log.hdf5"
    name = f"maze2d-{options.maze}-v1"
    if not log.exists():
        with Bar(f"collecting {name}", options.log_steps or 1, "steps") as bar:
            collect(name, steps=options.log_steps, out=log, progress=bar)
    data = dr.read(log)
    for label in options.only:
        agent, fields = COMPARED[label]
        with Bar(label, options.steps, "updates") as bar:
            dr.train(
                dr.agents.agent_class(agent)(hidden=options.hidden, **fields), data, steps=options.steps,
                seeds=options.seeds, episodes=options.episodes, out=out / label, resume=(out / label).exists(),
                watch=lambda progress, steps, bar=bar: bar(progress.step, steps),
            )  # fmt: skip
    folders = [out / label for label in options.only]
    print(table(folders))
    print(write(folders, out / "report.html", title=f"Maze2D {options.maze}, {options.steps:,} updates"))


if __name__ == "__main__":
    main(tyro.cli(Options))
