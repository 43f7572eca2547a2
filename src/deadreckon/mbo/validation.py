"""How well a model of the score predicts designs that it has not seen, and intervals made to hold their share of these.

Folds are of whole units: designs, recipes of nearly the same, or groups such as batches (`Designs.units`). From predictions out
of fold follows how scores come from them (`mbo.calibration`). The scores are measurements, so deviations must be those of a
measurement, noise included, and what they are calibrated to is an interval for a new measurement: true scores are never seen.
Coverage is reported crosswise: for each fold with the calibration that the others give, so that no design judges itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from deadreckon.mbo.calibration import Calibration
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.variables import FEWEST
from deadreckon.randomness import generator
from deadreckon.stats.clusters import effective
from deadreckon.stats.interval import LEVEL, NORMAL
from deadreckon.stats.ranks import spearman

FOLDS = 5
CHANCE = 0.025  # share of tables without any relation on which a method may be called skilled
ENOUGH = 2 * FEWEST  # designs that are held out at least: of fewer than 19 no factor holds 95 % (`conformal_factor`)

# (m, variables) designs and (m,) standard errors of their scores, or None -> (m,) mean and deviation of these, with noise
Predict = Callable[[np.ndarray, np.ndarray | None], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Quality:
    """Of predictions out of fold.

    Attributes:
        method: the model.
        observed, predicted, std: (rows,) scores, and what was said of them out of fold, before calibration.
        r2: share of the scores' variance that is predicted; below 0 where the mean would be better; 0 of scores that are all
            the same; NaN, as `coverage`, where the model predicts an order alone.
        rank_correlation: Spearman's.
        fold: (rows,) which of them were predicted together.
        tried: how many methods were tried of which this is one.
        crossed: whether each row has taught the models of all other folds, as in cross-validation.
        scored: whether the model predicts scores, and not their order alone.
        units: (rows,) number of what each row was held out with (`Designs.units`): its rows are not independent; None: each row
            by itself.
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

    @property
    def skilled(self) -> bool:
        """Whether the rank correlation is above what chance gives in 97.5 % of tables without any relation (Fieller 1957).

        In cross-validation a pair of rows that agree by chance counts twice, since each predicts the other: the variance of
        the correlation is then up to twice that of rows which taught no model.
        """
        worth = not self.scored or np.cov(self.predicted, self.observed)[0, 1] > 0  # a slip in one score can undo the rest
        return self.rank_correlation > self.limit and worth

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
        """How scores follow from predictions; None where it predicts an order alone."""
        return self._calibration(np.ones(len(self.observed), bool)) if self.scored else None

    @cached_property
    def corrected(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows,) predictions and deviations out of fold as the calibration makes them, which is what proposals have too."""
        return (self.predicted, self.std) if self.calibration is None else self.calibration(self.predicted, self.std)

    @cached_property
    def crosswise(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows,) the same as the calibration of all other folds makes them, so that no row judges itself."""
        if not self.scored:
            return self.corrected
        mean, std = np.empty(len(self.observed)), np.empty(len(self.observed))
        for k in np.unique(self.fold):
            held = self.fold == k
            mean[held], std[held] = self._calibration(~held)(self.predicted[held], self.std[held])
        return mean, std

    @cached_property
    def coverage(self) -> float:
        """Share of scores within the 95 % interval that the other folds calibrate; NaN where it predicts an order alone."""
        mean, std = self.crosswise
        return float((np.abs(self.observed - mean) <= NORMAL * std).mean()) if self.scored else np.nan

    def _calibration(self, rows: np.ndarray) -> Calibration:
        given = self.observed[rows], self.predicted[rows], self.std[rows]
        count = int(self._worth(rows, self.observed - self.predicted))
        return Calibration.of(*given, skilled=self.skilled, independent=count)

    def _worth(self, rows: np.ndarray, *values: np.ndarray) -> float:
        """How many independent rows some rows are worth, for what is said of one or two lists of values."""
        return float(rows.sum()) if self.units is None else effective(self.units[rows], *(each[rows] for each in values))

    @property
    def doubt(self) -> str:
        """Why a model without skill is not believed, of its predictions of rows that it has not seen."""
        if self.rank_correlation > self.limit:
            return "its predictions of unseen rows do not go with their scores, of which one may be an error"
        return "the model's order of unseen rows cannot be distinguished from chance"

    @property
    def warning(self) -> str | None:
        """What should be known before anybody tries the proposals; None where nothing."""
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
    """Whether there are enough recipes to say how well a model predicts those that it has not seen, and no two rows of the same
    design.

    Without any unit that is held out as a whole enough recipes, `FEWEST`, must be left to learn from.

    Replicates that were not pooled (`mbo.replicates`), as those of fewer than `FEWEST` designs, would lie in different folds,
    and a model that has only kept in mind what it has seen would be praised.
    """
    parts = _recipes_of_units(data)
    return len(np.unique(data.x, axis=0)) == len(data) and len(parts) > 1 and parts.sum() - parts.max() >= FEWEST


