"""Validation of models of the score on designs that they were not fitted to, and calibration of their intervals.

Folds consist of whole units: designs, recipes of nearly equal designs, or groups such as batches (`Designs.units`). The
calibration (`mbo.calibration`) is fitted to out-of-fold predictions. The scores are measurements, so standard deviations must
be those of a measurement, noise included, and calibrated intervals are for a new measurement: true scores are never observed.
Coverage is cross-fitted: each fold is evaluated with the calibration of the other folds.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from deadreckon.mbo.calibration import Calibration
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.replicates import row_weights
from deadreckon.mbo.variables import FEWEST
from deadreckon.randomness import generator
from deadreckon.stats.clusters import effective
from deadreckon.stats.interval import LEVEL, NORMAL
from deadreckon.stats.ranks import spearman

FOLDS = 5
CHANCE = 0.025  # share of tables without any relation on which a method may be called skilled, by its order
CLOSE, PERMUTATIONS = 0.001, 2_000  # the same share by the predictions themselves, and the number of their permutations
ENOUGH = 2 * FEWEST  # least number of held-out designs: with fewer than 19 no factor covers 95 % (`conformal_factor`)

# (m, variables) designs and (m,) standard errors of their scores, or None -> (m,) means and standard deviations of the scores
Predict = Callable[[np.ndarray, np.ndarray | None], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Quality:
    """The quality of out-of-fold predictions.

    Attributes:
        method: name of the model.
        observed, predicted, std: (rows,) scores, and their out-of-fold predictions and standard deviations, not calibrated.
        r2: share of the scores' variance that is explained; below 0 if the mean would be better; 0 if all scores are the same;
            NaN, like `coverage`, if the model predicts only an order.
        rank_correlation: Spearman's.
        fold: (rows,) number of the fold in which each was predicted.
        tried: number of methods that were compared, including this one.
        crossed: whether the models of all other folds were fitted to each row, as in cross-validation.
        scored: whether the model predicts scores, and not only their order.
        units: (rows,) number of the unit that each row was held out with (`Designs.units`), whose rows are not independent;
            None: each row is one.
        weight: (rows,) weights of the rows in R2 (`replicates.row_weights`); None: equal weights.
        rows: (rows,) rows of the designs that were predicted; None: all.
    """

    method: str
    observed: np.ndarray
    predicted: np.ndarray
    std: np.ndarray
    r2: float
    rank_correlation: float
    fold: np.ndarray
    tried: int = 1
    crossed: bool = False
    scored: bool = True
    units: np.ndarray | None = None
    weight: np.ndarray | None = None
    rows: np.ndarray | None = None

    @property
    def skilled(self) -> bool:
        """Whether the rank correlation is above what chance gives in 97.5 % of tables without any relation (Fieller 1957), or
        predictions are closer to scores than 99.9 % of their permutations, as where most scores are nearly equal, whose order
        is noise.

        In cross-validation a pair of rows that agree by chance counts twice, since each helps to predict the other: the
        variance of the correlation is then up to twice that of rows to which no model was fitted. Predictions of scores must
        also have a positive covariance with them.
        """
        if not self.scored:
            return self.rank_correlation > self.limit
        # A single wrong score can make the covariance negative.
        worth = np.cov(self.predicted, self.observed, aweights=self.weight)[0, 1] > 0
        return bool(worth and (self.rank_correlation > self.limit or self._close))

    @cached_property
    def _close(self) -> bool:
        """Whether the covariance of predictions with scores is above the quantile 1 - `CLOSE` of that of their permutations,
        which is widened for the number of methods and, in cross-validation, as `limit` is."""
        rows = self._worth(np.ones(len(self.observed), bool), self.predicted, self.observed)
        weight = np.ones(len(self.observed)) if self.weight is None else self.weight
        off, apart = (np.asarray(each - np.average(each, weights=weight), float) for each in (self.predicted, self.observed))
        if rows < 5 or not np.ptp(off) or not np.ptp(apart):
            return False
        rng, pull = generator(0, "predictions"), weight * apart
        chance = np.sort([off[rng.permutation(len(off))] @ pull for _ in range(PERMUTATIONS)])
        quantiles = [NormalDist().inv_cdf(1 - CLOSE / among) for among in (1, self.tried)]
        wider = quantiles[1] / quantiles[0] * np.sqrt((2.0 if self.crossed else 1.0) * len(off) / rows)
        return bool(off @ pull > wider * chance[int((1 - CLOSE) * PERMUTATIONS)])

    @property
    def limit(self) -> float:
        """The rank correlation that chance alone does not exceed in 97.5 % of tables without any relation."""
        quantile = NormalDist().inv_cdf(1 - CHANCE / self.tried)  # the best of several is greater by chance (Bonferroni)
        rows = self._worth(np.ones(len(self.observed), bool), self.predicted, self.observed)
        if rows < 5:  # any order of four is the right one in more than 2.5 % of tables
            return 1.0
        variance = (2.12 if self.crossed else 1.06) / (rows - 3)
        return float(np.tanh(quantile * variance**0.5))

    @cached_property
    def calibration(self) -> Calibration | None:
        """The calibration of the predictions; None if the model predicts only an order."""
        return self._calibration(np.ones(len(self.observed), bool)) if self.scored else None

    @cached_property
    def corrected(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows,) calibrated out-of-fold predictions and standard deviations, by the calibration of the proposals."""
        return (self.predicted, self.std) if self.calibration is None else self.calibration(self.predicted, self.std)

    @cached_property
    def crosswise(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows,) the same by the calibration of all other folds, which is independent of the row itself."""
        if not self.scored:
            return self.corrected
        mean, std = np.empty(len(self.observed)), np.empty(len(self.observed))
        for k in np.unique(self.fold):
            held = self.fold == k
            mean[held], std[held] = self._calibration(~held)(self.predicted[held], self.std[held])
        return mean, std

    @cached_property
    def coverage(self) -> float:
        """Share of scores within the 95 % intervals of `crosswise`; NaN if the model predicts only an order."""
        mean, std = self.crosswise
        return float((np.abs(self.observed - mean) <= NORMAL * std).mean()) if self.scored else np.nan

    def _calibration(self, rows: np.ndarray) -> Calibration:
        given = self.observed[rows], self.predicted[rows], self.std[rows]
        count = int(self._worth(rows, self.observed - self.predicted))
        return Calibration.of(*given, skilled=self.skilled, independent=count)

    def _worth(self, rows: np.ndarray, *values: np.ndarray) -> float:
        """Effective number of independent rows among `rows` (rows,), for a statistic of one or two lists of values (rows,)."""
        return float(rows.sum()) if self.units is None else effective(self.units[rows], *(each[rows] for each in values))

    @property
    def doubt(self) -> str:
        """Why a model without skill is not trusted, in words, by its predictions of held-out rows."""
        if self.rank_correlation > self.limit:
            return "its predictions of unseen rows do not go with their scores, of which one may be an error"
        return "the model's order of unseen rows cannot be distinguished from chance"

    @property
    def warning(self) -> str | None:
        """A warning to read before the proposals are tried; None if there is none."""
        if self.skilled:
            return None
        if self.rank_correlation > self.limit:
            return "predictions of unseen designs do not go with their scores, but their order does: one score may be an error"
        return (
            "the model's order of unseen designs cannot be distinguished from chance (rank correlation "
            f"{self.rank_correlation:.2f}; with {len(self.observed):,} designs chance alone gives up to {self.limit:.2f}); "
            "its proposals may be worthless"
        )

    def __str__(self) -> str:
        if not self.scored:
            return f"{self.method} out of fold: rank correlation {self.rank_correlation:.2f} (it predicts an order, not scores)"
        return (
            f"{self.method} out of fold: R2 {self.r2:.2f}, rank correlation {self.rank_correlation:.2f}, "
            f"{self.coverage:.0%} of scores in the {LEVEL:.0%} interval"
        )


def checkable(data: Designs) -> bool:
    """Whether a table can be cross-validated: no two rows have the same design, and there are enough recipes.

    Whichever unit is held out, at least `FEWEST` recipes must be left for the fit. Replicates that were not pooled
    (`mbo.replicates`), like those of fewer than `FEWEST` designs, are not separate designs.
    """
    parts = _recipes_of_units(data)
    return len(np.unique(data.x, axis=0)) == len(data) and len(parts) > 1 and parts.sum() - parts.max() >= FEWEST


def held_out(data: Designs, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """A random split: held-out rows, all other rows, and the fold, 0 or 1, of each held-out row, for `Quality.crosswise`.

    Held out are two whole units or more, with about a fifth of all recipes, at least `ENOUGH` and at most `most` (unless units
    are large). At least `ENOUGH` recipes are left for the fit. None if there are too few.
    """
    parts = _recipes_of_units(data)
    place = generator(0, "held-out designs").permutation(len(parts)).argsort()
    wanted, spare = min(max(parts.sum() // 5, ENOUGH), most), parts.sum() - ENOUGH
    taken, held = 0, []
    for unit in place.argsort():
        if (taken < wanted or len(held) < 2) and taken + parts[unit] <= spare:
            taken += parts[unit]
            held.append(unit)
    if taken < ENOUGH or len(held) < 2 or len(np.unique(data.x, axis=0)) < len(data):
        return None
    rank = np.full(len(parts), -1)
    rank[held] = np.arange(len(held))
    order = np.argsort(place[data.units], kind="stable")
    inside = rank[data.units[order]] >= 0
    return order[inside], order[~inside], rank[data.units[order[inside]]] % 2


def _recipes_of_units(data: Designs) -> np.ndarray:
    """(units,) number of recipes in each unit."""
    return np.bincount(np.unique(np.stack([data.units, data.recipes], 1), axis=0)[:, 0])


def cross_validated(data: Designs, model: Callable[[Designs], Predict], method: str, folds: int = FOLDS) -> Quality:
    """Cross-validation: each fold is predicted by a model that is fitted to all others.

    Args:
        data: scored designs, all different, of which there are enough (`checkable`).
        model: function that fits designs and returns the predictor.
        method: name of the model.
        folds: number of folds; with fewer than `ENOUGH` units each unit is one.
    """
    folds, count = folds_of(data, folds), data.units.max() + 1
    fold = (generator(0, "folds of designs").permutation(count) % folds)[data.units]
    mean, std = np.empty(len(data)), np.empty(len(data))
    for k in range(folds):
        mean[fold == k], std[fold == k] = unseen(data, np.flatnonzero(fold == k), np.flatnonzero(fold != k), model)
    return replace(judged(data.y, mean, std, fold, method, weight=row_weights(data)), crossed=True, units=data.units)


def folds_of(data: Designs, folds: int) -> int:
    """The number of folds; with fewer than `ENOUGH` units each unit is one."""
    count = int(data.units.max()) + 1
    return folds if count >= ENOUGH else count


def unseen(
    data: Designs, held: np.ndarray, rest: np.ndarray, model: Callable[[Designs], Predict]
) -> tuple[np.ndarray, np.ndarray]:
    """(held,) predicted means and standard deviations of the scores of some rows, by a model fitted to the others."""
    # No model can be fitted to rows whose scores or designs are all the same.
    if np.ptp(data.y[rest]) == 0 or not np.ptp(data.x[rest], axis=0).any():
        return np.full(len(held), data.y[rest].mean()), np.full(len(held), data.y.std())
    error = None if data.std_error is None else data.std_error[held]
    return model(data.part(rest))(data.x[held], error)


def judged(
    y: np.ndarray, mean: np.ndarray, std: np.ndarray, fold: np.ndarray, method: str, scored: bool = True,
    weight: np.ndarray | None = None,
) -> Quality:  # fmt: skip
    """The quality of out-of-fold predictions, from (rows,) scores, means, standard deviations, folds and weights; see
    `Quality`."""
    rank = spearman(y, mean)
    if not scored:
        return Quality(method, y, mean, std, np.nan, rank, fold, scored=False, weight=weight)
    off, spread = (np.average(np.square(y - of), weights=weight) for of in (mean, np.average(y, weights=weight)))
    return Quality(method, y, mean, std, 0.0 if np.ptp(y) == 0 else float(1 - off / spread), rank, fold, weight=weight)
