"""`deadreckon recommend`: a log and so much time in, a decision card out."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from deadreckon.cli.data import Mapping
from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Watch
from deadreckon.cli.train import columns_of, holdout_of


@dataclass
class Recommend:
    """Try agents and settings on a log, estimate them on held-out episodes, and say in time which to deploy, if any."""

    data: Annotated[str, tyro.conf.Positional]  # log to learn from: a known name, or a file
    map: Annotated[Mapping, tyro.conf.arg(name="")]  # columns of a table (CSV, Parquet)
    budget: str = "30m"  # time for everything, such as 90s, 30m or 2h; a card is written when it is over
    task: str | None = None  # simulator to check the choice in; None: that of a known log, and none for others
    discount: float = 0.99  # discount factor per step of the returns
    seed: int = 0  # random seed of everything
    out: str = "runs/recommend"  # folder of the runs, the estimates and report.html, which must not exist yet
    holdout: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """share of the episodes that is held out for the decision; None: 0.2"""
    holdout_by: Annotated[str | None, tyro.conf.arg(metavar="random|time|COLUMN")] = None
    """how to choose held-out episodes: random, the latest (time), or all episodes of some values of a COLUMN"""
    accept_model_based: bool = False  # whether to deploy also by estimates that no logged reward corrects


def recommend(args: Sequence[str]) -> None:
    """Recommends and prints the card."""
    began = time.perf_counter()  # loading the libraries counts
    options = parse(Recommend, args, "recommend")
    from deadreckon.report import recommended
    from deadreckon.runs.durations import in_words, seconds_of

    seconds_of(options.budget)
    with Watch() as watch:
        result = recommended.recommend(
            options.data, options.budget, task=options.task, discount=options.discount, seed=options.seed, out=options.out,
            holdout=holdout_of(options.holdout, options.holdout_by), accept_model_based=options.accept_model_based,
            columns=columns_of(options.map, options.holdout_by), tell=lambda line: print(line, flush=True), watch=watch,
            began=began,
        )  # fmt: skip
    print(f"\n{result}\n\ntook {in_words(result.seconds)} of {options.budget}; report: {result.path / recommended.PAGE}")
    if result.failed:
        raise SystemExit(1)