def held_out(data: Designs, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Rows that are held out, all others, and which of two folds each of the first is in, to judge them crosswise.

    They are two whole units or more by chance, of a fifth of all recipes, but `ENOUGH` at least and `most` at most, or more
    where units are large; `ENOUGH` are left. None where there are too few.
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
    """(units,) how many recipes there are in what is held out as a whole."""
    return np.bincount(np.unique(np.stack([data.units, data.recipes], 1), axis=0)[:, 0])


def cross_validated(data: Designs, model: Callable[[Designs], Predict], method: str, folds: int = FOLDS) -> Quality:
    """Fits a model on all folds but one, predicts that one, and so on.

    Args:
        data: scored designs, all different, of which there are enough (`checkable`).
        model: fits designs.
        method: its name.
        folds: how many; of fewer than `ENOUGH` units each is left out by itself.
    """
    folds, count = folds_of(data, folds), data.units.max() + 1
    fold = (generator(0, "folds of designs").permutation(count) % folds)[data.units]
    mean, std = np.empty(len(data)), np.empty(len(data))
    for k in range(folds):
        mean[fold == k], std[fold == k] = unseen(data, np.flatnonzero(fold == k), np.flatnonzero(fold != k), model)
    return replace(judged(data.y, mean, std, fold, method), crossed=True, units=data.units)


def folds_of(data: Designs, folds: int) -> int:
    """How many folds there are: of fewer than `ENOUGH` units each is one."""
    count = int(data.units.max()) + 1
    return folds if count >= ENOUGH else count


def unseen(
    data: Designs, held: np.ndarray, rest: np.ndarray, model: Callable[[Designs], Predict]
) -> tuple[np.ndarray, np.ndarray]:
    """(held,) means and deviations of the scores of some rows, by a model that was fitted to others."""
    # Rows whose scores or designs are all the same teach nothing.
    if np.ptp(data.y[rest]) == 0 or not np.ptp(data.x[rest], axis=0).any():
        return np.full(len(held), data.y[rest].mean()), np.full(len(held), data.y.std())
    error = None if data.std_error is None else data.std_error[held]
    return model(data.part(rest))(data.x[held], error)


def judged(y: np.ndarray, mean: np.ndarray, std: np.ndarray, fold: np.ndarray, method: str, scored: bool = True) -> Quality:
    """What predictions out of fold are worth: (rows,) scores, means, deviations and folds; `scored`: they are no mere order."""
    rank = spearman(y, mean)
    if not scored:
        return Quality(method, y, mean, std, np.nan, rank, fold, scored=False)
    r2 = 0.0 if np.ptp(y) == 0 else float(1 - np.square(y - mean).sum() / np.square(y - y.mean()).sum())
    return Quality(method, y, mean, std, r2, rank, fold)
