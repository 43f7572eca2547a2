"""`deadreckon recommend`: a log and so much time in, a decision card out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Watch


@dataclass
class Recommend:
    """Try agents and settings on a log, estimate them from it alone, and say whether to deploy which; says first how long."""

    data: Annotated[str, tyro.conf.Positional]  # log: a name of the catalogue, or a file
    budget: str = "30m"  # time for everything: 90s, 30m, 2h
    task: str | None = None  # simulator to check the choice in; None: that of a known log, and none for others
    discount: float = 0.99  # of the returns
    seed: int = 0  # of everything random
    out: str = "runs/recommend"  # folder of the runs, the estimates and report.html; must not be there yet


def recommend(args: Sequence[str]) -> None:
    """Recommends and prints the card."""
    options = parse(Recommend, args, "recommend")
    from deadreckon.report import write
    from deadreckon.runs import recommend as found
    from deadreckon.runs.durations import in_words
    from deadreckon.runs.offline import checked, supports

    with Watch() as watch:
        result = found.recommend(
            options.data, options.budget, task=options.task, discount=options.discount, seed=options.seed, out=options.out,
            tell=lambda line: print(line, flush=True), watch=watch,
        )  # fmt: skip
    page = write(result.runs, Path(options.out) / "report.html", estimates=options.out)
    print(f"\n{result.judged.estimates[0]}\n\n{supports(result.judged.told)}\n\n{result.judged.choice}")
    if result.judged.told["truth"] is not None:
        print(f"checked: {checked(result.judged.told)}")
    print(f"\ntook {in_words(result.seconds)} of {options.budget}; report: {page}")
