"""The usual designer beside scikit-learn's Gaussian process, on six synthetic tables of experiments with their true scores.

    python -m benchmarks.design --seeds 10

Each method proposes 16 designs from the table alone; both are made different and kept within all rules by `mbo.batch`. That of
scikit-learn has a Matern kernel with a length for each coordinate, and proposes the greatest lower confidence bound m - s of
4,000 random designs. What is printed are means over seeds: the best and the median true score, the best of the data and of as
many random designs, the share of new measurements (true scores with the table's noise) within the intervals of 95 %, that of
true scores within the intervals of the mean, and the quality out of fold.
"""

import argparse
import time
import warnings

import numpy as np

from deadreckon.mbo import designer
from deadreckon.mbo.batch import batch, check_batch, moved
from deadreckon.mbo.designs import Designs
from deadreckon.stats.interval import NORMAL
from tests.mbo.practice import TABLES

COUNT = 16


def scikit_learn(data: Designs, seed: int) -> np.ndarray:
    """(COUNT, variables) designs of greatest m - s."""
    from sklearn.gaussian_process import GaussianProcessRegressor, kernels

    view = data.coordinates
    z, y = view.encode(data.x).astype(float), (data.y - view.y_mean) / view.y_std
    shape = kernels.Matern(np.full(view.size, view.size**0.5), (1e-2, 1e3), nu=2.5)
    kernel = kernels.ConstantKernel(1.0) * shape + kernels.WhiteKernel(0.1, (1e-4, 10.0))
    fitted = GaussianProcessRegressor(kernel, random_state=0).fit(z, y)

    def bound(x: np.ndarray) -> np.ndarray:
        mean, std = fitted.predict(view.encode(x), return_std=True)
        return mean - std

    rng = np.random.default_rng([seed, 7])
    x = data.x[rng.integers(len(data), size=4000)]
    x = np.concatenate([moved(data, x[:2000], 1.0, rng), moved(data, x[2000:], 0.1, rng)])
    return batch(data, x[np.argsort(-bound(x))[: 2 * COUNT]], COUNT, bound, seed=seed)


def main() -> None:
    """Prints a row a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--tables", nargs="+", default=list(TABLES))
    parser.add_argument("--apart", type=float, default=None, help="least distance between proposals, in typical distances")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    heads = (
        "table", "gp", "scikit-learn", "random", "data", "measured", "true", "R2", "rank", "out of fold", "broken", "twice",
        "seconds",
    )  # fmt: skip
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for name in asked.tables:
        rows = []
        for seed in range(asked.seeds):
            table = TABLES[name](seed=seed)
            data, begun = table.designs(apart=asked.apart), time.perf_counter()
            made = designer("gp").propose(data, COUNT, seed=seed)
            seconds = time.perf_counter() - begun
            check_batch(data, made.x, repeat=False)
            true, other = table.true(data, made.x), table.true(data, scikit_learn(data, seed))
            drawn = table.true(data, designer("random").propose(data, COUNT, seed=seed).x)
            assert made.quality is not None
            assert made.mean_std is not None
            measured = true + table.noise * np.random.default_rng([seed, 8]).standard_normal(COUNT)
            inside = np.abs(measured - made.predicted) <= NORMAL * made.predicted_std
            known = np.abs(true - made.predicted) <= NORMAL * made.mean_std
            broken, twice = (~data.repair.good(made.x)).sum(), COUNT - len(np.unique(made.x, axis=0))
            rows.append([
                true.max(), np.median(true), other.max(), np.median(other), drawn.max(), np.median(drawn),
                table.true(data, data.x).max(), inside.mean(), known.mean(), made.quality.r2, made.quality.rank_correlation,
                made.quality.coverage, broken, twice, seconds,
            ])  # fmt: skip
        a = np.mean(rows, 0)
        pairs = " | ".join(f"{a[i]:.2f} / {a[i + 1]:.2f}" for i in (0, 2, 4))
        rest = " | ".join(f"{value:.2f}" for value in a[6:12])
        total = np.sum(rows, 0)
        print(f"| {name} | {pairs} | {rest} | {total[12]:.0f} | {total[13]:.0f} | {a[14]:.1f} |", flush=True)


if __name__ == "__main__":
    main()
