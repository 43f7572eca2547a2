"""A Gaussian process for tables: a length scale for each variable, numeric or categorical, and noise that differs by row.

The kernel is Matern's with smoothness 5/2 of the distance

    r^2 = sum over numbers ((a - b) / l)^2 + sum over categories [a != b] / l^2,

with one length l per variable (automatic relevance determination). Lengths, signal and noise maximise the marginal likelihood
(Rasmussen and Williams 2006, 5.4.1) times priors: log l ~ N(sqrt 2 + log(variables) / 2, 3), which keeps functions of many
variables smooth (after Hvarfner et al. 2024), log noise ~ N(-4, 1), both of standardised scores, and log signal ~ N(0, 1).
These are densities of the logarithms, for standardised inputs. BoTorch's are those of the lengths themselves, for inputs in the
unit cube: for uniform inputs its mode has lengths that are 5.8 times shorter (e^3 / sqrt 12) and a noise variance that is e
times smaller. Computations are in 64 bits on the host: the data are few, and the inverse would be inaccurate in 32 bits.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.replicates import noise_beyond, row_weights
from deadreckon.randomness import generator

ITERATIONS = 60  # largest number of iterations of L-BFGS
LEAST_RATIO = 1e-3  # smallest variance of a row's noise, as a multiple of the usual one
NOISE = -4.0, 1.0  # mean and standard deviation of the prior of the log of the noise's variance
LEAST = 1e-6  # least variance of the noise, in variances of the score
ROOT5 = 5**0.5


@dataclass(frozen=True)
class Features:
    """Numeric features of designs, whose squared differences are the terms of the kernel's distance.

    Attributes:
        data: the designs that define the features.
        owner: (features,) the variable of each.
    """

    data: Designs
    owner: np.ndarray

    @classmethod
    def of(cls, data: Designs) -> "Features":
        """The features for some designs: numbers standardised, categories one-hot and divided by the square root of two."""
        return cls(data, data.coordinates.place_owners)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(rows, features) of (rows, variables) designs."""
        view = self.data.coordinates
        found = view.place(x)
        found[:, len(view.numeric) :] /= 2**0.5
        return found


@dataclass(frozen=True)
class Hyper:
    """Hyperparameters: logs of the length of each variable, of the signal variance and of the noise variance, for standardised
    scores."""

    lengths: np.ndarray
    signal: float
    noise: float


@dataclass(frozen=True)
class Process:
    """A fitted process.

    Attributes:
        features: of designs.
        seen: (rows, features) of the data, divided by the lengths.
        alpha: (rows,) coefficients of the posterior mean k(x) alpha.
        inverse: (rows, rows) inverse of the Cholesky factor of the kernel matrix with noise.
        hyper: hyperparameters; the noise is that of a row with the `usual` standard error.
        y_mean, y_std: of the scores that were seen, weighted by `row_weights`.
        usual: weighted mean square of the rows' standard errors (`usual_square`); 0: none are known, and all rows have the
            same noise.
        beyond: standard deviation of the noise of a new measurement in addition to that of a usual row (`noise_beyond`).
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
        """(m,) mean of the true scores, without the standard deviation, which is faster."""
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
        """(m, rows) covariances with the data, (m, rows) factors of the differences in their gradients, and (m, features)
        scaled designs."""
        z = self.features(x) / np.exp(self.hyper.lengths)[self.features.owner]
        return *_matern(_squares(z, self.seen), self.hyper.signal), z


def usual_square(data: Designs) -> float:
    """Mean square of the standard errors, weighted by `row_weights` so that one row with a very large error hardly changes it;
    0: none are known."""
    return 0.0 if data.std_error is None else float(np.average(np.square(data.std_error), weights=row_weights(data)))


def relative_noise(data: Designs) -> np.ndarray:
    """(rows,) variances of the scores' noise, relative to the usual one: the scale of the noise is fitted."""
    usual = usual_square(data)
    if data.std_error is None or not usual:
        return np.ones(len(data))
    return np.maximum(np.square(data.std_error) / usual, LEAST_RATIO)


