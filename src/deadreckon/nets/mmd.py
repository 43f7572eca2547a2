"""Maximum mean discrepancy between two sets of action samples, per state (thesis 4.3, A.3, A.4)."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

Kernel = Literal["laplacian", "laplacian_l1", "gaussian", "mixture"]
Estimate = Literal["biased", "unbiased", "relative"]
FLOOR = 1e-6  # inside the root: the gradient stays finite where both sets agree (official code)


def _distance(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The root, with gradient zero instead of NaN at zero (a sample's distance to itself)."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def kernel_values(
    x: Float[Array, "n b a"], y: Float[Array, "m b a"], kernel: Kernel, bandwidth: Any, mixture: tuple[float, ...]
) -> Float[Array, "n m b"]:
    """k(x_i, y_j) for every state.

    Args:
        x, y: samples along the first axis.
        kernel: "laplacian" exp(-|d|_2 / bandwidth), the thesis's; "laplacian_l1" exp(-|d|_1 / (2 bandwidth)), that of the
            official code; "gaussian" exp(-|d|_2^2 / (2 bandwidth)), the bandwidth being the VARIANCE; "mixture" the mean
            of Laplacians at the scales of `mixture`.
        bandwidth: of the kernel, in the units of the samples (variance: squared).
        mixture: scales of "mixture".
    """
    difference = x[:, None] - y[None]
    if kernel == "laplacian_l1":
        return jnp.exp(-jnp.abs(difference).sum(-1) / (2.0 * bandwidth))
    squared = jnp.square(difference).sum(-1)
    if kernel == "gaussian":
        return jnp.exp(-squared / (2.0 * bandwidth))
    distance = _distance(squared)
    if kernel == "mixture":
        return sum(jnp.exp(-distance / scale) for scale in mixture) / len(mixture)  # pyrefly: ignore[bad-return]
    return jnp.exp(-distance / bandwidth)


def mmd(
    x: Float[Array, "n b a"],
    y: Float[Array, "m b a"],
    kernel: Kernel = "laplacian",
    bandwidth: Any = 20.0,
    mixture: tuple[float, ...] = (1.0, 10.0, 50.0),
) -> Float[Array, "b"]:
    """The root of the biased MMD^2 estimate for every state; see `squared_mmd` and `root`."""
    return root(squared_mmd(x, y, kernel, bandwidth, mixture))


def root(squared: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """sqrt(max(MMD^2, 0) + 1e-6)."""
    return jnp.sqrt(jnp.maximum(squared, 0.0) + FLOOR)


def squared_mmd(
    x: Float[Array, "n b a"],
    y: Float[Array, "m b a"],
    kernel: Kernel = "laplacian",
    bandwidth: Any = 20.0,
    mixture: tuple[float, ...] = (1.0, 10.0, 50.0),
    *,
    unbiased: bool = False,
) -> Float[Array, "b"]:
    """An estimate of MMD^2 for every state.

    mean k(x, x') - 2 mean k(x, y) + mean k(y, y'), diagonals included (thesis 4.3), so that two sets of draws from one
    distribution are apart by about its variance over the number of draws; or, `unbiased`, without the diagonals
    (Gretton et al. 2012, Lemma 6), which is zero in the mean then, and may be negative.
    """
    xx, xy, yy = (kernel_values(a, b, kernel, bandwidth, mixture).mean((0, 1)) for a, b in ((x, x), (x, y), (y, y)))
    if unbiased:  # k(x, x) is 1 for all kernels
        (n, m) = len(x), len(y)
        xx, yy = (n * xx - 1.0) / (n - 1), (m * yy - 1.0) / (m - 1)
    return xx - 2.0 * xy + yy


def estimated(
    estimate: Estimate,
    x: Float[Array, "n b a"],
    y: Float[Array, "m b a"],
    copies: Float[Array, "n b a"],
    kernel: Kernel,
    bandwidth: Any,
    mixture: tuple[float, ...],
) -> Float[Array, "b"]:
    """What a constraint bounds the mean over states of.

    Args:
        estimate: "biased": the root of the biased square (thesis 4.3); "unbiased": the unbiased SQUARE, of whose mean the root
            is to be taken; "relative": the biased root less that of `copies`, which is zero in the mean where x is drawn as y
            is. Of squares the last is MMD^2 - (E k(x, x') - E k(y, y')) / n in the mean: draws of a distribution that is
            narrower than that of y may be further away from it.
        x: samples of the policy.
        y: samples of the model of the log, or the logged action.
        copies: further samples of that model, as many as of the policy; used by "relative" alone.
        kernel, bandwidth, mixture: see `kernel_values`.
    """
    to_model = y, kernel, bandwidth, mixture
    if estimate == "unbiased":
        return squared_mmd(x, *to_model, unbiased=True)
    own = mmd(copies, *to_model) if estimate == "relative" else 0.0
    return mmd(x, *to_model) - own
