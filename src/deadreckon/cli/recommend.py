"""`deadreckon recommend`: a log and so much time in, a decision card out."""

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from deadreckon.cli.data import Mapping
from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Watch
from deadreckon.cli.train import columns_of, holdout_of
from deadreckon.runs.settings import RecommendSettings


@dataclass(frozen=True, kw_only=True)
class _Settings(RecommendSettings):
    holdout: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """share of the episodes that is held out for the decision; None: 0.2"""
    holdout_by: Annotated[str | None, tyro.conf.arg(metavar="random|time|COLUMN")] = None
    """how to choose held-out episodes: random, the latest (time), or all episodes of some values of a COLUMN"""
    columns: tyro.conf.Suppress[Any] = None


@dataclass
class Recommend:
    """Train agents on a log, estimate their values on held-out episodes, and recommend which to deploy in a given time."""

    data: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]  # log to learn from: a known name, or a file
    budget: str = "30m"  # time of the whole command, such as 90s, 30m or 2h; a decision card is written at its end
    out: str = "runs/recommend"  # folder of the runs, the estimates and report.html, which must not exist yet
    settings: Annotated[_Settings, tyro.conf.arg(name="")] = dataclasses.field(default_factory=_Settings)
    map: Annotated[Mapping, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Mapping)  # columns of a table


def recommend(args: Sequence[str]) -> None:
    """Recommends and prints the card."""
    began = time.perf_counter()  # loading the libraries counts
    options = parse(Recommend, args, "recommend")
    from deadreckon.report import recommended
    from deadreckon.runs.durations import in_words, seconds_of

    seconds_of(options.budget)
    settings = options.settings
    with Watch() as watch:
        result = recommended.recommend(
            options.data, options.budget, out=options.out, tell=lambda line: print(line, flush=True), watch=watch, began=began,
            **settings.only(RecommendSettings) | {
                "holdout": holdout_of(settings.holdout, settings.holdout_by),
                "columns": columns_of(options.map, settings.holdout_by),
            },
        )  # fmt: skip
    print(f"\n{result}\n\ntook {in_words(result.seconds)} of {options.budget}; report: {result.path / recommended.PAGE}")
    if result.failed:
        raise SystemExit(1)
