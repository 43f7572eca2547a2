"""Bayesian optimisation without new evaluations: a Gaussian process on the data, and designs of greatest expected improvement
(thesis 6.5).

scikit-learn fits the kernel by marginal likelihood; the improvement over the best score of the data,

    EI(x) = s (u Phi(u) + phi(u)),   u = (m - y_best) / s,

is maximised by its logarithm, whose gradient does not vanish where the improvement itself is numerically zero (Ament et al.
2023). The only random part is the selection of rows if there are too many, with a fixed seed.
"""

import warnings
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.errors import UserError, extra
from deadreckon.mbo.designer import Designer, DesignInput, Proposals, starts
from deadreckon.mbo.surrogate import climb
from deadreckon.training.hyperparameters import Count, NonNegative, static

NOISE = 1e-3  # least variance of the noise, in variances of the score: with less, the inverse is inaccurate in 32 bits
FAR = 5.0  # standard deviations below the best score beyond which log EI is computed from its asymptotic series


class Process(NamedTuple):
    """A fitted Gaussian process.

    Attributes:
        x: (rows, size) coordinates of the data.
        alpha: (rows,) coefficients of the posterior mean k(x) alpha.
        whiten: (rows, rows) inverse of the Cholesky factor of the kernel matrix with noise; the inverse of the matrix itself
            would lose twice as many digits.
        scale: signal variance.
        length: length scale of the RBF kernel, or the constant sigma_0 of the inner-product kernel.
        best: standardised score to improve on.
        rbf: 1 for the RBF kernel, 0 for the inner product.
    """

    x: Float[Array, "r z"]
    alpha: Float[Array, "r"]
    whiten: Float[Array, "r r"]
    scale: Array
    length: Array
    best: Array
    rbf: Array

    @jax.jit
    def posterior(self, x: Float[Array, "b z"]) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
        """Mean and standard deviation of the true score, without noise."""
        inner, own = x @ self.x.T, jnp.square(x).sum(-1)
        distance = jnp.maximum(own[:, None] + jnp.square(self.x).sum(-1) - 2 * inner, 0.0)
        near = jnp.where(self.rbf > 0, jnp.exp(-0.5 * distance / jnp.square(self.length)), jnp.square(self.length) + inner)
        prior = jnp.where(self.rbf > 0, 1.0, jnp.square(self.length) + own)
        k = self.scale * near
        variance = self.scale * prior - jnp.square(k @ self.whiten.T).sum(-1)
        return k @ self.alpha, jnp.sqrt(jnp.maximum(variance, 1e-6 * self.scale))


def log_improvement(u: Array) -> Array:
    """log(u Phi(u) + phi(u))."""
    near = jnp.maximum(u, -FAR)
    inside = near * jax.scipy.stats.norm.cdf(near) + jax.scipy.stats.norm.pdf(near)
    low = jnp.minimum(u, -FAR)
    square = 1 / jnp.square(low)
    tail = square * (-3 + square * (15 - 105 * square))  # phi(u) / u^2 (1 - 3/u^2 + 15/u^4 - ...)
    return jnp.where(u > -FAR, jnp.log(inside), jax.scipy.stats.norm.logpdf(low) - 2 * jnp.log(-low) + jnp.log1p(tail))


def worth(process: Process, x: Array) -> Array:
    """Log of the expected improvement."""
    mean, std = process.posterior(x)
    return log_improvement((mean - process.best) / std) + jnp.log(std)


class GPBO(Designer):
    """Expected improvement under a Gaussian process."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"ascent": "ascent_steps", "rows": "max_rows"}

    kernel: Literal["auto", "rbf", "inner"] = static("auto")
    """kernel of the process; auto: inner product where most variables are categories, else RBF"""
    max_rows: Count = static(1000)  # largest number of designs in the fit: half the best ones, half drawn from the rest
    ascent_steps: Count = static(200)  # gradient steps that move the designs
    design_lr: NonNegative = 0.01  # step size of the designs, times the square root of the number of coordinates

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "GP-BO"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Gradient ascent on log EI from the best designs of the data; the same for every seed."""
        view = setting.data.coordinates
        process = self.fit(setting)
        lr, start = self.design_lr * view.size**0.5, starts(setting.data, setting.n)
        x = climb(worth, process, start, self.ascent_steps, lr, *setting.bounds)
        return [self.decoded(setting, seed, x, process.posterior, noisy=False) for seed in setting.seeds]

    def fit(self, setting: DesignInput) -> Process:
        """Fits the process.

        Raises:
            UserError: scikit-learn is not installed.
        """
        try:
            from sklearn.exceptions import ConvergenceWarning
            from sklearn.gaussian_process import GaussianProcessRegressor, kernels
        except ImportError:
            raise UserError(f"gp-bo fits with scikit-learn: {extra('design')}") from None
        data, view = setting.data, setting.data.coordinates
        rows = data.best_and_others(self.max_rows, np.random.default_rng(0))
        z = view.encode(data.x[rows]).astype(np.float64)
        y = (data.y[rows] - view.y_mean) / view.y_std
        rbf = self.kernel == "rbf" or (self.kernel == "auto" and not view.discrete)
        size = float(view.size)
        shape = kernels.RBF(size**0.5, (1e-2 * size**0.5, 1e2 * size**0.5)) if rbf else kernels.DotProduct(1.0, (1e-3, 1e3))
        signal = kernels.ConstantKernel(1.0 if rbf else 1.0 / size, (1e-6, 1e3))
        kernel: Any = signal * shape + kernels.WhiteKernel(0.1, (NOISE, 1e1))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # without noise in the data its variance is at the bound
            found: Any = GaussianProcessRegressor(kernel, alpha=1e-8, random_state=0).fit(z, y).kernel_
        product = found.k1
        whiten = np.linalg.inv(np.linalg.cholesky(found(z) + 1e-8 * np.eye(len(z))))
        length = product.k2.length_scale if rbf else product.k2.sigma_0
        parts = z, whiten.T @ (whiten @ y), whiten, product.k1.constant_value, length, y.max(), float(rbf)
        return Process(*(jnp.asarray(part, jnp.float32) for part in parts))
