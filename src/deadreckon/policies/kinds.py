"""Policies that are a distribution whose parameters a network gives, in a method's coordinates; see `candidates` for others."""

from typing import Any, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Array, Float, Int, PRNGKeyArray

from deadreckon.data.normalizer import EDGE
from deadreckon.data.spec import Spec
from deadreckon.nets import distributions as dist
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.mlp import MLP, UNIFORM, Init
from deadreckon.policies.policy import NormalizedPolicy


class Deterministic(NormalizedPolicy):
    """One action for each observation, a = tanh(net(s))."""

    net: MLP | LayerNormMLP

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`; every draw is the same."""
        out = self.net(observation)
        return jnp.broadcast_to(out, (*count, *out.shape))


class UnboundedDeterministic(Deterministic):
    """One action for each observation without bounds, a = net(s), as in published policies."""

    def actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`; not squashed."""
        return self.pre_actions(observation, key, greedy=greedy, count=count)


class Sampler(NormalizedPolicy):
    """A policy whose draws are a function of the observation and of noise: it implements `from_noise` and `noise_size`.

    Greedy is no noise.
    """

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        if greedy:
            return self.from_noise(observation, jnp.zeros((*count, observation.shape[0], self.noise_size)))
        return self.drawn(observation, key, count)

    @property
    def noise_size(self) -> int:
        """Numbers of noise an action takes."""
        raise NotImplementedError

    def from_noise(self, observation: Float[Array, "n o"], noise: Float[Array, "*c #n z"]) -> Float[Array, "*c n a"]:
        """Draws before the tanh from standard normal noise."""
        raise NotImplementedError

    def drawn(self, observation: Float[Array, "n o"], key: PRNGKeyArray, count: tuple[int, ...]) -> Float[Array, "*c n a"]:
        """`count` draws before the tanh at every observation."""
        return self.from_noise(observation, jax.random.normal(key, (*count, observation.shape[0], self.noise_size)))


class TanhGaussian(Sampler):
    """A Gaussian bent to bounds by tanh, a = tanh(mean + std * noise); greedy is tanh(mean).

    Attributes:
        net: to mean and log-deviation.
        log_std: the range that log-deviations are clipped to.
    """

    net: MLP
    log_std: tuple[float, float] = eqx.field(static=True, default=(dist.LOG_STD_MIN, dist.LOG_STD_MAX))
    has_log_prob = True

    def _head(self, observation: Float[Array, "*n o"]) -> dist.Gaussian:
        return dist.gaussian_head(self.net(observation), *self.log_std)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        d = self._head(observation)
        if greedy:
            return jnp.broadcast_to(d.mean, (*count, *d.mean.shape))
        return dist.sample(d, key, count)

    @property
    def noise_size(self):
        """See `Sampler`."""
        return self.net.biases[-1].shape[-1] // 2

    def from_noise(self, observation, noise):
        """See `Sampler`."""
        d = self._head(observation)
        return d.mean + jnp.exp(d.log_std) * noise

    def log_prob(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Log-density over [-1, 1] of actions, clipped to the open interval."""
        return dist.log_prob(self._head(observation), jnp.arctanh(jnp.clip(action, -EDGE, EDGE)))

    def log_likelihood(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """The same, which imitation maximises."""
        return self.log_prob(observation, action)


class Gaussian(NormalizedPolicy):
    """a = mean + std * noise without bounds, as in published policies; `EnvPolicy` clips to the environment's bounds.

    Greedy is the mean.
    """

    net: MLP
    has_log_prob = True

    @classmethod
    def of(cls, means: MLP, log_std: Float[Array, "a"]) -> Self:
        """With a network to the means, and log-deviations that no observation changes."""
        weight, bias = means.weights[-1], means.biases[-1]
        weights = *means.weights[:-1], jnp.concatenate([weight, jnp.zeros_like(weight)], -1)
        return cls(MLP(weights, (*means.biases[:-1], jnp.concatenate([bias, log_std])), means.activation))

    def _head(self, observation: Float[Array, "*n o"]) -> dist.Gaussian:
        return dist.Gaussian(*jnp.split(self.net(observation), 2, axis=-1))

    def actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`; not squashed."""
        return self.pre_actions(observation, key, greedy=greedy, count=count)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        d = self._head(observation)
        return jnp.broadcast_to(d.mean, (*count, *d.mean.shape)) if greedy else dist.sample(d, key, count)

    def log_prob(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Log-density of actions."""
        return self.log_likelihood(observation, action)

    def log_likelihood(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Log-density of actions before anything is clipped, which imitation maximises."""
        return _log_densities(self._head(observation), action).sum(-1)


def _log_densities(d: dist.Gaussian, action: Array) -> Array:
    """Of each number of an action, under a Gaussian."""
    z = (action - d.mean) * jnp.exp(-d.log_std)
    return -0.5 * jnp.square(z) - d.log_std - 0.5 * jnp.log(2 * jnp.pi)


class ClippedGaussian(Gaussian):
    """A `Gaussian` whose draws are clipped to [-1, 1]; each bound has the probability of everything beyond it."""

    def actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        return jnp.clip(self.pre_actions(observation, key, greedy=greedy, count=count), -1.0, 1.0)

    def log_prob(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Sum of log-densities of actions between the bounds, and log-probabilities of those at them."""
        d = self._head(observation)
        beyond = jax.scipy.stats.norm.logcdf((jnp.sign(action) * d.mean - 1.0) * jnp.exp(-d.log_std))
        return jnp.where(jnp.abs(action) >= EDGE, beyond, _log_densities(d, action)).sum(-1)


class TanhMeanGaussian(ClippedGaussian):
    """A `ClippedGaussian` around tanh(net(s)) with one deviation an action, as IQL's, XQL's and AWAC's authors have it.

    The likelihood of a logged action at a bound is that of a Gaussian in the space of actions: finite, where `TanhGaussian` has
    the value before a tanh that was clipped. Greedy is tanh(net(s)).

    Attributes:
        net: to the means before their tanh.
        log_std: (a,) log-deviations.
    """

    log_std: Float[Array, "a"]

    @classmethod
    def create(cls, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray, std: Any = 1.0, init: Init = UNIFORM) -> Self:
        """A fresh network, and deviations of `std`."""
        log_std = jnp.full(spec.action_size, jnp.log(jnp.asarray(std, jnp.float32)))
        return cls(MLP.create(spec.observation_size, hidden, spec.action_size, key, init=init), log_std)

    def _head(self, observation):
        mean = jnp.tanh(self.net(observation))
        log_std = jnp.clip(self.log_std, dist.LOG_STD_MIN, dist.LOG_STD_MAX)
        return dist.Gaussian(mean, jnp.broadcast_to(log_std, mean.shape))

    def log_truncated(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Log-density of actions under the Gaussian truncated to [-1, 1], whose mass within the bounds is 1."""
        d = self._head(observation)
        std = jnp.exp(d.log_std)
        within = ndtr((1.0 - d.mean) / std) - ndtr((-1.0 - d.mean) / std)
        return self.log_likelihood(observation, action) - jnp.log(within).sum(-1)


class Categorical(NormalizedPolicy):
    """A choice among discrete actions by a network's logits; the greedy action is the most probable one."""

    net: MLP
    has_log_prob = True

    @classmethod
    def create(cls, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray, init: Init = UNIFORM) -> "Categorical":
        """A fresh network."""
        return cls(MLP.create(spec.observation_size, hidden, spec.action_size, key, init=init, mask=spec.mask_size))

    def probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action."""
        return jax.nn.softmax(self.net(observation))

    def log_probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """Its logarithm."""
        return jax.nn.log_softmax(self.net(observation))

    def log_prob(self, observation: Float[Array, "n o"], action: Int[Array, "n"]) -> Float[Array, "n"]:
        """Log-probability of one action each."""
        return jnp.take_along_axis(self.log_probs(observation), action[:, None], -1)[:, 0]

    def log_likelihood(self, observation: Float[Array, "n o"], action: Int[Array, "n"]) -> Float[Array, "n"]:
        """The same, which imitation maximises."""
        return self.log_prob(observation, action)

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`."""
        logits = self.net(step.observation)
        return (logits.argmax(-1) if greedy else jax.random.categorical(key, logits)).astype(jnp.int32), carry


Likelihood = Literal["normal", "tanh_normal"]
"""Of logged actions: a normal distribution around tanh of a network with one deviation an action (`TanhMeanGaussian`), or one
before the tanh (`TanhGaussian`), under which actions at the bounds are far away from all others."""


def create_actor(spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray, init: Init = UNIFORM) -> MLP | Categorical:
    """A stochastic actor: a network to mean and log-deviation before the tanh, or the logits of discrete actions."""
    if spec.discrete:
        return Categorical.create(spec, hidden, key, init)
    return MLP.create(spec.observation_size, hidden, 2 * spec.action_size, key, init=init)


def create_imitator(
    spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray, likelihood: Likelihood, std: Any = 1.0, init: Init = UNIFORM
) -> MLP | Categorical | TanhMeanGaussian:
    """A stochastic actor that learns by a likelihood of logged actions; `std` is the first deviation of a normal one."""
    if likelihood == "normal" and not spec.discrete:
        return TanhMeanGaussian.create(spec, hidden, key, std, init)
    return create_actor(spec, hidden, key, init)


def stochastic(actor: MLP | Categorical | TanhMeanGaussian) -> TanhGaussian | Categorical | TanhMeanGaussian:
    """A policy from `create_actor` or `create_imitator`; its greedy action is the mean, or the most probable one."""
    return TanhGaussian(actor) if isinstance(actor, MLP) else actor
