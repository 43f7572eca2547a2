"""Calibration of a model's predictions on held-out designs.

From predictions m with standard deviations s out of fold, and the scores y that were observed, a new score is said to be

    a + b m, with the standard deviation  c max(sqrt(w s^2 + (1 - w) h^2), s).

a and b are the regression of y on m, each row weighted by 1 / s^2, with b kept between 0, where predictions say nothing, and 1.
h^2 is the harmonic mean of all s^2, and so goes with the variance of y around it, weighted alike. A model that has taken noise
for signal is surest beside the rows that it has seen, and what it proposes lies beside those that were lucky: of its own
variances, which say where it is surer, only the share w is taken: a half, and none where its order may be chance. c makes
intervals of 1.96 c sqrt(w s^2 + (1 - w) h^2) hold 95 % of the scores, from errors as if the regression had not seen their rows
(after split conformal prediction, with the correction for few rows; Lei et al. 2018). Of fewer than 19 rows it is the greatest
error, which holds n of n + 1 new ones. Where the model is less sure than usual, as far from the data, its own deviation counts
in full beside that (but not where w is zero): intervals there are wider, and c is the same.
"""

from dataclasses import dataclass

import numpy as np

from deadreckon.stats.interval import LEVEL, NORMAL

OWN = 0.5  # w of a model whose order of designs is distinguishable from chance


@dataclass(frozen=True)
class Calibration:
    """How scores follow from predictions.

    Attributes:
        a, b: of the mean a + b m.
        scale: on the model's own deviations, c sqrt(w); 0: none of them counts.
        scatter: the part of the deviation that is the same for all, c h sqrt(1 - w).
    """

    a: float
    b: float
    scale: float
    scatter: float

    @classmethod
    def of(
        cls, y: np.ndarray, mean: np.ndarray, std: np.ndarray, *, skilled: bool, independent: int | None = None
    ) -> "Calibration":
        """From (rows,) scores, and means and deviations that were predicted without them; `independent`: how many of the rows
        are, if not all."""
        std = np.maximum(std, 1e-12 * (y.std() or 1.0))  # in whatever unit the scores are
        weight = np.square(std.min() / std)
        common = float(std.min() / weight.mean() ** 0.5)
        weight /= weight.sum()
        off = mean - weight @ mean
        spread = float(weight @ np.square(off)) if np.ptp(mean) > 0 else 0.0
        b = float(np.clip(weight * off @ y / spread, 0.0, 1.0)) if spread else 0.0
        a = float(weight @ (y - b * mean))
        seen = weight * (1.0 + (np.square(off) / spread if 0.0 < b < 1.0 else 0.0))  # how much a row's error is pulled to 0
        error = np.abs(y - a - b * mean) / np.maximum(1.0 - seen, 1e-6)
        own = OWN if skilled else 0.0
        scale, scatter = own**0.5, (1.0 - own) ** 0.5 * common
        factor = conformal_factor(error / np.hypot(scale * std, scatter), independent=independent)
        return cls(a, b, factor * scale, factor * scatter)

    def __call__(self, mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) means and deviations of new scores, from (m,) predictions and their deviations."""
        return self.a + self.b * mean, np.maximum(np.hypot(self.scale * std, self.scatter), self.scale / OWN**0.5 * std)

    def of_one(self, mean: np.ndarray, std: np.ndarray, beyond: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of single measurements, whose noise goes `beyond` that of the rows that calibrate: means, deviations, and by what the
        deviations of a row were multiplied."""
        row = np.sqrt(np.maximum(np.square(std) - beyond**2, 0.0))
        mean, found = self(mean, row)
        return mean, np.hypot(found, beyond), found / row

    def of_true(self, mean: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means of true scores, and how far they are off, of any shapes, where the model says that they are `off`.

        All of the model's own deviations count, as large as its errors out of fold were: what is the same for all is the noise
        of scores too. Where nothing of them is kept, they are as the model has them.
        """
        return self.a + self.b * mean, (self.scale / OWN**0.5 or 1.0) * off


def conformal_factor(error: np.ndarray, share: float = LEVEL, independent: int | None = None) -> float:
    """The factor on deviations with which intervals hold a share of the scaled errors, with the finite-sample correction of so
    many independent ones; None: all are."""
    n = len(error) if independent is None else independent
    rank = min(int(np.ceil((n + 1) * share)), n)
    rank = rank if n == len(error) else int(np.ceil(rank / n * len(error)))
    return float(np.sort(error)[rank - 1] / NORMAL)
