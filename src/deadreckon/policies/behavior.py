"""Models of the policy that made a log, by maximum likelihood: BC learns them, BEAR and its kin constrain to them."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.normalizer import EDGE
from deadreckon.data.spec import Spec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.nets.vae import VAE
from deadreckon.policies.candidates import VAEDecoder
from deadreckon.policies.kinds import Categorical, ClippedGaussian, Gaussian, TanhMeanGaussian, stochastic
from deadreckon.policies.policy import NormalizedPolicy

Kind = Literal["gaussian", "vae"]


class Clipped(eqx.Module):
    """A Gaussian with one deviation an action, as DAPG's policies are, whose draws are clipped.

    `loss` fits it as if there were no bounds, `censored` with them.

    Attributes:
        means: network.
        log_std: (a,) log-deviations.
    """

    means: MLP
    log_std: Float[Array, "a"]

    @classmethod
    def create(cls, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> "Clipped":
        """Fresh, with deviations of one."""
        return cls(MLP.create(spec.observation_size, hidden, spec.action_size, key), jnp.zeros(spec.action_size))


def create(kind: Kind, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> MLP | VAE:
    """A tanh-Gaussian network (thesis A.4) or a conditional VAE (BCQ, the official BEAR)."""
    if kind == "vae":
        return VAE.create(spec.observation_size, spec.action_size, hidden, key)
    return MLP.create(spec.observation_size, hidden, 2 * spec.action_size, key)


def loss(
    model: MLP | VAE | Clipped | TanhMeanGaussian | Categorical,
    observation: Float[Array, "b o"],
    action: Array,
    key: PRNGKeyArray,
) -> tuple[Float[Array, ""], dict[str, Array]]:
    """What fitting minimises: the negative log-likelihood, or the VAE's bound (squared error + 0.5 KL)."""
    if isinstance(model, VAE):
        return model.loss(observation, action, key)
    if isinstance(model, Categorical):
        nll = -model.log_prob(observation, action).mean()
        return nll, {"behavior_nll": nll}
    if isinstance(model, TanhMeanGaussian):
        nll = -model.log_likelihood(observation, action).mean()
        return nll, {"behavior_nll": nll, "behavior_error": jnp.square(jnp.tanh(model.net(observation)) - action).mean()}
    if isinstance(model, Clipped):
        nll = -Gaussian.of(model.means, _deviations(model)).log_prob(observation, action).mean()
        return nll, {"behavior_nll": nll, "behavior_error": jnp.square(model.means(observation) - action).mean()}
    d = dist.gaussian_head(model(observation))
    nll = -dist.log_prob(d, jnp.arctanh(action)).mean()
    return nll, {"behavior_nll": nll, "behavior_error": jnp.square(jnp.tanh(d.mean) - action).mean()}


def log_prob(model: MLP | Clipped | Categorical, observation: Float[Array, "b o"], action: Array) -> Float[Array, "b"]:
    """Log-probability of each row's action: of an index, or its density over [-1, 1]; of a `Clipped` as what was clipped."""
    if isinstance(model, Categorical):
        return model.log_prob(observation, action)
    if isinstance(model, Clipped):
        return _clipped(model).log_prob(observation, action)
    return dist.log_prob(dist.gaussian_head(model(observation)), jnp.arctanh(action))


def clipped_rank(model: Clipped, observation: Float[Array, "b o"], action: Float[Array, "b a"]) -> Float[Array, "b a"]:
    """The probability that each number of an action is below the given one, and half of that it is equal, for actions within
    [-1, 1] (the probability integral transform)."""
    below = norm.cdf(action, model.means(observation), jnp.exp(_deviations(model)))
    return jnp.where(action >= EDGE, 0.5 * (1.0 + below), jnp.where(action <= -EDGE, 0.5 * below, below))


def censored(
    model: Clipped, observation: Float[Array, "b o"], action: Array, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Array]]:
    """The negative log-likelihood of what was clipped: at a bound the probability of all beyond it (Tobin 1958)."""
    nll = -_clipped(model).log_prob(observation, action).mean()
    return nll, {"behavior_nll": nll}


def policy(model: MLP | VAE | Clipped | TanhMeanGaussian | Categorical) -> NormalizedPolicy:
    """The model as something that acts."""
    if isinstance(model, Clipped):
        return _clipped(model)
    return VAEDecoder(model) if isinstance(model, VAE) else stochastic(model)


def draws(model: MLP | VAE, observation: Float[Array, "b o"], key: PRNGKeyArray, count: int) -> Float[Array, "n b a"]:
    """`count` actions of the model at each observation, before the tanh."""
    return policy(model).pre_actions(observation, key, greedy=False, count=(count,))


def _clipped(model: Clipped) -> ClippedGaussian:
    return ClippedGaussian.of(model.means, _deviations(model))


def _deviations(model: Clipped) -> Array:
    """Log-deviations in the range of a tanh-Gaussian's: an action that is always the same has none otherwise."""
    return jnp.clip(model.log_std, dist.LOG_STD_MIN, dist.LOG_STD_MAX)
