"""The standardised coordinates of designs, which are the inputs of models."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Mapping between designs and coordinates with mean 0 and standard deviation 1, in which methods search.

    A categorical variable with V levels has V - 1 logits, as in Design-Bench: those of 0.6 one-hot + 0.4 uniform, minus that of
    the first level, which is then zero and left out; scaled to -1, 0 or 1. Decoding takes the level with the largest logit.

    Attributes:
        designs: the designs that define the mapping.
        numeric: (n,) columns of the designs that are numbers or ordered levels.
        logs: (n,) bool: which of these are on a log scale.
        mean, std: (n,) means and standard deviations of these, by which they are standardised.
        groups: columns of the categorical variables with the same number of levels, and that number.
        low, high: (size,) bounds of the coordinates; infinite where there are none.
        y_mean, y_std: mean and standard deviation of the scores, which are standardised as well.
    """

    designs: "Designs"
    numeric: np.ndarray
    logs: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    groups: tuple[tuple[np.ndarray, int], ...]
    low: np.ndarray
    high: np.ndarray
    y_mean: float
    y_std: float

    @classmethod
    def of(cls, designs: "Designs") -> "Coordinates":
        """The coordinates by the variables and statistics of some designs."""
        kinds = [v.kind for v in designs.variables]
        numeric = np.array([i for i, kind in enumerate(kinds) if kind != "categorical"], int)
        counts = sorted({len(v.levels) for v in designs.variables if v.kind == "categorical"})
        groups = tuple(
            (np.array([i for i, v in enumerate(designs.variables) if v.kind == "categorical" and len(v.levels) == n]), n)
            for n in counts
        )
        logs = np.array([designs.variables[i].log for i in numeric], bool)
        part = _logged(designs.x[:, numeric].astype(np.float64), logs)
        mean, std = part.mean(0), part.std(0)
        std = np.where(np.ptp(part, axis=0) > 0, std, 1.0)  # the std of a constant may be a rounding error
        bounds = np.array([(designs.variables[i].low, designs.variables[i].high) for i in numeric]).reshape(-1, 2)
        bounds = _logged(bounds.T, logs).T
        free = np.full(sum(len(columns) * (n - 1) for columns, n in groups), np.inf)
        low, high = (np.concatenate([(b - mean) / std, s * free]) for b, s in ((bounds[:, 0], -1), (bounds[:, 1], 1)))
        worth = float(designs.y.mean()), float(designs.y.std())
        return cls(designs, numeric, logs, mean, std, groups, low.astype(np.float32), high.astype(np.float32), *worth)

    @property
    def size(self) -> int:
        """Number of coordinates of a design."""
        return len(self.low)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(size,) least and greatest coordinates of proposals, which are equal for fixed variables."""
        low, high = self.low.copy(), self.high.copy()
        if self.designs.rules.fixed:
            x = self.designs.x[:1].copy()
            for column, value in self.designs.rules.fixed:
                x[:, column] = value
            of, pinned = self.owners, self.encode(x)[0]
            held = np.isin(of, [column for column, _ in self.designs.rules.fixed])
            low[held] = high[held] = pinned[held]
        return low, high

    @property
    def owners(self) -> np.ndarray:
        """(size,) the column of the designs that each coordinate belongs to."""
        return np.concatenate([self.numeric, *(np.repeat(columns, n - 1) for columns, n in self.groups)]).astype(int)

    @property
    def place_owners(self) -> np.ndarray:
        """(features,) the same for each feature of `place`."""
        return np.concatenate([self.numeric, *(np.repeat(columns, n) for columns, n in self.groups)]).astype(int)

    @property
    def discrete(self) -> bool:
        """Whether most variables are categorical."""
        return len(self.numeric) < len(self.designs.variables) / 2

    def encode(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) designs as (rows, size) float32 coordinates."""
        x = np.asarray(x)
        parts = [(_logged(x[:, self.numeric], self.logs) - self.mean) / self.std]
        for columns, n in self.groups:
            index = x[:, columns].astype(int)
            logits = (index[..., None] == np.arange(n)).astype(np.float64)
            parts.append((logits[..., 1:] - logits[..., :1]).reshape(len(x), len(columns) * (n - 1)))
        return np.concatenate(parts, 1).astype(np.float32)

    def place(self, x: np.ndarray) -> np.ndarray:
        """(rows, features) float64 features of (rows, variables) designs, in which distances are measured.

        Numbers are the coordinates. Categories are one-hot, so that all levels are equally far from each other; in the
        coordinates the first level is special.
        """
        x = np.asarray(x)
        parts = [self.encode(x)[:, : len(self.numeric)].astype(np.float64)]
        for columns, n in self.groups:
            levels = x[:, columns].astype(int)[..., None] == np.arange(n)
            parts.append(levels.reshape(len(x), len(columns) * n).astype(np.float64))
        return np.concatenate(parts, 1)

    def decode(self, z: np.ndarray) -> np.ndarray:
        """(rows, size) coordinates as (rows, variables) float32 designs, clipped to bounds, whole numbers rounded."""
        z = np.asarray(z, np.float64)
        out = np.empty((len(z), len(self.designs.variables)))
        count = len(self.numeric)
        variables = [self.designs.variables[i] for i in self.numeric]
        value = z[:, :count] * self.std + self.mean
        value[:, self.logs] = np.exp(value[:, self.logs])
        whole = np.array([v.kind != "continuous" for v in variables], bool)
        value = np.where(whole, np.round(value), value)
        out[:, self.numeric] = value.clip([v.low for v in variables], [v.high for v in variables]) if count else value
        for columns, n in self.groups:
            logits = z[:, count : count + len(columns) * (n - 1)].reshape(len(z), len(columns), n - 1)
            count += len(columns) * (n - 1)
            out[:, columns] = np.concatenate([np.zeros((*logits.shape[:2], 1)), logits], -1).argmax(-1)
        return out.astype(np.float32)

    def score(self, y: np.ndarray) -> np.ndarray:
        """Scores from standardised scores."""
        return self.y_mean + self.y_std * np.asarray(y, np.float64)


def _logged(x: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(rows, n) numbers, with the columns selected by `logs` (n,) replaced by their logarithms."""
    if not logs.any():
        return x
    x = np.array(x, np.float64)
    x[:, logs] = np.log(x[:, logs])
    return x
