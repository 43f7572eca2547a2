"""What sampled MMD can tell apart (thesis 4.3, A.3, Figure A.1): expectations in closed form, beside draws of `nets.mmd`.

The estimate of 4.3 keeps the diagonals, so with n draws of each side its expectation is

    E[MMD²_n] = MMD²(P, Q) + (1 - k_PP) / n + (1 - k_QQ) / n,        k_PQ = E k(x, y),  x ~ P, y ~ Q independent.

With P a Gaussian and U uniform over its support, MMD²_n(U, P) < MMD²_n(P, P) in expectation if and only if

    n < (k_UU - k_PP) / MMD²(U, P):

U is preferred to P itself where it is more peaked in the kernel's eyes and few draws are taken, and for no n where its
support is so wide that k_UU <= k_PP.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import numpy as np
from scipy.special import erf

from deadreckon.nets.mmd import FLOOR, mmd

NODES = 60  # of Gauss-Legendre quadrature over distances


@dataclass(frozen=True)
class Normal:
    """A Gaussian in one dimension."""

    mean: float = 0.0
    std: float = 1.0


@dataclass(frozen=True)
class Uniform:
    """Uniform over mean ± half."""

    mean: float = 0.0
    half: float = 1.0


Distribution = Normal | Uniform
Kernel = Callable[[np.ndarray], np.ndarray]  # of distances


def laplacian(bandwidth: float) -> Kernel:
    """exp(-|d| / bandwidth)."""
    return lambda d: np.exp(-np.abs(d) / bandwidth)


def gaussian(variance: float) -> Kernel:
    """exp(-d² / (2 variance)): A.4's "sigma = 20" is the variance; as a standard deviation the kernel sees nothing."""
    return lambda d: np.exp(-np.square(d) / (2.0 * variance))


@cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(NODES)


def expected_kernel(p: Distribution, q: Distribution, kernel: Kernel) -> float:
    """k_PQ, from the density of x - y, which is known: Gaussian, triangular, or a difference of two error functions."""
    centre = p.mean - q.mean
    if isinstance(p, Normal) and isinstance(q, Normal):
        std = math.hypot(p.std, q.std)
        density = lambda d: np.exp(-0.5 * (d / std) ** 2) / (std * math.sqrt(2 * math.pi))  # noqa: E731
        breaks = [-10 * std, 10 * std]
    elif isinstance(p, Uniform) and isinstance(q, Uniform):
        a, b = p.half, q.half
        density = lambda d: np.clip((a + b - np.abs(d)) / (4 * a * b), 0.0, 1 / (2 * max(a, b)))  # noqa: E731
        breaks = [-(a + b), -abs(a - b), abs(a - b), a + b]
    else:
        normal, uniform = (p, q) if isinstance(p, Normal) else (q, p)
        std, half = normal.std, uniform.half  # pyrefly: ignore[missing-attribute] - one is of each kind
        step = lambda d: erf(d / (std * math.sqrt(2)))  # noqa: E731
        density = lambda d: (step(d + half) - step(d - half)) / (4 * half)  # noqa: E731
        breaks = [-half - 10 * std, -half, half, half + 10 * std]
    if breaks[0] < -centre < breaks[-1]:
        breaks.append(-centre)  # where Laplacian kernels have their kink
    x, w = _nodes()
    total = 0.0
    for low, high in zip(sorted(breaks), sorted(breaks)[1:]):
        d = low + (high - low) * (x + 1) / 2
        total += (high - low) / 2 * float(w @ (density(d) * kernel(d + centre)))
    return total


def expected_mmd2(p: Distribution, q: Distribution, kernel: Kernel, n: np.ndarray | float = math.inf) -> np.ndarray:
    """E[MMD²_n] of n draws each; without n that of the distributions."""
    return _mmd2(expected_kernel(p, p, kernel), expected_kernel(q, q, kernel), expected_kernel(p, q, kernel), n)


def _mmd2(pp: Any, qq: Any, pq: Any, n: Any) -> np.ndarray:
    return np.asarray(pp + qq - 2.0 * pq + (2.0 - pp - qq) / np.asarray(n, float))


def preferred_below(p: Distribution, q: Distribution, kernel: Kernel) -> float:
    """Up to how many draws MMD²_n(q, p) is below MMD²_n(p, p) in expectation; none at all below 1."""
    gain = expected_kernel(q, q, kernel) - expected_kernel(p, p, kernel)
    return max(gain, 0.0) / float(expected_mmd2(p, q, kernel))


