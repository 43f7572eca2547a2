"""Calibration of a model's predictions on held-out designs.

From out-of-fold predictions m with standard deviations s, and the observed scores y, the prediction of a new score becomes

    a + b m, with the standard deviation  c max(sqrt(w s^2 + (1 - w) h^2), s).

a and b are the coefficients of a regression of y on m with the weights 1 / s^2, with b clipped to [0, 1]; b = 0 means that the
predictions carry no information. h^2 is the harmonic mean of all s^2, i.e. their mean with the same weights. A model that fits
noise is most certain near its training rows, and its proposals lie near rows with favourable errors. Its variances s^2, which
say where it is more certain, therefore have only the weight w: one half, or 0 if its order of designs may be chance. c is the
factor with which the intervals of 1.96 c sqrt(w s^2 + (1 - w) h^2) cover 95 % of the scores, by leave-one-out errors of the
regression (after split conformal prediction, with its finite-sample correction; Lei et al. 2018). With fewer than 19 rows it
follows from the largest error, and the coverage is n / (n + 1). Where s is larger than usual, as far from the data, s itself
is used (unless w is 0): the intervals there are wider, and c is the same.
"""

from dataclasses import dataclass

import numpy as np

from deadreckon.stats.interval import LEVEL, NORMAL

OWN = 0.5  # w of a model whose order of designs is distinguishable from chance


@dataclass(frozen=True)
class Calibration:
    """A calibration of predictions; see the module.

    Attributes:
        a, b: coefficients of the mean a + b m.
        scale: factor of the model's standard deviations, c sqrt(w); 0: they are not used.
        scatter: the part of the standard deviation that is the same for all predictions, c h sqrt(1 - w).
    """

    a: float
    b: float
    scale: float
    scatter: float

    @classmethod
    def of(
        cls, y: np.ndarray, mean: np.ndarray, std: np.ndarray, *, skilled: bool, independent: int | None = None
    ) -> "Calibration":
        """Fits the calibration.

        Args:
            y: (rows,) observed scores.
            mean, std: (rows,) out-of-fold means and standard deviations.
            skilled: whether the order of the predictions can be distinguished from chance.
            independent: effective number of independent rows; None: all are.
        """
        std = np.maximum(std, 1e-12 * (y.std() or 1.0))  # relative, so that the unit of the scores does not matter
        weight = np.square(std.min() / std)
        common = float(std.min() / weight.mean() ** 0.5)
        weight /= weight.sum()
        off = mean - weight @ mean
        spread = float(weight @ np.square(off)) if np.ptp(mean) > 0 else 0.0
        b = float(np.clip(weight * off @ y / spread, 0.0, 1.0)) if spread else 0.0
        a = float(weight @ (y - b * mean))
        seen = weight * (1.0 + (np.square(off) / spread if 0.0 < b < 1.0 else 0.0))  # leverage of each row
        error = np.abs(y - a - b * mean) / np.maximum(1.0 - seen, 1e-6)
        own = OWN if skilled else 0.0
        scale, scatter = own**0.5, (1.0 - own) ** 0.5 * common
        factor = conformal_factor(error / np.hypot(scale * std, scatter), independent=independent)
        return cls(a, b, factor * scale, factor * scatter)

    def __call__(self, mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) means and standard deviations of new scores, from (m,) predictions and their standard deviations."""
        return self.a + self.b * mean, np.maximum(np.hypot(self.scale * std, self.scatter), self.scale / OWN**0.5 * std)

    def of_one(self, mean: np.ndarray, std: np.ndarray, beyond: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Calibrated single measurements: (m,) means, standard deviations, and factors by which the latter were multiplied.

        Args:
            mean, std: (m,) predicted means and standard deviations of single measurements.
            beyond: standard deviation of the noise of a single measurement in addition to that of the rows of the calibration,
                which may be means of several; it is not multiplied.
        """
        row = np.sqrt(np.maximum(np.square(std) - beyond**2, 0.0))
        mean, found = self(mean, row)
        return mean, np.hypot(found, beyond), found / row

    def of_true(self, mean: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Calibrated means of true scores, and deviations from them (`off`: draws or standard deviations), of any shapes.

        The model's deviations have the full weight and are multiplied by c; the part that is the same for all is left out, as
        it includes the noise of measurements. If the calibration does not use the model's deviations, they are unchanged.
        """
        return self.a + self.b * mean, (self.scale / OWN**0.5 or 1.0) * off


def conformal_factor(error: np.ndarray, independent: int | None = None) -> float:
    """The factor on standard deviations with which normal intervals cover the share `LEVEL` of errors.

    Args:
        error: (rows,) absolute errors in standard deviations.
        independent: effective number of independent errors, for the finite-sample correction; None: all are.
    """
    n = len(error) if independent is None else independent
    rank = min(int(np.ceil((n + 1) * LEVEL)), n)
    rank = rank if n == len(error) else int(np.ceil(rank / n * len(error)))
    return float(np.sort(error)[rank - 1] / NORMAL)