def fit(data: Designs, rows: int = 400) -> Process:
    """Fits a process to all data.

    Args:
        data: scored designs.
        rows: largest number of rows to which the hyperparameters are fitted, drawn with a fixed seed.
    """
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    features = Features.of(data)
    weight = row_weights(data)
    y_mean = float(np.average(data.y, weights=weight))
    y_std = float(np.average(np.square(data.y - y_mean), weights=weight)) ** 0.5 or 1.0
    y, f, ratio = (data.y - y_mean) / y_std, features(data.x), relative_noise(data)
    count = len(data.variables)
    prior = np.concatenate([np.full(count, 2**0.5 + 0.5 * np.log(count)), [0.0, NOISE[0]]])
    spread = np.concatenate([np.full(count, 3**0.5), [1.0, NOISE[1]]])
    some = np.arange(len(y))
    if len(y) > rows:
        some = np.sort(generator(0, "rows of the hyperparameters").choice(len(y), rows, replace=False))
    bounds = [(-5.0, 8.0)] * count + [(-6.0, 5.0), (np.log(LEAST), 2.0)]
    # The mode of the prior has long lengths; a second start with shorter ones finds functions that vary rapidly.
    begins = [prior, np.concatenate([prior[:-2] - 1.5, [0.0, -2.0]])]
    best = None
    of, options = (f[some], y[some], ratio[some], features.owner, prior, spread), {"maxiter": ITERATIONS}
    for begin in begins:
        # Matrices are small, and NumPy and SciPy may have separate thread pools, which spin while they wait for work: competing
        # for the same cores, they are several times slower than one thread.
        with threadpool_limits(1):
            found = minimize(_loss, begin, of, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        best = found if best is None or found.fun < best.fun else best
    assert best is not None
    return _conditioned(features, f, ratio, _hyper(best.x), y_mean, y_std)


def _conditioned(features: Features, f: np.ndarray, ratio: np.ndarray, hyper: Hyper, y_mean: float, y_std: float) -> Process:
    """The process with these hyperparameters, conditioned on the data."""
    data = features.data
    y = (data.y - y_mean) / y_std
    seen = f / np.exp(hyper.lengths)[features.owner]
    k = _matern(_squares(seen, seen), hyper.signal)[0] + np.diag(np.exp(hyper.noise) * ratio + 1e-8)
    from scipy.linalg import solve_triangular

    inverse: Any = solve_triangular(np.linalg.cholesky(k), np.eye(len(y)), lower=True)
    alpha = inverse.T @ (inverse @ y)
    return Process(features, seen, alpha, inverse, hyper, y_mean, y_std, usual_square(data), noise_beyond(data))


def _hyper(vector: np.ndarray) -> Hyper:
    return Hyper(vector[:-2], float(vector[-2]), float(vector[-1]))


def _squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.maximum(np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2 * a @ b.T, 0.0)


def _matern(squares: np.ndarray, signal: float) -> tuple[np.ndarray, np.ndarray]:
    """Covariances, and twice their derivatives with respect to the squared distance."""
    r = ROOT5 * np.sqrt(squares)
    decay = np.exp(signal - r)
    return (1 + r + r * r / 3) * decay, -(5 / 3) * (1 + r) * decay


def _loss(vector, f, y, ratio, owner, prior, spread) -> tuple[float, np.ndarray]:
    """Negative log of marginal likelihood times prior, up to a constant, and its gradient."""
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
    outer = 0.5 * (inverse - np.outer(alpha, alpha))  # derivative of the loss with respect to the kernel matrix
    weight = outer * slope
    # By log l: minus the sum over pairs of weight (z_a - z_b)^2, since the derivative of the kernel by the squared distance is
    # half of `slope`, and that of the squared distance is -2 (z_a - z_b)^2.
    each = -2 * (weight.sum(1) @ np.square(z) - (z * (weight @ z)).sum(0))
    lengths = np.bincount(owner, each, minlength=len(hyper.lengths))
    gradient = np.concatenate([lengths, [(outer * k).sum(), (np.diag(outer) * noise).sum()]]) + away / spread
    return float(loss), gradient
