"""Baselines for designers: the best designs of the data, unchanged or with small errors, and random designs."""

from typing import ClassVar

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.batch import batch
from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.effects import keeping, on_steps
from deadreckon.training.hyperparameters import Count, NonNegative, static


class BestOfData(Designer):
    """The designs of the data with the highest scores, unchanged."""

    revision: ClassVar[int] = 1
    equal_rows: ClassVar[bool] = False  # nothing is fitted
    from_data: ClassVar[bool] = True

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """The best designs that satisfy the rules, the same for every seed.

        Raises:
            UserError: the data has fewer such designs than requested.
        """
        data, n = setting.data, setting.n
        rows = data.best(len(data))
        # The same check as on the page: decimals of a table are rounded, so 0.33, 0.33 and 0.33 count as a mixture.
        rows = (rows if data.repair.free else rows[(keeping(data) & on_steps(data))[rows]])[:n]
        if n > len(rows):
            within = "" if data.repair.free else " that satisfy the rules"
            raise UserError(f"{data.name} has {len(rows):,} designs{within}, fewer than the {n:,} asked for")
        nan = np.full(n, np.nan)  # the standard deviation of a new measurement is not known
        return [Proposals(self.label, data.x[rows], data.y[rows], nan, seed, measured=True) for seed in setting.seeds]


class Jitter(Designer):
    """The best designs of the data with small normal perturbations: a search near them without a model."""

    revision: ClassVar[int] = 1
    equal_rows: ClassVar[bool] = False  # nothing is fitted

    best: Count = static(12)  # number of best designs of the data that are perturbed
    scale: NonNegative = 0.03  # standard deviation of the perturbations, in standard deviations of each variable

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """One draw per seed; the best designs are perturbed in turn."""
        data, view = setting.data, setting.data.coordinates
        z = view.encode(data.x[np.resize(data.best(min(self.best, len(data))), setting.n)])
        draws = [np.random.default_rng(seed).standard_normal(z.shape) for seed in setting.seeds]
        low, high = view.bounds
        return [self.decoded(setting, seed, np.clip(z + self.scale * d, low, high)) for seed, d in zip(setting.seeds, draws)]


class Random(Designer):
    """Random designs: each variable is drawn independently and uniformly, numbers within their bounds or the data's range."""

    revision: ClassVar[int] = 1
    equal_rows: ClassVar[bool] = False  # nothing is fitted

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """One draw per seed."""
        data, found = setting.data, []
        nan = np.full(setting.n, np.nan)
        for seed in setting.seeds:
            rng = np.random.default_rng(seed)
            columns: list[np.ndarray] = []
            for v, seen in zip(data.variables, data.x.T):
                low, high = (v.low if np.isfinite(v.low) else seen.min()), (v.high if np.isfinite(v.high) else seen.max())
                if v.kind == "continuous":
                    columns.append(rng.uniform(low, high, setting.n))
                else:
                    first, last = (0, len(v.levels) - 1) if v.leveled else (int(low), int(high))
                    columns.append(rng.integers(first, last + 1, setting.n))
            x = np.stack(columns, 1).astype(np.float32)
            x = batch(data, x, setting.n, repeat=setting.repeat, seed=seed) if setting.distinct else x
            found.append(Proposals(self.label, x, nan, nan, seed))
        return found
