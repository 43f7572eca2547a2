"""What a batch for two targets is expected to add to the front, and what it adds by the true scores.

    python -m benchmarks.front_gain [TABLES]

Of each table of 60 rows, three inputs and two random smooth targets of standard deviation 1, eight designs are proposed.
Printed are, by the deviation of the noise and as means over ten tables, the gain in hypervolume that is promised, the true one
over the true scores of all rows, and that over those of the rows on the measured front.
"""

import sys

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.front import propose_front
from deadreckon.mbo.hypervolume import hypervolume, non_dominated
from deadreckon.mbo.variables import Variable
from tests.mbo.practice import hill

ROWS, INPUTS, PROPOSED = 60, 3, 8


def gains(seed: int, level: float) -> tuple[float, float, float]:
    """What is promised of one table, and what is true: beside the true scores of all rows, and of those that look best."""
    rng = np.random.default_rng(seed)
    targets, x = [hill(rng, INPUTS) for _ in range(2)], rng.uniform(size=(ROWS, INPUTS))
    variables = [Variable(f"x{i}", low=0.0, high=1.0) for i in range(INPUTS)]
    data = [Designs.from_arrays(x, of(x) + level * rng.standard_normal(ROWS), variables) for of in targets]
    front = propose_front(data, PROPOSED)
    best = x[non_dominated(np.stack([each.y for each in data], 1))]
    true = lambda x: np.stack([of(np.asarray(x, float)) for of in targets], 1)  # noqa: E731
    volume = lambda *parts: hypervolume(np.concatenate([true(part) for part in parts]), front.reference)  # noqa: E731
    over_all, over_best = (volume(rows, front.made[0].x) - volume(rows) for rows in (x, best))
    return front.gain, over_all, over_best


def main(tables: int) -> None:
    """Prints a line a level."""
    for level in (0.1, 0.5, 1.0):
        promised, true, best = np.mean([gains(5000 + seed, level) for seed in range(tables)], 0)
        print(f"noise {level:g}: promised {promised:.2f}, true {true:.2f}, over the measured front {best:.2f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
