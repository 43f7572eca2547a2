"""`deadreckon recommend`: a log and so much time in, a decision card out."""

import time
from collections.abc import Sequence

from deadreckon.cli.lines import outcome
from deadreckon.cli.ope import usage
from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Watch
from deadreckon.cli.train import columns_of, holdout_of


def recommend(args: Sequence[str]) -> None:
    """Recommends and prints the card."""
    began = time.perf_counter()  # loading the libraries counts
    from deadreckon.cli.options import Recommend

    options = parse(Recommend, args, "recommend")
    from deadreckon.report import recommended
    from deadreckon.runs.durations import in_words, seconds_of
    from deadreckon.runs.settings import RecommendSettings

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
    outcome(f"\n{result}\n{usage(result.results, [])}")
    outcome(f"took {in_words(result.seconds)} of {options.budget}; report: {result.path / recommended.PAGE}")
    if result.failed:
        raise SystemExit(1)
