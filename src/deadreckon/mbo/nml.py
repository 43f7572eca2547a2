"""Discretised models of the score, and their normalised maximum likelihood distribution (thesis 6.3)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from deadreckon.nets.mlp import LECUN, MLP


class Net(eqx.Module):
    """A distribution over K bins.

    Attributes:
        mlp: with the output mu, the mean of a logistic distribution (`logistic`), or K logits (`categorical`).
        log_scale: of the logistic distribution; unused otherwise.
        bins: K.
    """

    mlp: MLP
    log_scale: Float[Array, ""]
    bins: int = eqx.field(static=True)

    @classmethod
    def create(cls, size: int, hidden: tuple[int, ...], bins: int, logistic: bool, key: Any) -> "Net":
        """An initial network, LeCun's with zero biases; the scale of a logistic is at first a tenth of the data's range."""
        mlp = MLP.create(size, hidden, 1 if logistic else bins, key, activation="softplus", init=LECUN)
        return cls(mlp, jnp.log(jnp.float32(0.1)), bins)

    @property
    def logistic(self) -> bool:
        """Whether it is logistic, and not categorical."""
        return self.mlp.biases[-1].shape[-1] == 1

    def log_probs(self, x: Float[Array, "b z"]) -> Float[Array, "b k"]:
        """Log-probabilities of all bins."""
        out = self.mlp(x)
        return bin_log_probs(out[..., 0], self.log_scale, self.bins) if self.logistic else jax.nn.log_softmax(out)

    def internal(self, x: Float[Array, "b z"]) -> Float[Array, "b"]:
        """The objective of the search: mu, whose gradient has the direction of the mean's and does not vanish (Proposition
        6.3.1), or the mean if the distribution is categorical."""
        if self.logistic:
            return self.mlp(x)[..., 0]
        return jax.nn.softmax(self.mlp(x)) @ middles(self.bins)


def middles(bins: int) -> Float[Array, "k"]:
    """Middles of the bins, for scores scaled such that those of the data range from 0 to 1."""
    return (jnp.arange(bins) + 0.5) / bins


def _arguments(mu: Array, log_scale: Array, bins: int) -> Float[Array, "b k1"]:
    """The arguments of the sigmoids o_k, k = 1 .. K - 1."""
    return (mu[..., None] - jnp.arange(1, bins) / bins) / jnp.exp(log_scale)


def bin_log_probs(mu: Array, log_scale: Array, bins: int) -> Float[Array, "b k"]:
    """log(o_k - o_{k+1}), by sigmoid(a) - sigmoid(b) = sigmoid(a) sigmoid(-b) (1 - e^(b - a)), which avoids cancellation."""
    a = _arguments(mu, log_scale, bins)
    above, below = jax.nn.log_sigmoid(a), jax.nn.log_sigmoid(-a)
    gap = jnp.log(-jnp.expm1(-1.0 / (bins * jnp.exp(log_scale))))
    inner = above[..., :-1] + below[..., 1:] + gap
    return jnp.concatenate([below[..., :1], inner, above[..., -1:]], -1)


def quantise(u: Array, bins: int) -> Int[Array, "b"]:
    """The bin, 0 .. K - 1, of each scaled score; the greatest belongs to the last, and scores outside to the nearest."""
    return jnp.clip(jnp.floor(u * bins), 0, bins - 1).astype(jnp.int32)


def nll(net: Net, x: Array, label: Array) -> Float[Array, "b"]:
    """Negative log-likelihood of the bins `label`."""
    return -jnp.take_along_axis(net.log_probs(x), label[..., None], -1)[..., 0]


def cross_entropy(net: Net, x: Array, label: Array) -> Float[Array, "b"]:
    """Sum over k of the binary cross-entropies of o_k and whether the bin is k or higher: the loss as printed in 6.3."""
    a = _arguments(net.mlp(x)[..., 0], net.log_scale, net.bins)
    # -log(1 - o) = softplus(a), and -log(o) = softplus(a) - a.
    return (jax.nn.softplus(a) - jnp.where(jnp.arange(1, net.bins) <= label[..., None], a, 0.0)).sum(-1)


def p_nml(nets: Net, x: Float[Array, "b z"]) -> Float[Array, "b k"]:
    """Log of the normalised maximum likelihood distribution: each bin's probability under its own model, normalised."""
    own = jax.vmap(lambda net: net.log_probs(x))(nets)  # (K models, b, K bins)
    return jax.nn.log_softmax(jnp.diagonal(own, axis1=0, axis2=2), -1)


def reached(probs: Float[Array, "b k"], confidence: float) -> Float[Array, "b"]:
    """The scaled score that is exceeded with a probability of `confidence`, by distributions that are uniform within bins."""
    bins = probs.shape[-1]
    beyond = jnp.concatenate([jnp.cumsum(probs[..., ::-1], -1)[..., ::-1], jnp.zeros_like(probs[..., :1])], -1)
    # The last bin whose lower edge is exceeded with at least this probability.
    k = jnp.clip((beyond[..., :-1] >= confidence).sum(-1) - 1, 0, bins - 1)[..., None]
    upper, lower = (jnp.take_along_axis(beyond, k + i, -1)[..., 0] for i in (0, 1))
    return (k[..., 0] + (upper - confidence) / jnp.maximum(upper - lower, 1e-12)) / bins
