"""`deadreckon theory NAME`: an argument of the thesis as pictures and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deadreckon.cli.parse import parse
from deadreckon.errors import unknown
from deadreckon.files import alone


@dataclass
class Theory:
    """Experiments for the thesis's theory in small exact MDPs: figures (SVG) and their numbers (CSV). Without a name: list."""

    name: Annotated[str | None, tyro.conf.Positional] = None  # name of the experiment: gridworld, mmd, bounds or cnml
    seed: int = 0  # random seed of the experiment
    out: str | None = None  # folder to write; None: runs/theory/NAME


def theory(args: Sequence[str]) -> None:
    """Lists, or computes, draws and prints."""
    options = parse(Theory, args, "theory")
    from deadreckon.randomness import check_seed
    from deadreckon.report.theory import EXPERIMENTS
    from deadreckon.text_table import table

    if options.name is None:
        print(table([["name", "what"], *([name, line] for name, (_, line) in EXPERIMENTS.items())]))
        print("\ndeadreckon theory NAME --out FOLDER writes the figures and their numbers.")
        return
    if options.name not in EXPERIMENTS:
        raise unknown("theory", options.name, EXPERIMENTS)
    check_seed(options.seed)
    out = Path(options.out or f"runs/theory/{options.name}")
    with alone(out, what=str(out)):
        files, said = EXPERIMENTS[options.name][0](out, options.seed)
    print("\n".join([*said, "", *map(str, files)]))
