"""Discretised models of the score, and what they say together: normalised maximum likelihood (thesis 6.3)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from deadreckon.nets.mlp import LECUN, MLP


class Net(eqx.Module):
    """A distribution over K bins.

    Attributes:
        mlp: to mu, the mean of a logistic distribution (`logistic`), or to K logits (`categorical`).
        log_scale: of the logistic distribution; unused otherwise.
        bins: K.
    """

    mlp: MLP
    log_scale: Float[Array, ""]
    bins: int = eqx.field(static=True)

    @classmethod
    def create(cls, size: int, hidden: tuple[int, ...], bins: int, logistic: bool, key: Any) -> "Net":
        """A fresh network, LeCun's with zero biases; a logistic's scale begins at a tenth of the data's range."""
        mlp = MLP.create(size, hidden, 1 if logistic else bins, key, activation="softplus", init=LECUN)
        return cls(mlp, jnp.log(jnp.float32(0.1)), bins)

    @property
    def logistic(self) -> bool:
        """Which of the two it is."""
        return self.mlp.biases[-1].shape[-1] == 1

    def log_probs(self, x: Float[Array, "b z"]) -> Float[Array, "b k"]:
        """Log-probabilities of all bins."""
        out = self.mlp(x)
        return bin_log_probs(out[..., 0], self.log_scale, self.bins) if self.logistic else jax.nn.log_softmax(out)

    def internal(self, x: Float[Array, "b z"]) -> Float[Array, "b"]:
        """What designs ascend: mu, which has the gradient's direction of the mean and no flat regions (Proposition 6.3.1)."""
        if self.logistic:
            return self.mlp(x)[..., 0]
        return jax.nn.softmax(self.mlp(x)) @ middles(self.bins)


def middles(bins: int) -> Float[Array, "k"]:
    """Middles of the bins, where the data reaches from 0 to 1."""
    return (jnp.arange(bins) + 0.5) / bins


def _arguments(mu: Array, log_scale: Array, bins: int) -> Float[Array, "b k1"]:
    """Of the sigmoids o_k, k = 1 .. K - 1."""
    return (mu[..., None] - jnp.arange(1, bins) / bins) / jnp.exp(log_scale)


def bin_log_probs(mu: Array, log_scale: Array, bins: int) -> Float[Array, "b k"]:
    """log(o_k - o_{k+1}), from sigmoid(a) - sigmoid(b) = sigmoid(a) sigmoid(-b) (1 - e^(b - a)), which does not cancel."""
    a = _arguments(mu, log_scale, bins)
    above, below = jax.nn.log_sigmoid(a), jax.nn.log_sigmoid(-a)
    gap = jnp.log(-jnp.expm1(-1.0 / (bins * jnp.exp(log_scale))))
    inner = above[..., :-1] + below[..., 1:] + gap
    return jnp.concatenate([below[..., :1], inner, above[..., -1:]], -1)


def quantise(u: Array, bins: int) -> Int[Array, "b"]:
    """The bin of each score, of 0 .. K - 1; the greatest belongs to the last, what lies beyond to the nearest."""
    return jnp.clip(jnp.floor(u * bins), 0, bins - 1).astype(jnp.int32)


def nll(net: Net, x: Array, label: Array) -> Float[Array, "b"]:
    """Negative log-likelihood of bins."""
    return -jnp.take_along_axis(net.log_probs(x), label[..., None], -1)[..., 0]


def cross_entropy(net: Net, x: Array, label: Array) -> Float[Array, "b"]:
    """Binary cross-entropy of each o_k with whether the bin is k or higher: what 6.3 prints as the loss."""
    a = _arguments(net.mlp(x)[..., 0], net.log_scale, net.bins)
    # -log(1 - o) is softplus(a), and -log o is a less.
    return (jax.nn.softplus(a) - jnp.where(jnp.arange(1, net.bins) <= label[..., None], a, 0.0)).sum(-1)


def p_nml(nets: Net, x: Float[Array, "b z"]) -> Float[Array, "b k"]:
    """Log of the normalised maximum likelihood distribution: each bin's probability under its own model, normalised."""
    own = jax.vmap(lambda net: net.log_probs(x))(nets)  # (K models, b, K bins)
    return jax.nn.log_softmax(jnp.diagonal(own, axis1=0, axis2=2), -1)


def reached(probs: Float[Array, "b k"], confidence: float) -> Float[Array, "b"]:
    """The score (on 0 .. 1) that is exceeded with a probability of `confidence`, probability spread evenly within bins."""
    bins = probs.shape[-1]
    beyond = jnp.concatenate([jnp.cumsum(probs[..., ::-1], -1)[..., ::-1], jnp.zeros_like(probs[..., :1])], -1)
    # The last bin at whose lower edge enough is still to come.
    k = jnp.clip((beyond[..., :-1] >= confidence).sum(-1) - 1, 0, bins - 1)[..., None]
    upper, lower = (jnp.take_along_axis(beyond, k + i, -1)[..., 0] for i in (0, 1))
    return (k[..., 0] + (upper - confidence) / jnp.maximum(upper - lower, 1e-12)) / bins
