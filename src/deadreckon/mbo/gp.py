"""A Gaussian process for tables of experiments, and a batch of designs that it predicts high scores for.

The process is that of `mbo.process`. The criterion m + kappa s is maximised from designs of the data and from random ones, by
random changes and gradient steps that are kept within all rules. The batch is chosen greedily: each design given those before
it, at a least distance from them. The scores of these are set to their predicted means, which changes only s (the kriging
believer of Ginsbourger et al. 2010).
"""

from typing import Annotated, ClassVar

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.batch import batch, moved, untried
from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.forward import on_held_out
from deadreckon.mbo.local_search import improved
from deadreckon.mbo.process import Process, fit
from deadreckon.mbo.validation import Predict, Quality, checkable, cross_validated, folds_of
from deadreckon.mbo.variables import FEWEST
from deadreckon.randomness import generator
from deadreckon.training.hyperparameters import Count, CountOrZero, Number, Range, host

KEPT = 128  # least number of designs that a search keeps
DRAWN = 512  # number of random designs at its start


class GP(Designer):
    """The greatest predicted scores under a Gaussian process with a length scale for each variable, also for categories."""

    revision: ClassVar[int] = 6
    equal_rows: ClassVar[bool] = False

    kappa: Number = host(0.0)
    """standard deviations added to the prediction: below 0 cautious (lower confidence bound), above 0 bold (upper one)"""
    max_rows: Annotated[int, Range(ge=FEWEST)] = host(3000)
    """largest number of designs in the fit: half the best ones, half drawn from the rest"""
    fit_rows: Count = host(400)  # largest number of designs on which the hyperparameters are fitted
    rounds: Count = host(40)  # rounds of the search
    folds: CountOrZero = host(5)
    """folds of the cross-validation that calibrates intervals; 0: none; beyond `max_rows` designs a fifth is held out once"""

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "GP"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """One process for all seeds, which differ only in the random search.

        Raises:
            UserError: a single fold.
        """
        if self.folds == 1:
            raise UserError("GP.folds must be 0, for no cross-validation, or 2 or more, got 1")
        process, quality = fit(self.used(setting.data), rows=self.fit_rows), self.quality(setting)
        found = []
        for seed in setting.seeds:
            pool = search(setting.data, process, self.kappa, self.rounds, max(KEPT, 4 * setting.n), seed)
            if setting.distinct and not setting.repeat:
                pool = untried(setting.data, pool, setting.n)
            order = greedy(process, pool, self.kappa, 2 * setting.n)
            if setting.distinct:
                score = lambda x: sum_of(process, x, self.kappa)  # noqa: E731
                x = batch(setting.data, pool[order], setting.n, score, repeat=setting.repeat, seed=seed)
            else:
                x = np.resize(pool[order], (setting.n, pool.shape[1])).astype(np.float32)
            mean, std = process.posterior(x)
            # The calibration is for the standard deviation of a row, noise included, and not for that of the true score.
            measured = np.hypot(std, process.noise)
            fitted = Fitted(process.measured, process.averages)
            made = Proposals(self.label, x, mean, measured, seed, fitted=fitted, mean_std=std, beyond=process.beyond)
            found.append(made.calibrated(quality) if quality else made)
        return found

    def used(self, data: Designs) -> Designs:
        """The designs in the fit: all, or `max_rows` of them (`Designs.best_and_others`)."""
        rows = data.best_and_others(self.max_rows, generator(0, "rows of the process"))
        return data if len(rows) == len(data) else data.part(rows)

    def quality(self, setting: DesignInput) -> Quality | None:
        """The quality of its predictions; None if it is not tested, or if there are too few designs.

        If not all designs are in the fit, half of those that are were selected by their scores, and thus partly by their noise,
        which would bias a cross-validation. The method is then tested on held-out designs drawn from all.
        """
        data = setting.data
        if self.folds < 2:
            return None
        if len(data) > self.max_rows:
            return on_held_out(self, setting)
        if not checkable(data):
            return None
        setting.watch("cross-validation", 0, folds_of(data, self.folds))
        return cross_validated(data, self.predictor, self.label, self.folds)

    def unseen(self, setting: DesignInput, x: np.ndarray, error: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(m,) predicted means and standard deviations, noise included, of scores of other designs with standard errors `error`
        (m,)."""
        setting.watch("held-out", 0, 1)
        return self.predictor(self.used(setting.data))(x, error)

    def predictor(self, data: Designs) -> Predict:
        """A function that predicts means and standard deviations of scores, noise included, by a process fitted to `data`."""
        process = fit(data, rows=self.fit_rows)

        def predict(x: np.ndarray, error: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
            mean, std = process.posterior(x)
            return mean, np.hypot(std, process.noise if error is None else process.noise_of(error))

        return predict


def sum_of(process: Process, x: np.ndarray, kappa: float) -> np.ndarray:
    """(m,) mean + kappa x standard deviation of designs."""
    if not kappa:
        return process.mean(x)
    mean, std = process.posterior(x)
    return mean + kappa * std


def search(data: Designs, process: Process, kappa: float, rounds: int, kept: int, seed: int) -> np.ndarray:
    """(kept, variables) or fewer different designs with great m + kappa s, the greatest first, that satisfy the rules."""
    rng = generator(seed, "search of designs")
    start = data.x[rng.integers(len(data), size=DRAWN)]
    x = np.concatenate([data.x[data.best(min(len(data), 64))], moved(data, start, 1.0, rng), start[:64]])
    uphill = lambda x: _uphill(data, process, x, kappa, rng)  # noqa: E731
    return improved(data, x, lambda x: sum_of(process, x, kappa), rounds, kept, rng, uphill)


def _uphill(data: Designs, process: Process, x: np.ndarray, kappa: float, rng: np.random.Generator) -> np.ndarray:
    """A gradient step of random length of each design, in its numbers."""
    view = data.coordinates
    count = len(view.numeric)
    if not count:
        return x[:0]
    slope = process.slope(x, kappa)[:, :count]
    length = 10.0 ** rng.uniform(-3.0, 0.3, len(x))[:, None]
    z = view.encode(x).astype(np.float64)
    z[:, :count] += length * slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
    return view.decode(z).astype(np.float64)


def greedy(process: Process, x: np.ndarray, kappa: float, n: int) -> np.ndarray:
    """(n,) or fewer rows of `x` in the order in which they are chosen: each has the greatest m + kappa s given those before."""
    mean = process.mean(x) / process.y_std
    if not kappa:
        return np.argsort(-mean, kind="stable")[:n]
    covariance, order = process.covariance(x), []
    noise = (process.noise / process.y_std) ** 2
    for _ in range(min(n, len(x))):
        value = mean + kappa * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        value[order] = -np.inf
        i = int(value.argmax())
        order.append(i)
        covariance = covariance - np.outer(covariance[i], covariance[i]) / (covariance[i, i] + noise + 1e-9)
    return np.array(order)
