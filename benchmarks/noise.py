"""Whether intervals hold new measurements of what is proposed from a table of pure noise.

    python benchmarks/noise.py [TABLES]

Of each of 20 tables of 50 rows, four inputs and scores N(60, 8), the Gaussian process proposes eight designs. Printed is the
share of new measurements at these that lies in the intervals of 95 %: with what is kept of a model without skill, and without.
"""

import sys

import numpy as np
from scipy.stats import norm

from deadreckon.mbo.calibration import conformal_factor
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import interval
from deadreckon.mbo.gp import GP
from deadreckon.mbo.validation import Quality
from deadreckon.mbo.variables import Variable

ROWS, INPUTS, PROPOSED, MEAN, NOISE = 50, 4, 8, 60.0, 8.0


def share(mean: np.ndarray, std: np.ndarray) -> float:
    """Of new measurements in the intervals, in the mean over proposals."""
    low, high = (norm.cdf(end, MEAN, NOISE) for end in interval(mean, std))
    return float((high - low).mean())


def widened(quality: Quality) -> float:
    """The factor with which the model's own deviations hold their share of scores out of fold."""
    return conformal_factor(np.abs(quality.observed - quality.predicted) / quality.std)


def main(tables: int) -> None:
    """Prints both shares, and how many tables were taken for more than noise."""
    variables = [Variable(f"x{i}", low=0.0, high=1.0) for i in range(INPUTS)]
    kept, plain, skilled = [], [], 0
    for seed in range(tables):
        rng = np.random.default_rng(1_000 + seed)
        data = Designs.from_arrays(rng.uniform(size=(ROWS, INPUTS)), rng.normal(MEAN, NOISE, ROWS), variables)
        made = GP().propose(data, PROPOSED)
        bare = GP(folds=0).propose(data, PROPOSED)  # the same designs, as the process itself predicts them
        assert made.quality is not None
        kept.append(share(made.predicted, made.predicted_std))
        plain.append(share(bare.predicted, widened(made.quality) * bare.predicted_std))
        skilled += made.quality.skilled
    for name, shares in (("kept what was worth something", kept), ("as the process predicts", plain)):
        print(f"{name}: {np.mean(shares):.3f} of new measurements, {np.min(shares):.2f} to {np.max(shares):.2f} by table")
    print(f"{skilled} of {tables} tables taken for more than noise")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