def drawn(p: Distribution, n: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """(n, count, 1): `count` sets of n draws, as `nets.mmd.mmd` takes them."""
    shape = n, count, 1
    return rng.normal(p.mean, p.std, shape) if isinstance(p, Normal) else rng.uniform(p.mean - p.half, p.mean + p.half, shape)


def unseen_chance(m: int) -> float:
    """C(m², m) m! / m^(2m): that m draws from m² points are all different (A.3, after Gretton et al. 2012, Example 1).

    A.3 prints "> 1 - 1/e = 0.632". It tends to e^-1/2 = 0.607 from above, and is below that from m = 9 on.
    """
    return float(np.prod(1.0 - np.arange(m) / m**2))


@dataclass(frozen=True)
class Curve:
    """MMD by number of draws for one support.

    Attributes:
        alpha: U is uniform over ± alpha standard deviations (A.3 prints Σ).
        n: (k,) draws.
        self_drawn, uniform_drawn: (k, 3) root mean square and quartiles of sampled MMD(P, P) and MMD(U, P).
        self_expected, uniform_expected: (k,) roots of exact expectations of the squares.
        crossing: U is preferred below so many draws.
    """

    alpha: float
    n: np.ndarray
    self_drawn: np.ndarray
    uniform_drawn: np.ndarray
    self_expected: np.ndarray
    uniform_expected: np.ndarray
    crossing: float


DRAWS = np.array([1, 2, 3, 4, 5, 7, 10, 14, 20, 30, 50])


def figure(
    alphas: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0), variance: float = 20.0, draws: np.ndarray = DRAWS,
    sets: int = 1000, seed: int = 0,
) -> list[Curve]:  # fmt: skip
    """Figure A.1 with BEAR's Gaussian kernel: sampled by `nets.mmd`, and exact."""
    rng, p, kernel = np.random.default_rng(seed), Normal(), gaussian(variance)
    sampled = jax.jit(lambda x, y: mmd(x, y, "gaussian", variance))

    def quartiles(q: Distribution, n: int) -> np.ndarray:
        found = np.asarray(sampled(drawn(q, n, sets, rng), drawn(p, n, sets, rng)))
        return np.array([np.sqrt(np.square(found).mean()), *np.percentile(found, [25, 75])])

    curves = []
    for alpha in alphas:
        u = Uniform(half=alpha)
        own, other = (np.sqrt(expected_mmd2(p, q, kernel, draws) + FLOOR) for q in (p, u))
        own_drawn, other_drawn = (np.stack([quartiles(q, int(n)) for n in draws]) for q in (p, u))
        curves.append(Curve(alpha, draws, own_drawn, other_drawn, own, other, preferred_below(p, u, kernel)))
    return curves


@dataclass(frozen=True)
class Allowed:
    """The best policy N(m, s) that a threshold on E[MMD²_n] allows, an entry a threshold.

    Attributes:
        epsilon: thresholds of the root.
        value: mean of the best policy's actions, in the behaviour's standard deviations: what it gains where more is better.
        spread: its standard deviation.
        outside: its probability of actions beyond two of the behaviour's standard deviations.
        own: the root for the behaviour policy itself: below it nothing is allowed that has its spread.
    """

    epsilon: np.ndarray
    value: np.ndarray
    spread: np.ndarray
    outside: np.ndarray
    own: float


EDGE = 2.0  # where the data's support is said to end


def allowed(kernel: Kernel, n: float, epsilon: np.ndarray) -> Allowed:
    """Sweeps BEAR's threshold in one dimension: the behaviour is N(0, 1), and an action is worth itself."""
    means, stds = np.linspace(0.0, 6.0, 121), np.linspace(0.02, 1.5, 38)
    base = Normal()
    own = np.array([expected_kernel(Normal(0.0, s), Normal(0.0, s), kernel) for s in stds])  # wherever its mean is
    cross = np.array([[expected_kernel(Normal(m, s), base, kernel) for s in stds] for m in means])
    root = np.sqrt(_mmd2(own, expected_kernel(base, base, kernel), cross, n).clip(0.0))
    rows = []
    for each in epsilon:
        good = root <= each
        if not good.any():
            rows.append((np.nan, np.nan, np.nan))
            continue
        i = int(np.flatnonzero(good.any(1))[-1])
        j = int(np.where(good[i], root[i], np.inf).argmin())
        m, s = means[i], stds[j]
        tail = lambda z: 0.5 * (1.0 - erf(z / math.sqrt(2.0)))  # noqa: E731
        rows.append((m, s, tail((EDGE - m) / s) + tail((EDGE + m) / s)))
    value, spread, outside = np.array(rows).T
    return Allowed(epsilon, value, spread, outside, math.sqrt(expected_mmd2(base, base, kernel, n)))
