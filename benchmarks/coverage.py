"""How often the intervals of evaluations and suites cover the true mean, of returns that are normal and that are not.

    python benchmarks/coverage.py

Draws 4,000 times for each cell of three tables: the mean of evaluated policies (`deadreckon evaluate`), the mean of a suite's
seeds (`deadreckon bench`), and a claim whose true gain is its margin (`deadreckon.bench.claims`), which "holds" by chance in
2.5 % of normal runs. Values that are all the same have no interval; how often that is stands in brackets.
"""

from collections.abc import Callable

import numpy as np

from deadreckon.stats.comparison import paired
from deadreckon.stats.crossed import mean_interval
from deadreckon.stats.interval import Interval
from deadreckon.stats.means import student_interval

TIMES = 4_000
Draw = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]
RETURNS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0),
    "log-normal": (lambda rng, shape: rng.lognormal(size=shape), float(np.exp(0.5))),
    "success in half of the episodes": (lambda rng, shape: (rng.random(shape) < 0.5) * 1.0, 0.5),
    "success in one of ten": (lambda rng, shape: (rng.random(shape) < 0.1) * 1.0, 0.1),
    "3,000, and 200 in one of ten": (lambda rng, shape: np.where(rng.random(shape) < 0.1, 200.0, 3_000.0), 2_720.0),
}
RUNS: dict[str, tuple[Draw, float]] = {
    "normal": RETURNS["normal"],
    "normal, one of ten fails": (lambda rng, shape: rng.normal(size=shape) - 10.0 * (rng.random(shape) < 0.1), -1.0),
    "success rates of 10 episodes, 0.5": (lambda rng, shape: rng.binomial(10, 0.5, shape) / 10, 0.5),
    "success rates of 10 episodes, 0.05": (lambda rng, shape: rng.binomial(10, 0.05, shape) / 10, 0.05),
}


def covered(interval: Callable[[np.ndarray], Interval], draw: Draw, truth: float, shape: tuple[int, ...]) -> str:
    """Share of the intervals that cover the truth, of those that there are."""
    rng = np.random.default_rng(0)
    found = [interval(draw(rng, shape)) for _ in range(TIMES)]
    known = [each for each in found if np.isfinite(each.low)]
    share = np.mean([each.low - 1e-9 <= truth <= each.high + 1e-9 for each in known])
    return f"{100 * share:.0f} %" + (f" ({100 - 100 * len(known) / TIMES:.0f} %)" if len(known) < TIMES else "")


def held(draw: Draw, truth: float, logs: int, seeds: int) -> str:
    """Share of the claims that hold where the true gain over a rival with normal runs is the margin."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(TIMES):
        ours = {str(log): draw(rng, (seeds,)) for log in range(logs)}
        rival = {log: rng.normal(0.0, 0.1, seeds) for log in ours}
        count += paired(ours, rival).low > truth
    return f"{100 * count / TIMES:.1f} %"


def table(names: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Prints a table in Markdown."""
    for row in (names, ("---",) * len(names), *rows):
        print("| " + " | ".join(row) + " |")
    print()


def main() -> None:
    """Prints the tables."""
    sizes = ((1, 10), (1, 100), (3, 10), (10, 100))
    heads = tuple(f"{seeds} x {episodes}" for seeds, episodes in sizes)
    rows = [(kind, *(covered(mean_interval, *RETURNS[kind], size) for size in sizes)) for kind in RETURNS]
    table(("returns; policies x episodes", *heads), rows)
    rows = [(kind, *(covered(student_interval, *RUNS[kind], (n,)) for n in (3, 5, 10, 30))) for kind in RUNS]
    table(("scores of runs", "3 seeds", "5", "10", "30"), rows)
    cases = ((1, 3), (3, 3), (3, 5), (3, 10), (3, 30))
    heads = tuple(f"{logs} log{'s' * (logs > 1)}, {seeds} seeds" for logs, seeds in cases)
    rows = [(kind, *(held(*RUNS[kind], *case) for case in cases)) for kind in list(RUNS)[:2]]
    table(("runs of the method", *heads), rows)


if __name__ == "__main__":
    main()
