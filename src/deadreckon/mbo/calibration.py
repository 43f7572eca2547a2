"""What a model's predictions are worth on designs that it has not seen.

From predictions m with standard deviations s out of fold, and the scores y that were observed, a new score is said to be

    a + b m, with the standard deviation  u = c sqrt(w (k s)^2 + (1 - w) r^2).

a and b are the regression of y on m, with b kept between 0, where predictions say nothing, and 1; r is the deviation of y
around it, and k s has the same mean square. A model that has taken noise for signal is surest beside the rows that it has seen,
and what it proposes lies beside those that were lucky: of its own deviations, which say where it is surer, only the share w is
taken, a half, and none where it ranks designs no better than chance. c makes intervals of 1.96 u hold 95 % of the scores (split
conformal prediction, with the correction for few rows; Lei et al. 2018).
"""

from dataclasses import dataclass

import numpy as np

from deadreckon.stats.interval import NORMAL

SHARE = 0.95  # of truths that an interval should hold
OWN = 0.5  # w of a model that ranks designs better than chance


@dataclass(frozen=True)
class Calibration:
    """How scores follow from predictions.

    Attributes:
        a, b: of the mean a + b m.
        scale: k, on the model's own deviations.
        scatter: r, of scores around the regression.
        factor: c.
        own: w, the share of the model's own variance.
    """

    a: float
    b: float
    scale: float
    scatter: float
    factor: float
    own: float

    @classmethod
    def of(cls, y: np.ndarray, mean: np.ndarray, std: np.ndarray, *, skilled: bool) -> "Calibration":
        """From (rows,) scores, and means and deviations that were predicted without them."""
        std = np.maximum(std, 1e-12 * (y.std() or 1.0))  # in whatever unit the scores are
        off = mean - mean.mean()
        spread = float(off @ off)
        b = float(np.clip(off @ (y - y.mean()) / spread, 0.0, 1.0)) if spread else 0.0
        a = float(y.mean() - b * mean.mean())
        error = np.abs(y - a - b * mean)
        scatter = float(np.sqrt(error @ error / max(len(y) - 2, 1)))
        plain = cls(a, b, scatter / float(np.sqrt(np.square(std).mean())), scatter, 1.0, OWN if skilled else 0.0)
        width = plain(mean, std)[1]
        factor = conformal_factor(error / np.where(width > 0, width, 1.0))
        return cls(a, b, plain.scale, scatter, factor, plain.own)

    def __call__(self, mean: np.ndarray, std: np.ndarray, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """(m,) means and deviations of new scores.

        Args:
            mean, std: (m,) predictions and their deviations, as the model has them.
            noise: deviation of one measurement, where the scores that calibrate are means of several and vary less.
        """
        rest = (1.0 - self.own) * max(self.scatter, noise) ** 2
        return self.a + self.b * mean, self.factor * np.sqrt(self.own * np.square(self.scale * std) + rest)

    def averages(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(g, r) means of groups of designs and (g, g) covariance of their averages; the noise of a score is no part of it."""
        rest = 0.0 if self.own else (self.factor * self.scatter) ** 2
        return self.a + self.b * mean, (self.factor * self.scale) ** 2 * covariance + rest * np.eye(len(covariance))


def conformal_factor(error: np.ndarray, share: float = SHARE) -> float:
    """The factor on deviations with which intervals hold a share of the scaled errors, with the finite-sample correction."""
    rank = min(int(np.ceil((len(error) + 1) * share)), len(error))
    return float(np.sort(error)[rank - 1] / NORMAL)
