"""MINs: model inversion networks (Kumar and Levine 2020).

The inverse of the score, a generator x = G(z, y) of designs from noise and a score, is trained as a conditional Wasserstein GAN
with gradient penalty, with larger weights for high scores. Designs are generated for scores above those of the data, as far as
a forward model f agrees, by gradient ascent on

    y - l (f(G(z, y)) - y)^2 + log p(z) / size(z)      over z and y
"""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.forward import Gaussian, mean_of
from deadreckon.mbo.surrogate import score_weights
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.randomness import key_for, keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, TwoOrMore, UnitInterval, host, static

PENALTY = 10.0  # weight of the gradient penalty


class Pair(NamedTuple):
    """Generator and critic, with their optimiser states."""

    generator: MLP
    critic: MLP
    generator_opt: optax.OptState
    critic_opt: optax.OptState


def made(generator: MLP, z: Float[Array, "b l"], y: Float[Array, "b"]) -> Float[Array, "b z"]:
    """The generated designs, G(z, y)."""
    return generator(jnp.concatenate([z, y[:, None]], -1))


class Inversion(eqx.Module):
    """The learner: a conditional Wasserstein GAN with gradient penalty."""

    settings: "MINs"

    def needs(self, spec):
        """Batches of designs, scores and weights."""
        return BatchSpec(columns=(), batch_size=self.settings.batch_size)

    def init(self, spec, key):
        """Initial networks and optimiser states."""
        kg, kc = keys(key, "generator", "critic")
        settings = self.settings
        generator = MLP.create(settings.latent_size + 1, settings.hidden, spec.size, kg)
        critic = MLP.create(spec.size + 1, settings.hidden, 1, kc)
        return Pair(generator, critic, init_opt(generator), init_opt(critic))

    def update(self, state: Pair, batch: Batch, *, step, key):
        """One update of the critic, and after every `critic_updates` of them one of the generator."""
        assert batch.extra is not None
        x, y, weight = batch.extra["x"], batch.extra["y"], batch.extra["weight"]
        kz, ke = keys(key, "latent", "between")
        z = jax.random.normal(kz, (len(x), self.settings.latent_size))
        fake = made(state.generator, z, y)

        def discriminate(critic: MLP, x: Array) -> Array:
            return critic(jnp.concatenate([x, y[:, None]], -1))[:, 0]

        def critic_loss(critic: MLP) -> tuple[Array, Array]:
            share = jax.random.uniform(ke, (len(x), 1))
            between = share * x + (1 - share) * fake
            slope = jax.grad(lambda x: discriminate(critic, x).sum())(between)
            penalty = jnp.square(jnp.sqrt(jnp.square(slope).sum(-1) + 1e-12) - 1)
            gap = discriminate(critic, fake) - discriminate(critic, x)
            return (weight * (gap + PENALTY * penalty)).mean(), -(weight * gap).mean()

        grads, distance = jax.grad(critic_loss, has_aux=True)(state.critic)
        critic, critic_opt = apply_gradients(state.critic, grads, state.critic_opt, self.settings.lr)

        def turn(_: Any) -> tuple[MLP, optax.OptState]:
            loss = lambda generator: -(weight * discriminate(critic, made(generator, z, y))).mean()  # noqa: E731
            return apply_gradients(state.generator, jax.grad(loss)(state.generator), state.generator_opt, self.settings.lr)

        turns = self.settings.critic_updates
        keep = lambda _: (state.generator, state.generator_opt)  # noqa: E731
        generator, generator_opt = jax.lax.cond(step % turns == turns - 1, turn, keep, None)
        return Pair(generator, critic, generator_opt, critic_opt), {"distance": distance}


class MINs(Designer):
    """Model inversion networks."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"ascent": "ascent_steps", "latent": "latent_size", "turns": "critic_updates"}

    hidden: Sizes = static((1024, 1024))  # width of each hidden layer of generator and critic
    latent_size: Count = static(32)  # dimension of the noise
    steps: Count = host(20_000)  # updates of the critic
    critic_updates: Count = static(5)  # critic updates per generator update
    batch_size: Count = static(128)  # batch size (designs per update)
    lr: NonNegative = 2e-4  # learning rate of generator and critic
    bins: TwoOrMore = static(64)  # number of bins of the scores in which weights are computed
    smoothing: UnitInterval = 0.01  # smoothing of the bins' counts, as a share of the designs
    temperature: Positive = 0.1  # temperature of the bins' weights, in ranges of the scores
    forward_hidden: Sizes = static((256, 256))  # width of each hidden layer of the forward model
    forward_steps: Count = host(5000)  # updates of the forward model
    forward_lr: NonNegative = 3e-4  # learning rate of the forward model
    agreement: NonNegative = 1.0  # weight of the agreement of the forward model with the requested score
    ascent_steps: Count = host(100)  # gradient steps on noise and requested score
    ascent_lr: NonNegative = 0.02  # learning rate of these steps (Adam)

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Designs for scores that the inverse and the forward model agree on."""
        data, view = setting.data, setting.data.coordinates
        weight = {"weight": score_weights(data.y, self.bins, self.smoothing, self.temperature)}
        inverse = Inversion(self)
        forward = Gaussian(self.forward_lr, 1, self.forward_hidden, outputs=2, activation="relu", batch_size=self.batch_size)
        pairs = setting.train(inverse, self.steps, "mins", weight)
        models = setting.train(forward, self.forward_steps, "forward")
        best = float((data.y.max() - view.y_mean) / view.y_std)
        found = []
        for seed, pair, (nets, _) in zip(setting.seeds, pairs, models):
            z = jax.random.normal(key_for(jax.random.key(seed), "designs"), (setting.n, self.latent_size))
            x = _ascend(pair.generator, nets, z, best, self.agreement, self.ascent_lr, *setting.bounds, steps=self.ascent_steps)
            found.append(self.decoded(setting, seed, x, lambda x, nets=nets: (mean_of(nets, x), None)))
        return found


@partial(jax.jit, static_argnames="steps")
def _ascend(
    generator: MLP, nets: MLP, z: Array, best: Array, agreement: Array, lr: Array, low: Array, high: Array, *, steps: int
) -> Float[Array, "n z"]:
    """Coordinates of the designs after `steps` of gradient ascent on noise and requested score."""

    def loss(point: tuple[Array, Array]) -> Array:
        z, y = point
        x = jnp.clip(made(generator, z, y), low, high)
        gap = jnp.square(mean_of(nets, x) - y)
        return -(y - agreement * gap - 0.5 * jnp.square(z).mean(-1)).sum()

    def step(_: Any, carry: Any) -> Any:
        point, opt = carry
        return apply_gradients(point, jax.grad(loss)(point), opt, lr)

    first = z, jnp.full(len(z), best)
    (z, y), _ = jax.lax.fori_loop(0, steps, step, (first, init_opt(first)))
    return jnp.clip(made(generator, z, y), low, high)
