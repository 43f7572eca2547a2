"""The fitted model behind proposals: its predictions for any design, without fitting again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from deadreckon.mbo.calibration import Calibration
from deadreckon.mbo.designs import Designs

BLOCK = 512  # designs per call of a model: one shape, which is compiled once

# (m, variables) designs -> (m,) means, and (m,) standard deviations or None.
Predict = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]]
# (g, r, variables) groups of designs -> (g, r) means, and (g, g) covariance of the groups' averages.
Average = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Fitted:
    """The predictions of a method's model for designs, in units of the data's scores (`Designs.y`).

    Attributes:
        predictions: means, and standard deviations of one new measurement (None if the model has none).
        averages: means of groups of designs, and the covariance of the averages of groups; None if the covariance of
            predictions is not known.
        calibration: of the predictions; None if they were not tested.
        beyond: standard deviation of the noise of a single measurement in addition to that of the rows of the calibration.
        is_order: whether predictions are no scores but define only an order, in standard deviations over the data.
        freedom: degrees of freedom of the covariance of averages: for an ensemble the number of members minus one.
    """

    predictions: Predict
    averages: Average | None = None
    calibration: Calibration | None = None
    beyond: float = 0.0
    is_order: bool = False
    freedom: float = np.inf

    def predict(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """(m,) means of (m, variables) designs, and their calibrated standard deviations or None."""
        mean, std = self.predictions(x)
        if self.calibration is None or std is None:
            return mean, std
        return self.calibration.of_one(mean, std, self.beyond)[:2]

    def average(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """(g, r) means of (g, r, variables) groups of designs, and (g, g) calibrated covariance of their averages or None.

        The covariance is also None if predictions were not tested, because a model that has fitted noise is too certain, and if
        the calibration does not use the model's standard deviations.
        """
        if self.averages is None:
            return self.predict(x.reshape(-1, x.shape[-1]))[0].reshape(x.shape[:2]), None
        mean, covariance = self.averages(x)
        if self.calibration is None:
            return mean, None
        mean, factor = self.calibration.of_true(mean, np.ones(()))
        return mean, factor**2 * covariance if self.calibration.scale else None

    def calibrated(self, calibration: Calibration, beyond: float = 0.0) -> "Fitted":
        """The same model with calibrated means and standard deviations."""
        return replace(self, calibration=calibration, beyond=beyond)

    @classmethod
    def of(
        cls, data: Designs, believed: Callable[[Any], tuple[Any, Any]], beyond: float = 0.0, *, is_order: bool = False
    ) -> "Fitted":
        """A model given by a function from coordinates to standardised means and standard deviations of rows (or None); see
        `believed` of `Designer.decoded`."""

        def predictions(x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
            z = data.coordinates.encode(x)
            parts = in_blocks(believed, z)
            mean = np.concatenate([np.asarray(mean, np.float64) for mean, _ in parts])[: len(x)]
            std = None
            if all(each is not None for _, each in parts):
                std = np.concatenate([np.asarray(each, np.float64) for _, each in parts])[: len(x)]
            if is_order:
                return mean, std
            return data.coordinates.score(mean), None if std is None else np.hypot(data.coordinates.y_std * std, beyond)

        return cls(predictions, beyond=beyond, is_order=is_order)


def in_blocks(function: Callable[[Any], Any], z: np.ndarray) -> list[Any]:
    """Values of a function of (rows, size) arrays on blocks of `BLOCK` rows; the last block is padded with its last row."""
    out = []
    for i in range(0, len(z), BLOCK):
        part = z[i : i + BLOCK]
        out.append(function(jnp.asarray(np.concatenate([part, np.repeat(part[-1:], BLOCK - len(part), 0)]))))
    return out


def covariance_of_members(means: np.ndarray) -> np.ndarray:
    """(g, g) covariance of averages over groups, from (members, g, r) means predicted by the members of an ensemble."""
    return np.atleast_2d(np.cov(means.mean(2), rowvar=False))
