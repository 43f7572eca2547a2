"""How often the page of `deadreckon design` tells effects of variables from none, where there are none and where there are.

    python -m benchmarks.effects --tables 40
    python -m benchmarks.effects --time          (processor seconds that the page takes for tables of several sizes)

Tables of 60 rows and five numbers, uniform in [-1, 1]. `noise`: scores are standard normal. `signal`: y = 1.5 a - 1.5 b^2 plus
noise of deviation 0.5, so that three of the five do nothing. The model is `gp` with the calibration of its cross-validation.
"""

import argparse
import tempfile
import time

import numpy as np

from deadreckon.mbo import designer, effects, process
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.mbo.registry import sized
from deadreckon.mbo.validation import cross_validated
from deadreckon.report.design import write_design

ROWS, VARIABLES = 60, 5


def table(kind: str, seed: int) -> Designs:
    """One table."""
    rng = np.random.default_rng(seed)
    x, noise = rng.uniform(-1, 1, (ROWS, VARIABLES)), rng.normal(size=ROWS)
    return Designs.from_arrays(x, noise if kind == "noise" else 1.5 * x[:, 0] - 1.5 * x[:, 1] ** 2 + 0.5 * noise)


def told(data: Designs) -> tuple[set[int], bool]:
    """The columns whose effects are distinguishable from zero, and whether the model is told to rank better than chance."""
    found, quality = process.fit(data), cross_validated(data, designer("gp").predictor, "GP")
    shown = effects.averages(data, Fitted(found.posterior, found.averages, quality.calibration))
    return {each.column for each in shown if each.distinct(len(shown))}, quality.skilled


def seconds(method: str, rows: int, variables: int, **fields: int) -> float:
    """Processor seconds of the page alone, of short fits and searches: what a page costs does not depend on these."""
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (rows, variables))
    data = Designs.from_arrays(x, 2 * x[:, 0] - x[:, 1] ** 2 + 0.1 * rng.normal(size=rows))
    made = sized(method, None, "cpu", **fields).propose(data, 32, validate=True)
    far = nn_distance(data, made.x)
    with tempfile.TemporaryDirectory() as folder:
        begun = time.process_time()
        write_design(data, made, far, f"{folder}/report.html")
        return time.process_time() - begun


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=40, help="of each kind")
    parser.add_argument("--time", action="store_true", help="time the page instead")
    asked = parser.parse_args()
    if asked.time:
        print(f"60 rows of 7 variables, gp: {seconds('gp', 60, 7, folds=2, rounds=2):.1f} s")
        print(f"3,000 rows of 20 variables, gp: {seconds('gp', 3000, 20, folds=0, rounds=2):.1f} s")
        print(f"5,000 rows of 10 variables, ensemble: {seconds('ensemble', 5000, 10, steps=300):.1f} s")
        raise SystemExit
    for kind, real in (("noise", set()), ("signal", {0, 1})):
        results = [told(table(kind, 100 + seed)) for seed in range(asked.tables)]
        false = sum(bool(columns - real) for columns, _ in results)
        hit = [sum(column in columns for columns, _ in results) for column in sorted(real)]
        skilled = sum(each for _, each in results)
        praised = sum(bool(columns - real) and each for columns, each in results)
        print(
            f"{kind}: {asked.tables} tables, skilled {skilled}; an effect that is none is significant in {false}, and on "
            f"the page, where the model must be skilled, in {praised}; effects that are there are found in {hit}"
        )
