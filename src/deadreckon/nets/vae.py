"""The conditional variational autoencoder of BCQ and BEAR: actions given observations."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.nets.mlp import MLP
from deadreckon.randomness import keys

LOG_STD_MIN, LOG_STD_MAX = -4.0, 15.0  # of the latent, as in the official code
LATENT_CLIP = 0.5  # latents drawn at decoding time are clamped, so that decoded actions stay near the data


class VAE(eqx.Module):
    """Encoder (s, a) -> latent and decoder (s, z) -> the action before its tanh.

    Attributes:
        encoder: MLP with 2 x latent outputs.
        decoder: MLP with action-size outputs, before the tanh.
    """

    encoder: MLP
    decoder: MLP

    @classmethod
    def create(cls, observations: int, actions: int, hidden: tuple[int, ...], key: PRNGKeyArray) -> "VAE":
        """Latent size is twice the action's (BCQ, BEAR)."""
        ke, kd = keys(key, "encoder", "decoder")
        latent = 2 * actions
        return cls(
            MLP.create(observations + actions, hidden, 2 * latent, ke),
            MLP.create(observations + latent, hidden, actions, kd),
        )

    def decode(self, observation: Float[Array, "b o"], latent: Float[Array, "*n b z"]) -> Float[Array, "*n b a"]:
        """Actions before the tanh."""
        return self.decoder.beside(observation, latent)

    def sample(self, observation: Float[Array, "b o"], key: PRNGKeyArray, count: tuple[int, ...] = ()) -> Array:
        """Decoded actions BEFORE the tanh, `count` a state, from clamped standard-normal latents."""
        size = self.decoder.weights[0].shape[0] - observation.shape[-1]
        return self.from_noise(observation, jax.random.normal(key, (*count, *observation.shape[:-1], size)))

    def from_noise(self, observation: Float[Array, "b o"], noise: Float[Array, "*n b z"]) -> Float[Array, "*n b a"]:
        """Actions before the tanh, decoded from standard normal noise that is clamped."""
        return self.decode(observation, jnp.clip(noise, -LATENT_CLIP, LATENT_CLIP))

    def loss(
        self, observation: Float[Array, "b o"], action: Float[Array, "b a"], key: PRNGKeyArray, kl_weight: float = 0.5
    ) -> tuple[Float[Array, ""], dict[str, Array]]:
        """Mean squared error of the reconstruction plus `kl_weight` times the KL to N(0, 1), both means over all entries."""
        mean, log_std = jnp.split(self.encoder(jnp.concatenate([observation, action], -1)), 2, -1)
        log_std = jnp.clip(log_std, LOG_STD_MIN, LOG_STD_MAX)
        latent = mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)
        error = jnp.square(jnp.tanh(self.decode(observation, latent)) - action).mean()
        divergence = -0.5 * (1.0 + 2.0 * log_std - jnp.square(mean) - jnp.exp(2.0 * log_std)).mean()
        return error + kl_weight * divergence, {"behavior_error": error, "behavior_kl": divergence}
