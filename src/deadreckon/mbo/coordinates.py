"""The standardised coordinates in which models see designs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Numbers that methods search in, of mean 0 and deviation 1, and back.

    A categorical variable of V levels is V - 1 logits, as in Design-Bench: those of 0.6 one-hot + 0.4 uniform, less that of the
    first level, which is then zero and left out; on a scale where they are -1, 0 or 1. The level with the highest is chosen.

    Attributes:
        numeric: (n,) columns of the designs that are numbers.
        logs: (n,) which of these are seen as their logarithms.
        mean, std: (n,) of these.
        groups: columns with equally many levels, and how many.
        low, high: (size,) bounds of the coordinates; infinite where there are none.
        y_mean, y_std: of the scores, which methods see standardised too.
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
        """Of these designs' variables and statistics."""
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
        std = np.where(np.ptp(part, axis=0) > 0, std, 1.0)  # that of a constant may be a rounding error
        bounds = np.array([(designs.variables[i].low, designs.variables[i].high) for i in numeric]).reshape(-1, 2)
        bounds = _logged(bounds.T, logs).T
        free = np.full(sum(len(columns) * (n - 1) for columns, n in groups), np.inf)
        low, high = (np.concatenate([(b - mean) / std, s * free]) for b, s in ((bounds[:, 0], -1), (bounds[:, 1], 1)))
        worth = float(designs.y.mean()), float(designs.y.std())
        return cls(designs, numeric, logs, mean, std, groups, low.astype(np.float32), high.astype(np.float32), *worth)

    @property
    def size(self) -> int:
        """Coordinates a design."""
        return len(self.low)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(size,) least and greatest coordinates of what is proposed; those of fixed variables are the same."""
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
    def discrete(self) -> bool:
        """Whether most variables are categories."""
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
        """(rows, features) float64 of (rows, variables) designs: where they lie for distances.

        Numbers are coordinates, categories one-hot, so that of one all levels are equally far from each other, whichever of
        them is the first.
        """
        x = np.asarray(x)
        parts = [self.encode(x)[:, : len(self.numeric)].astype(np.float64)]
        for columns, n in self.groups:
            levels = x[:, columns].astype(int)[..., None] == np.arange(n)
            parts.append(levels.reshape(len(x), len(columns) * n).astype(np.float64))
        return np.concatenate(parts, 1)

    def decode(self, z: np.ndarray) -> np.ndarray:
        """(rows, size) coordinates as (rows, variables) designs, within bounds, whole numbers rounded."""
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
        """Standardised scores as scores."""
        return self.y_mean + self.y_std * np.asarray(y, np.float64)


def _logged(x: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(rows, n) numbers, those of some columns as their logarithms."""
    if not logs.any():
        return x
    x = np.array(x, np.float64)
    x[:, logs] = np.log(x[:, logs])
    return x
