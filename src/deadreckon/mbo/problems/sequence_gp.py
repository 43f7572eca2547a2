"""A Gaussian process on sequences as an oracle, as the design benchmark of 2020 had for proteins: trained once and kept."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deadreckon.mbo.problems.oracle import Arrays, kept, split
from deadreckon.ope.metrics import rank_correlation

ROWS = 5000  # that it is fitted to
TRIED = 1500  # rows by whose likelihood length and noise are chosen
LENGTHS = (2.0, 4.0, 8.0, 16.0, 32.0)
NOISES = (0.03, 0.1, 0.3, 1.0)  # variances, in those of the scores


@dataclass(frozen=True)
class SequenceGP:
    """The mean of a Gaussian process with covariance exp(-h / length), where h is the number of sites that differ.

    Far from all rows it is the mean of the scores.

    Attributes:
        rows: (rows, sites) codes that it was fitted to.
        weights: (rows,) of their covariances.
        mean: of the scores.
        length: number of differing sites over which the covariance falls by a factor of e.
        noise: variance of errors, in variances of the scores.
        rank_correlation: Spearman's, on rows that were held out.
        held_out: how many these were.
    """

    rows: np.ndarray
    weights: np.ndarray
    mean: float
    length: float
    noise: float
    rank_correlation: float
    held_out: int

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(n, sites) codes -> (n,) scores."""
        blocks = np.array_split(np.asarray(x, np.int8), max(1, len(x) // 512))
        near = (np.exp(-differences(block, self.rows) / self.length) for block in blocks)
        return self.mean + np.concatenate([each @ self.weights for each in near])

    @property
    def about(self) -> str:
        """How true it is, in a line."""
        found = f"rank correlation {self.rank_correlation:.2f} on {self.held_out:,} held-out rows"
        return f"a Gaussian process on {len(self.rows):,} sequences; {found}"

    @classmethod
    def of(cls, name: str, x: np.ndarray, y: np.ndarray, rows: int = ROWS) -> "SequenceGP":
        """Trained where it is not known yet; a tenth of the rows, always the same, is held out."""
        arrays, known = kept(name, x, y, ("gp", rows, TRIED, LENGTHS, NOISES), lambda: _train(cls, x, y, rows))
        return cls(arrays["rows"], arrays["weights"], **known)


def differences(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, m) sites at which sequences (n, sites) and (m, sites) differ."""
    out = np.zeros((len(a), len(b)), np.float32)
    for site in np.flatnonzero((a != a[0]).any(0) | (b != a[0]).any(0)):
        out += a[:, site, None] != b[None, :, site]
    return out


def _train(cls: type[SequenceGP], x: np.ndarray, y: np.ndarray, rows: int) -> Arrays:
    out, rest = split(len(y))
    rest = rest[:rows]  # which `split` has shuffled
    codes, mean, std = np.asarray(x[rest], np.int8), float(y[rest].mean()), float(y[rest].std())
    apart, scores = differences(codes, codes), (y[rest] - mean) / std
    some = slice(0, min(TRIED, len(rest)))
    likelihood = lambda asked: _likelihood(apart[some, some], scores[some], *asked)  # noqa: E731
    length, noise = max(product(LENGTHS, NOISES), key=likelihood)
    solved: Any = cho_solve(_factor(apart, length, noise), scores)
    weights = std * solved
    made = cls(codes, weights, mean, length, noise, 0.0, len(out))
    known = {"mean": mean, "length": length, "noise": noise, "held_out": len(out)}
    return {"rows": codes, "weights": weights}, {**known, "rank_correlation": rank_correlation(made(x[out]), y[out])}


def _factor(apart: np.ndarray, length: float, noise: float) -> tuple[np.ndarray, bool]:
    factor: Any = cho_factor(np.exp(-apart.astype(np.float64) / length) + noise * np.eye(len(apart)), lower=True)
    return factor


def _likelihood(apart: np.ndarray, scores: np.ndarray, length: float, noise: float) -> float:
    """Log marginal likelihood of standardised scores up to a constant, prior variance 1 (Rasmussen and Williams 2.30)."""
    factor = _factor(apart, length, noise)
    return float(-0.5 * scores @ cho_solve(factor, scores) - np.log(np.diag(factor[0])).sum())
