"""A Gaussian process for tables: a length for each variable, categories beside numbers, and noise that differs between rows.

The kernel is Matern's with smoothness 5/2 of the distance

    r^2 = sum over numbers ((a - b) / l)^2 + sum over categories [a != b] / l^2,

with one length l a variable (automatic relevance determination). Lengths, signal and noise maximise the marginal likelihood
(Rasmussen and Williams 2006, 5.4.1) times priors: log l ~ N(sqrt 2 + log(variables) / 2, 3), which keeps functions of many
variables smooth (after Hvarfner et al. 2024), log noise ~ N(-4, 1), both of standardised scores, and log signal ~ N(0, 1). It
is the density of the logarithms, of inputs that are standardised; BoTorch's is that of the lengths themselves, of inputs in the
unit cube, whose mode has lengths 5.8 times shorter of uniform inputs (e^3 / sqrt 12) and a variance of the noise e times
smaller. All is in 64 bits on the host: the data are few, and 32 bits would lose the inverse.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.replicates import noise_beyond
from deadreckon.randomness import generator

ITERATIONS = 60  # of L-BFGS at most
LEAST_RATIO = 1e-3  # variance of a row's noise at least, in means of all rows' variances
NOISE = -4.0, 1.0  # mean and standard deviation of the prior of the log of the noise's variance
LEAST = 1e-6  # variance of the noise at least, in variances of the score
ROOT5 = 5**0.5


@dataclass(frozen=True)
class Features:
    """Designs as numbers whose squared differences are the kernel's distances.

    Attributes:
        owner: (features,) the variable of each.
    """

    data: Designs
    owner: np.ndarray

    @classmethod
    def of(cls, data: Designs) -> "Features":
        """Of these variables: numbers standardised, categories one-hot over the square root of two."""
        view = data.coordinates
        owner = [view.numeric, *(np.repeat(columns, n) for columns, n in view.groups)]
        return cls(data, np.concatenate(owner).astype(int))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(rows, features) of (rows, variables) designs."""
        view = self.data.coordinates
        found = view.place(x)
        found[:, len(view.numeric) :] /= 2**0.5
        return found


@dataclass(frozen=True)
class Hyper:
    """Of a process: log of the length of each variable, of the signal's variance and of the noise's (standardised scores)."""

    lengths: np.ndarray
    signal: float
    noise: float


