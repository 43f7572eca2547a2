"""The coordinates of a log for methods: actions in [-1, 1] and, if requested, standardised observations."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.data.spec import Discrete, Spec

# The logarithm of a tanh density needs |a| < 1: clipped here, once, before any arctanh.
EDGE = 1.0 - 1e-6
# Added to the standard deviation of observations, so that a constant dimension stays finite (TD3+BC's value).
STD_FLOOR = 1e-3


@dataclass(frozen=True, eq=False)
class Normalizer:
    """The two changes of coordinates between a log and a method; every method and policy uses this one object.

    Works on numpy and JAX arrays alike. For discrete actions the action maps are the identity.

    Attributes:
        mean, std: of the observations, arrays of the observation's shape; None if observations are not changed.
        low, high: (size,) action bounds; None for discrete actions.
    """

    mean: np.ndarray | None
    std: np.ndarray | None
    low: np.ndarray | None
    high: np.ndarray | None

    @classmethod
    def of(cls, spec: Spec, standardise: bool = False) -> "Normalizer":
        """The normalizer of a log with this spec."""
        mean = std = low = high = None
        if standardise and spec.observation_dtype != "uint8":
            mean = np.asarray(spec.observation.mean, np.float32)
            std = np.asarray(spec.observation.std + STD_FLOOR, np.float32)
            if spec.mask_size:  # which actions are legal must be read in these coordinates too
                mean[-spec.mask_size :], std[-spec.mask_size :] = 0.0, 1.0
        if not isinstance(spec.action, Discrete):
            low, high = np.asarray(spec.action.low, np.float32), np.asarray(spec.action.high, np.float32)
        return cls(mean, std, low, high)

    def observe(self, observations: Any) -> Any:
        """Raw observations in the coordinates of methods."""
        return observations if self.mean is None else (observations - self.mean) / self.std

    def to_unit(self, actions: Any) -> Any:
        """Logged actions scaled to [-1, 1] and clipped to +-(1 - 1e-6)."""
        if self.low is None:
            return actions
        return self.scaled(actions).clip(-EDGE, EDGE)

    def scaled(self, actions: Any) -> Any:
        """Continuous actions scaled so that the bounds are ±1, and beyond where they are."""
        assert self.low is not None
        assert self.high is not None
        return 2.0 * (actions - self.low) / (self.high - self.low) - 1.0

    def from_unit(self, actions: Any) -> Any:
        """Actions in [-1, 1], converted to the environment's."""
        if self.low is None:
            return actions
        return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)

    @property
    def log_scale(self) -> float:
        """The number to subtract from a log-density over [-1, 1] for one over the environment's actions."""
        return 0.0 if self.low is None or self.high is None else float(np.log(0.5 * np.subtract(self.high, self.low)).sum())

    def log_scale_within(self, unit: np.ndarray) -> np.ndarray:
        """(rows,) the same where what lies at a bound is a probability and no density; `unit` (rows, size) in [-1, 1]."""
        assert self.low is not None
        assert self.high is not None
        return (np.abs(unit) < EDGE) @ np.log(0.5 * np.subtract(self.high, self.low, dtype=np.float64))
