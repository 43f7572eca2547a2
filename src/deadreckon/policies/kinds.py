"""The kinds of policy that agents produce, in a method's coordinates."""

from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from deadreckon.data.normalizer import EDGE
from deadreckon.data.spec import Spec
from deadreckon.data.step import Step
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.nets.vae import VAE
from deadreckon.policies.policy import NormalizedPolicy


class Deterministic(NormalizedPolicy):
    """a = tanh(net(s))."""

    net: MLP

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`; every draw is the same."""
        out = self.net(observation)
        return jnp.broadcast_to(out, (*count, *out.shape))


class Sampler(NormalizedPolicy):
    """A policy whose draws are a function of the observation and of noise: it implements `from_noise` and `noise_size`."""

    @property
    def noise_size(self) -> int:
        """Numbers of noise an action takes."""
        raise NotImplementedError

    def from_noise(self, observation: Float[Array, "n o"], noise: Float[Array, "*c #n z"]) -> Float[Array, "*c n a"]:
        """Draws before the tanh from standard normal noise."""
        raise NotImplementedError

    def drawn(self, observation: Float[Array, "n o"], key: PRNGKeyArray, count: tuple[int, ...]) -> Float[Array, "*c n a"]:
        """`count` draws before the tanh at every observation."""
        return self.from_noise(observation, jax.random.normal(key, (*count, len(observation), self.noise_size)))


def fixed_noise(count: int, size: int) -> Float[Array, "c z"]:
    """Standard normal noise that a policy keeps, so that its greedy actions are a function of the state: always the same."""
    return jnp.asarray(np.random.default_rng(0).standard_normal((count, size)), jnp.float32)


class TanhGaussian(Sampler):
    """a = tanh(mean + std * noise); greedy is tanh(mean).

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


class Gaussian(NormalizedPolicy):
    """a = mean + std * noise without bounds, as published policies have it; the environment clips. Greedy is the mean."""

    net: MLP
    has_log_prob = True

    @classmethod
    def of(cls, means: MLP, log_std: Float[Array, "a"]) -> Self:
        """With a network to the means, and log-deviations that no observation changes."""
        weight, bias = means.weights[-1], means.biases[-1]
        weights = *means.weights[:-1], jnp.concatenate([weight, jnp.zeros_like(weight)], -1)
        return cls(MLP(weights, (*means.biases[:-1], jnp.concatenate([bias, log_std])), means.activation))

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; the action is not squashed."""
        return self.pre_actions(step.observation, key, greedy=greedy), carry

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        mean, log_std = jnp.split(self.net(observation), 2, axis=-1)
        if greedy:
            return jnp.broadcast_to(mean, (*count, *mean.shape))
        return dist.sample(dist.Gaussian(mean, log_std), key, count)

    def log_prob(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Log-density of actions."""
        mean, log_std = jnp.split(self.net(observation), 2, axis=-1)
        return _log_densities(mean, log_std, action).sum(-1)


def _log_densities(mean: Array, log_std: Array, action: Array) -> Array:
    """Of each number of an action, under a Gaussian."""
    z = (action - mean) * jnp.exp(-log_std)
    return -0.5 * jnp.square(z) - log_std - 0.5 * jnp.log(2 * jnp.pi)


class ClippedGaussian(Gaussian):
    """A `Gaussian` whose draws are cut to [-1, 1]; each bound has the probability of all that lies beyond."""

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`."""
        return jnp.clip(self.pre_actions(step.observation, key, greedy=greedy), -1.0, 1.0), carry

    def log_prob(self, observation: Float[Array, "*n o"], action: Float[Array, "*c a"]) -> Float[Array, "*c"]:
        """Sum of log-densities of actions between the bounds, and log-probabilities of those at them."""
        mean, log_std = jnp.split(self.net(observation), 2, axis=-1)
        beyond = jax.scipy.stats.norm.logcdf((jnp.sign(action) * mean - 1.0) * jnp.exp(-log_std))
        return jnp.where(jnp.abs(action) >= EDGE, beyond, _log_densities(mean, log_std, action)).sum(-1)


class VAEDecoder(Sampler):
    """a = tanh(decode(s, z)) with z a clamped standard normal; greedy decodes z = 0."""

    vae: VAE

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        if greedy:
            return self.from_noise(observation, jnp.zeros((*count, len(observation), self.noise_size)))
        return self.drawn(observation, key, count)

    @property
    def noise_size(self):
        """See `Sampler`."""
        return self.vae.encoder.biases[-1].shape[-1] // 2

    def from_noise(self, observation, noise):
        """See `Sampler`."""
        return self.vae.from_noise(observation, noise)


def perturbed(
    network: MLP, largest: Any, observation: Float[Array, "n o"], action: Float[Array, "*c n a"]
) -> Float[Array, "*c n a"]:
    """Actions in [-1, 1], each changed by `largest` tanh(network(s, a)) and kept within."""
    return jnp.clip(action + largest * jnp.tanh(network.beside(observation, action)), -1.0, 1.0)


class PerturbedPolicy(Sampler):
    """Actions of a VAE, each changed a little by a perturbation network (BCQ's).

    Attributes:
        vae: samples actions.
        perturbation: network of observation and action, to the direction in which an action changes.
        max_perturbation: how far it changes at most.
    """

    vae: VAE
    perturbation: MLP
    max_perturbation: Array

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        if greedy:
            return self.from_noise(observation, jnp.zeros((*count, len(observation), self.noise_size)))
        return self.drawn(observation, key, count)

    @property
    def noise_size(self):
        """See `Sampler`."""
        return VAEDecoder(self.vae).noise_size

    def from_noise(self, observation, noise):
        """See `Sampler`."""
        action = jnp.tanh(self.vae.from_noise(observation, noise))
        action = perturbed(self.perturbation, self.max_perturbation, observation, action)
        return jnp.arctanh(jnp.clip(action, -EDGE, EDGE))


class OneStep(Sampler):
    """a = net(s, z), cut to [-1, 1], with z standard normal (FQL's); greedy is z = 0, the middle of the noise."""

    net: MLP

    def actions(self, observation: Float[Array, "n o"], noise: Float[Array, "*c #n a"]) -> Float[Array, "*c n a"]:
        """Actions in [-1, 1] from noise."""
        return jnp.clip(self.net.beside(observation, noise), -1.0, 1.0)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        if greedy:
            return self.from_noise(observation, jnp.zeros((*count, len(observation), self.noise_size)))
        return self.drawn(observation, key, count)

    @property
    def noise_size(self):
        """See `Sampler`."""
        return self.net.biases[-1].shape[-1]

    def from_noise(self, observation, noise):
        """See `Sampler`."""
        return jnp.arctanh(jnp.clip(self.actions(observation, noise), -EDGE, EDGE))


class Categorical(NormalizedPolicy):
    """A choice among discrete actions by a network's logits; greedy is the likeliest."""

    net: MLP
    has_log_prob = True

    @classmethod
    def create(cls, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> "Categorical":
        """A fresh network."""
        return cls(MLP.create(spec.observation_size, hidden, spec.action_size, key))

    def probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action."""
        return jax.nn.softmax(self.net(observation))

    def log_probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """Its logarithm."""
        return jax.nn.log_softmax(self.net(observation))

    def log_prob(self, observation: Float[Array, "n o"], action: Int[Array, "n"]) -> Float[Array, "n"]:
        """Log-probability of one action each."""
        return jnp.take_along_axis(self.log_probs(observation), action[:, None], -1)[:, 0]

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`."""
        logits = self.net(step.observation)
        return (logits.argmax(-1) if greedy else jax.random.categorical(key, logits)).astype(jnp.int32), carry


def create_actor(spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> MLP | Categorical:
    """A stochastic actor: a network to mean and log-deviation before the tanh, or the logits of discrete actions."""
    if spec.discrete:
        return Categorical.create(spec, hidden, key)
    return MLP.create(spec.observation_size, hidden, 2 * spec.action_size, key)


def stochastic(actor: MLP | Categorical) -> NormalizedPolicy:
    """What `create_actor` made as a policy; greedy is its mean, or its likeliest action."""
    return actor if isinstance(actor, Categorical) else TanhGaussian(actor)


class ThresholdedPolicy(NormalizedPolicy):
    """Of the discrete actions that a model of the log finds likely enough, the best by a critic (discrete BCQ).

    Attributes:
        behavior: the model.
        critic: to a value per action.
        threshold: smallest probability of an action, relative to the most probable one's.
    """

    behavior: Categorical
    critic: MLP
    threshold: Array

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; nothing is drawn."""
        allowed = probable_enough(self.behavior, self.threshold, step.observation)
        values = jnp.where(allowed, self.critic(step.observation), -jnp.inf)
        return values.argmax(-1).astype(jnp.int32), carry

    def probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action: all of it on one."""
        step = Step(observation, None, None)
        chosen, _ = self.act(step, (), jax.random.key(0), greedy=True)
        return jax.nn.one_hot(chosen, self.critic.biases[-1].shape[-1])


def probable_enough(behavior: Categorical, threshold: Any, observation: Float[Array, "n o"]) -> Bool[Array, "n c"]:
    """Which actions have at least `threshold` times the probability of the most probable one."""
    log_probs = behavior.log_probs(observation)
    return log_probs >= log_probs.max(-1, keepdims=True) + jnp.log(threshold)


class GreedyQ(NormalizedPolicy):
    """The best of several actions of `actor` by the first critic (thesis 4.3, test time; A.4).

    Attributes:
        actor: samples the candidates.
        critic: compares them.
        noise: (samples, z) from which candidates are made when `greedy`, the same in every state; else they are drawn.
    """

    actor: Sampler
    critic: MLP
    noise: Float[Array, "c z"]

    @classmethod
    def of(cls, actor: Sampler, critic: MLP, samples: int) -> Self:
        """With as many candidates."""
        return cls(actor, critic, fixed_noise(samples, actor.noise_size))

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        samples, size = self.noise.shape
        if greedy:
            noise = self.noise.reshape(samples, *[1] * (len(count) + 1), size)
            pre = self.actor.from_noise(observation, jnp.broadcast_to(noise, (samples, *count, len(observation), size)))
        else:
            pre = self.actor.drawn(observation, key, (samples, *count))
        critics = jax.tree.map(lambda w: w[None], self.critic)
        q = q_values(critics, observation, jnp.tanh(pre))[0]
        best = jnp.argmax(q, 0)
        return jnp.take_along_axis(pre, best[None, ..., None], 0)[0]
