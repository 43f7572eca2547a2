"""How often a mistake in a table of experiments is told, and how often a message is about a table without one.

    python -m benchmarks.design_messages [TABLES]

Tables of 60 or 80 rows, each with one mistake or none: runs that failed and have no score, where two inputs are large or at
random; one score that is twice the right one; scores with relative errors; an input that three others determine, and which was
measured; a concentration over six decades; scores that were cut off; days whose settings and scores are alike. Messages are
those of `design` with a Gaussian process and eight proposals. Printed are the shares of tables with each message.
"""

import sys
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from deadreckon.mbo import designer
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.misfits import misfits_told
from deadreckon.mbo.unscored import unscored_told
from deadreckon.text_table import table

MESSAGES = {
    "failed": "where rows without", "row": "where the other rows predict", "errors": "grow with the predictions",
    "input": "predicted by the other inputs", "log": "evenly in its logarithm", "limit": "if it is a limit",
    "group": "is ignored and has",
}  # fmt: skip
Columns = dict[str, Any]


def _inputs(rng: np.random.Generator, rows: int, count: int) -> Columns:
    return {f"x{i}": rng.random(rows) for i in range(count)}


def smooth(rng: np.random.Generator, rows: int = 60) -> Columns:
    """A line and a bowl, with noise."""
    x = _inputs(rng, rows, 3)
    return x | {"y": 40 + 20 * x["x0"] - 30 * (x["x1"] - 0.5) ** 2 + 2 * rng.standard_normal(rows)}


def failed(rng: np.random.Generator, limit: float = 1.3, at_random: float = 0.0) -> Columns:
    """Scores that rise up to where runs fail, which have none."""
    x = _inputs(rng, 80, 4)
    y = 40 + 20 * x["x0"] + 20 * x["x1"] + 10 * x["x2"] + 1.5 * rng.standard_normal(80)
    return x | {"y": np.where((x["x0"] + x["x1"] > limit) | (rng.random(80) < at_random), np.nan, y)}


def doubled(rng: np.random.Generator) -> Columns:
    """One score is twice the right one."""
    columns = smooth(rng)
    columns["y"][rng.integers(60)] *= 2
    return columns


def relative(rng: np.random.Generator) -> Columns:
    """Errors of a fifth of the score."""
    x = _inputs(rng, 60, 4)
    right = np.exp(3 * (x["x0"] - 2 * (x["x1"] - 0.5) ** 2 + 0.5 * x["x2"]))
    return x | {"y": right * np.exp(0.2 * rng.standard_normal(60))}


def measured(rng: np.random.Generator, noise: float = 0.1) -> Columns:
    """A pH that settings determine, but for noise, beside a score that follows it."""
    x = _inputs(rng, 60, 3)
    ph = 5 + np.sin(2.5 * x["x0"]) * (0.5 + x["x1"]) - x["x2"] ** 2 + noise * rng.standard_normal(60)
    return x | {"ph": ph, "y": 10 * (ph - 5) + 2 * rng.standard_normal(60)}


def decades(rng: np.random.Generator, least: float = -6.0) -> Columns:
    """A concentration with an optimum on a log scale."""
    x = _inputs(rng, 60, 2) | {"conc": 10 ** rng.uniform(least, 0, 60)}
    return x | {"y": x["x0"] - (np.log10(x["conc"]) - least / 2) ** 2 / 2 + 0.3 * rng.standard_normal(60)}


def cut_off(rng: np.random.Generator) -> Columns:
    """Scores up to 100."""
    x = _inputs(rng, 60, 3)
    return x | {"y": np.minimum(70 + 25 * x["x0"] + 20 * x["x1"] + 2 * rng.standard_normal(60), 100.0)}


def days(rng: np.random.Generator) -> Columns:
    """Eight days with settings, and a shift of the score, of their own; the day is ignored."""
    day, mixed = np.repeat(np.arange(8), 6), rng.permutation(48)
    x = (rng.random((8, 3))[day] + 0.1 * rng.standard_normal((48, 3)))[mixed]
    y = (rng.standard_normal(8)[day] + 0.3 * rng.standard_normal(48))[mixed]
    return dict(zip(["x0", "x1", "x2"], x.T)) | {"date": [f"2024-03-{1 + each:02d}" for each in day[mixed]], "y": y}


def cliff(rng: np.random.Generator) -> Columns:
    """A step, which a model smooths."""
    x = _inputs(rng, 60, 3)
    return x | {"y": np.where(x["x0"] > 0.5, 10.0, 0.0) + 0.3 * rng.standard_normal(60)}


def searched(rng: np.random.Generator) -> Columns:
    """Settings that an earlier search has changed together."""
    x = 0.5 + 0.1 * rng.standard_normal((60, 1)) * [1, -1, 0.5] + 0.1 * rng.standard_normal((60, 3))
    return dict(zip(["x0", "x1", "x2"], x.T)) | {"y": x.sum(1) + 0.1 * rng.standard_normal(60)}


def tails(rng: np.random.Generator) -> Columns:
    """Noise with long tails."""
    x = _inputs(rng, 60, 3)
    return x | {"y": 40 + 20 * x["x0"] + 2 * rng.standard_t(3, 60)}


TABLES: dict[str, Callable[[np.random.Generator], Columns]] = {
    "runs failed where two inputs are large (26 %)": failed,
    "the same (5 %)": lambda rng: failed(rng, 1.7),
    "one score is twice the right one": doubled,
    "relative errors": relative,
    "an input is measured": measured,
    "an input over six decades": decades,
    "scores are cut off at 100": cut_off,
    "days alike, and ignored": days,
    "none": smooth,
    "none: scores missing at random (25 %)": lambda rng: failed(rng, 9.0, 0.25),
    "none: no noise": lambda rng: (x := _inputs(rng, 60, 3)) | {"y": -sum(np.square(each - 0.4) for each in x.values())},
    "none: noise alone": lambda rng: _inputs(rng, 60, 4) | {"y": 10 + rng.standard_normal(60)},
    "none: a cliff": cliff,
    "none: long tails": tails,
    "none: an input that others determine in part": lambda rng: measured(rng, 1.0),
    "none: an input over two decades": lambda rng: decades(rng, -2.0),
    "none: settings changed together": searched,
}


def told(columns: Columns) -> set[str]:
    """Which of `MESSAGES` there are about a table."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = Designs.from_frame(columns, "y", ignore=["date"] if "date" in columns else [])
    made = designer("gp").propose(data, 8)
    lines = [*(str(each.message) for each in caught), *misfits_told(data, made.quality), *unscored_told(data, made.x)]
    return {name for name, part in MESSAGES.items() if any(part in line for line in lines)}


def main(count: int = 40) -> None:
    """Prints the table."""
    rows = [["mistake", *MESSAGES]]
    for number, (name, make) in enumerate(TABLES.items()):
        found = Counter(each for seed in range(count) for each in told(make(np.random.default_rng([number, seed]))))
        rows.append([name, *(f"{100 * found[each] / count:.0f} %" if found[each] else "" for each in MESSAGES)])
    print(table(rows))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