@dataclass(frozen=True)
class Process:
    """A fitted process.

    Attributes:
        features: what turns designs into numbers.
        seen: (rows, features) of the data, over the lengths.
        alpha: (rows,) of the mean k(x) alpha.
        inverse: (rows, rows) inverse of the Cholesky factor of the kernel matrix with noise.
        hyper: hyperparameters; its noise is that of a row of usual standard error.
        y_mean, y_std: of the scores that were seen.
        usual: mean square of the rows' standard errors; 0: none are known, and all rows have the same noise.
        beyond: standard deviation of the noise that one new measurement has beyond that of a usual row (`noise_beyond`).
    """

    features: Features
    seen: np.ndarray
    alpha: np.ndarray
    inverse: np.ndarray
    hyper: Hyper
    y_mean: float
    y_std: float
    usual: float
    beyond: float

    @property
    def noise(self) -> float:
        """Standard deviation of the noise of one new measurement."""
        return float(np.hypot(self.y_std * np.exp(0.5 * self.hyper.noise), self.beyond))

    def noise_of(self, error: np.ndarray) -> np.ndarray:
        """(m,) standard deviations of the noise of scores with these standard errors."""
        if not self.usual:
            return np.full(len(error), self.noise)
        row = self.y_std * float(np.exp(0.5 * self.hyper.noise))
        return row * np.sqrt(np.maximum(np.square(error) / self.usual, LEAST_RATIO))

    def posterior(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) mean and (m,) standard deviation of the true scores of (m, variables) designs."""
        k = self._kernel(x)[0]
        variance = np.exp(self.hyper.signal) - np.square(k @ self.inverse.T).sum(1)
        return self.y_mean + self.y_std * (k @ self.alpha), self.y_std * np.sqrt(np.maximum(variance, 1e-10))

    def measured(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) mean and (m,) standard deviation of one new measurement, noise included, of (m, variables) designs."""
        mean, std = self.posterior(x)
        return mean, np.hypot(std, self.noise)

    def mean(self, x: np.ndarray) -> np.ndarray:
        """(m,) mean alone, which is faster."""
        return self.y_mean + self.y_std * (self._kernel(x)[0] @ self.alpha)

    def slope(self, x: np.ndarray, kappa: float) -> np.ndarray:
        """(m, features) gradient of mean + kappa x standard deviation, in standardised scores."""
        k, slope, z = self._kernel(x)
        weight = np.broadcast_to(self.alpha, k.shape)
        if kappa:
            white = k @ self.inverse.T
            std = np.sqrt(np.maximum(np.exp(self.hyper.signal) - np.square(white).sum(1), 1e-10))
            weight = weight - kappa / std[:, None] * (white @ self.inverse)
        part = weight * slope
        return (part.sum(1)[:, None] * z - part @ self.seen) / np.exp(self.hyper.lengths)[self.features.owner]

    def covariance(self, x: np.ndarray) -> np.ndarray:
        """(m, m) posterior covariance of the true scores, in standardised scores."""
        k, _, z = self._kernel(x)
        white = k @ self.inverse.T
        return _matern(_squares(z, z), self.hyper.signal)[0] - white @ white.T

    def averages(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(g, r) means of (g, r, variables) groups of designs, and (g, g) posterior covariance of the groups' averages."""
        groups, mean = [], []
        for group in x:
            k, _, z = self._kernel(group)
            mean.append(k @ self.alpha)
            groups.append((k.mean(0), z))
        white = np.stack([k for k, _ in groups]) @ self.inverse.T
        each = [z for _, z in groups]
        prior = np.empty((len(x), len(x)))
        for i, a in enumerate(each):
            for j, b in enumerate(each[: i + 1]):
                prior[i, j] = prior[j, i] = _matern(_squares(a, b), self.hyper.signal)[0].mean()
        return self.y_mean + self.y_std * np.stack(mean), self.y_std**2 * (prior - white @ white.T)

    def _kernel(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(m, rows) covariances with the data, what their gradients are times differences, and (m, features) scaled designs."""
        z = self.features(x) / np.exp(self.hyper.lengths)[self.features.owner]
        return *_matern(_squares(z, self.seen), self.hyper.signal), z


def relative_noise(data: Designs) -> np.ndarray:
    """(rows,) variances of the scores' noise, relative to their mean: only these ratios are taken from standard errors."""
    if data.std_error is None or not data.std_error.any():
        return np.ones(len(data))
    square = np.square(data.std_error)
    return np.maximum(square / square.mean(), LEAST_RATIO)


def fit(data: Designs, rows: int = 400) -> Process:
    """A process of all data.

    Args:
        data: scored designs.
        rows: on how many of them at most hyperparameters are fitted, drawn with a seed that never changes.
    """
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    features = Features.of(data)
    y_mean, y_std = float(data.y.mean()), float(data.y.std()) or 1.0
    y, f, ratio = (data.y - y_mean) / y_std, features(data.x), relative_noise(data)
    count = len(data.variables)
    prior = np.concatenate([np.full(count, 2**0.5 + 0.5 * np.log(count)), [0.0, NOISE[0]]])
    spread = np.concatenate([np.full(count, 3**0.5), [1.0, NOISE[1]]])
    some = np.arange(len(y))
    if len(y) > rows:
        some = np.sort(generator(0, "rows of the hyperparameters").choice(len(y), rows, replace=False))
    bounds = [(-5.0, 8.0)] * count + [(-6.0, 5.0), (np.log(LEAST), 2.0)]
    # The mode of the prior's lengths is long; a second start of shorter ones finds functions that change fast.
    begins = [prior, np.concatenate([prior[:-2] - 1.5, [0.0, -2.0]])]
    best = None
    of, options = (f[some], y[some], ratio[some], features.owner, prior, spread), {"maxiter": ITERATIONS}
    for begin in begins:
        # Matrices are small, and numpy and scipy may have pools of threads of their own, which spin while they wait for work:
        # taking turns on as many cores, they are several times as slow as one thread.
        with threadpool_limits(1):
            found = minimize(_loss, begin, of, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        best = found if best is None or found.fun < best.fun else best
    assert best is not None
    return _conditioned(features, f, ratio, _hyper(best.x), y_mean, y_std)


def _conditioned(features: Features, f: np.ndarray, ratio: np.ndarray, hyper: Hyper, y_mean: float, y_std: float) -> Process:
    """The process of these hyperparameters, given the data."""
    data = features.data
    y = (data.y - y_mean) / y_std
    seen = f / np.exp(hyper.lengths)[features.owner]
    k = _matern(_squares(seen, seen), hyper.signal)[0] + np.diag(np.exp(hyper.noise) * ratio + 1e-8)
    from scipy.linalg import solve_triangular

    inverse: Any = solve_triangular(np.linalg.cholesky(k), np.eye(len(y)), lower=True)
    usual = 0.0 if data.std_error is None else float(np.square(data.std_error).mean())
    return Process(features, seen, inverse.T @ (inverse @ y), inverse, hyper, y_mean, y_std, usual, noise_beyond(data))


def _hyper(vector: np.ndarray) -> Hyper:
    return Hyper(vector[:-2], float(vector[-2]), float(vector[-1]))


def _squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.maximum(np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2 * a @ b.T, 0.0)


def _matern(squares: np.ndarray, signal: float) -> tuple[np.ndarray, np.ndarray]:
    """Covariances, and twice their derivatives by the squared distance."""
    r = ROOT5 * np.sqrt(squares)
    decay = np.exp(signal - r)
    return (1 + r + r * r / 3) * decay, -(5 / 3) * (1 + r) * decay


def _loss(vector, f, y, ratio, owner, prior, spread) -> tuple[float, np.ndarray]:
    """Negative log of marginal likelihood times prior, and its gradient."""
    from scipy.linalg import get_lapack_funcs

    hyper = _hyper(vector)
    z = f / np.exp(hyper.lengths)[owner]
    k, slope = _matern(_squares(z, z), hyper.signal)
    noise = np.exp(hyper.noise) * ratio
    try:
        factor = np.linalg.cholesky(k + np.diag(noise + 1e-8))
    except np.linalg.LinAlgError:
        return 1e10, np.zeros_like(vector)
    (potri,) = get_lapack_funcs(("potri",), (factor,))
    lower = potri(factor, lower=1)[0]
    inverse = np.tril(lower) + np.tril(lower, -1).T
    alpha = inverse @ y
    away = (vector - prior) / spread
    loss = 0.5 * y @ alpha + np.log(np.diag(factor)).sum() + 0.5 * away @ away
    outer = 0.5 * (inverse - np.outer(alpha, alpha))  # derivative of the loss by the kernel matrix
    weight = outer * slope
    # By log l: the sum over pairs of weight (z_a - z_b)^2, of which a derivative by the squared distance is half the slope.
    each = -2 * (weight.sum(1) @ np.square(z) - (z * (weight @ z)).sum(0))
    lengths = np.bincount(owner, each, minlength=len(hyper.lengths))
    gradient = np.concatenate([lengths, [(outer * k).sum(), (np.diag(outer) * noise).sum()]]) + away / spread
    return float(loss), gradient
