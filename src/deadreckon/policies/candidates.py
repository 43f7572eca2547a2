"""Generative models of the log's actions as policies, and policies that choose among candidates by a critic."""

import math
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from deadreckon.data.normalizer import EDGE
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.nets.vae import VAE
from deadreckon.policies.kinds import Categorical, Sampler
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.policies.portable import CANDIDATES


def fixed_noise(count: int, size: int) -> Float[Array, "c z"]:
    """Standard normal noise that a policy keeps, so that its greedy actions are a function of the state: always the same."""
    return jnp.asarray(np.random.default_rng(0).standard_normal((count, size)), jnp.float32)


class VAEDecoder(Sampler):
    """a = tanh(decode(s, z)) with z a clamped standard normal; greedy decodes z = 0."""

    vae: VAE

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

    def decode(self, observation: Float[Array, "n o"], noise: Float[Array, "*c #n a"]) -> Float[Array, "*c n a"]:
        """Actions in [-1, 1] from noise."""
        return jnp.clip(self.net.beside(observation, noise), -1.0, 1.0)

    @property
    def noise_size(self):
        """See `Sampler`."""
        return self.net.biases[-1].shape[-1]

    def from_noise(self, observation, noise):
        """See `Sampler`."""
        return jnp.arctanh(jnp.clip(self.decode(observation, noise), -EDGE, EDGE))


class GreedyActions(NormalizedPolicy):
    """The best of all discrete actions by a critic (Q-learning).

    Attributes:
        critic: to a value per action.
    """

    critic: MLP

    def values(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """What every action is compared by."""
        return self.critic(observation)

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; nothing is drawn."""
        return self.values(step.observation).argmax(-1).astype(jnp.int32), carry

    def probs(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action: all of it on one."""
        values = self.values(observation)
        return jax.nn.one_hot(values.argmax(-1), values.shape[-1])


class ThresholdedPolicy(GreedyActions):
    """Of the discrete actions that a model of the log finds likely enough, the best by a critic (discrete BCQ).

    Attributes:
        behavior: the model.
        threshold: smallest probability of an action, relative to the most probable one's.
    """

    behavior: Categorical
    threshold: Array

    def values(self, observation):
        """See `GreedyActions`; minus infinity for those that are not likely enough."""
        return jnp.where(probable_enough(self.behavior, self.threshold, observation), self.critic(observation), -jnp.inf)


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
        rows, (samples, size) = observation.shape[0], self.noise.shape
        shape = (samples, *count, rows, size)
        if greedy:
            noise = jnp.broadcast_to(self.noise.reshape(samples, *[1] * (len(count) + 1), size), shape)
        else:
            noise = jax.random.normal(key, shape)
        each = samples * math.prod(count)
        if not isinstance(rows, int) or rows * each <= CANDIDATES:  # the number of rows of an exported policy has no value
            return self._best(observation, noise)
        one = lambda row: self._best(row[0][None], row[1][..., None, :])[..., 0, :]  # noqa: E731
        found = jax.lax.map(one, (observation, jnp.moveaxis(noise, -2, 0)), batch_size=max(CANDIDATES // each, 1))
        return jnp.moveaxis(found, 0, -2)

    def _best(self, observation: Float[Array, "n o"], noise: Float[Array, "c *k n z"]) -> Float[Array, "*k n a"]:
        """The best candidates from noise, before the tanh."""
        pre = self.actor.from_noise(observation, noise)
        critics = jax.tree.map(lambda w: w[None], self.critic)
        best = jnp.argmax(q_values(critics, observation, jnp.tanh(pre))[0], 0)
        return jnp.take_along_axis(pre, best[None, ..., None], 0)[0]
