"""How often a model of a table of batches is believed: where scores say nothing but the batch, and where they do.

    python -m benchmarks.batches [TABLES]

Of each table of eight batches of six rows and two inputs, the score is what the batch has in common (a normal number) plus
noise of a tenth; in the second kind also a random smooth function of the inputs of standard deviation 1. Rows of a batch lie
within 0.03 of a point of its own ("apart"), or anywhere ("spread"). Printed are the shares of tables in which the order of
unseen rows is told from chance, and the mean R2, with rows and with batches held out.
"""

import sys
import warnings

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.gp import GP
from deadreckon.mbo.validation import FOLDS, Quality, cross_validated
from deadreckon.mbo.variables import Variable
from tests.mbo.practice import hill

BATCHES, ROWS, INPUTS = 8, 6, 2


def qualities(seed: int, width: float | None, related: bool) -> tuple[Quality, Quality]:
    """Of one table, with rows and with batches held out."""
    rng = np.random.default_rng(seed)
    batch = np.repeat(np.arange(BATCHES), ROWS)
    x = rng.uniform(size=(len(batch), INPUTS))
    if width is not None:
        x = np.clip(rng.uniform(0.1, 0.9, (BATCHES, INPUTS))[batch] + width * rng.standard_normal(x.shape), 0.0, 1.0)
    y = rng.standard_normal(BATCHES)[batch] + 0.1 * rng.standard_normal(len(batch))
    y += hill(rng, INPUTS)(x) if related else 0.0
    variables = tuple(Variable(f"x{i}", low=0.0, high=1.0) for i in range(INPUTS))
    model = GP().predictor
    return tuple(cross_validated(Designs(x, y, variables, groups=groups), model, "GP", FOLDS) for groups in (None, batch))


def main(tables: int) -> None:
    """Prints a line a kind of table."""
    for related in (False, True):
        for name, width in (("apart", 0.03), ("spread", None)):
            found = [qualities(7000 + seed, width, related) for seed in range(tables)]
            kind = "a function of the inputs too" if related else "the batch alone"
            for what, own in zip(("rows", "batches"), zip(*found)):
                share, r2 = np.mean([(each.skilled, each.r2) for each in own], 0)
                print(f"{kind}, {name}, {what} held out: {share:.0%} told from chance, R2 {r2:.2f}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
