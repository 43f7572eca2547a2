"""DDOM: denoising diffusion for offline optimisation (Krishnamoorthy, Mashkaria and Grover 2023).

A diffusion model of designs given their score is trained on the data, with larger weights for high scores. Designs are sampled
for the highest score of the data, with classifier-free guidance:

    x_t = sqrt(a_t) x + sqrt(1 - a_t) e,   e_hat = (1 + g) e(x_t, t, y) - g e(x_t, t)
"""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.surrogate import Surrogate, score_weights
from deadreckon.nets.mlp import MLP, ensemble
from deadreckon.nets.optim import init_opt
from deadreckon.randomness import key_for, keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, TwoOrMore, UnitInterval, static

WAVES = 8  # pairs of a sine and a cosine that encode the time
BETA = 0.1, 20.0  # first and last noise rate of the variance-preserving diffusion (Song et al. 2021)


def variance_left(t: Array) -> Array:
    """a_t, the share of a design's variance that is left at time t in [0, 1]."""
    return jnp.exp(-t * BETA[0] - 0.5 * jnp.square(t) * (BETA[1] - BETA[0]))


def inputs(x: Float[Array, "b z"], t: Float[Array, "b"], y: Float[Array, "b"], told: Float[Array, "b"]) -> Float[Array, "b i"]:
    """The network's inputs: the noisy design, sines and cosines of the time, the score (0 where `told` is 0), and `told`."""
    angle = t[:, None] * 2.0 ** jnp.arange(WAVES) * jnp.pi / 2
    return jnp.concatenate([x, jnp.sin(angle), jnp.cos(angle), (told * y)[:, None], told[:, None]], -1)


class Denoiser(Surrogate):
    """The learner: a network that predicts the noise in a noisy design."""

    dropped: float = eqx.field(static=True, default=0.15)  # share of designs whose score is hidden from the network

    def init(self, spec, key):
        """An initial network and its optimiser state."""
        size = spec.size + 2 * WAVES + 2
        make = lambda k: MLP.create(size, self.hidden, spec.size, k, activation=self.activation)  # noqa: E731
        nets = ensemble(make, 1, key)
        return nets, init_opt(nets)

    def loss(self, net: MLP, x, y, weight, key):
        """Weighted squared error of the predicted noise, at uniformly drawn times."""
        kt, ke, kd = keys(key, "time", "noise", "dropped")
        t, noise = jax.random.uniform(kt, (len(x),), minval=1e-3), jax.random.normal(ke, x.shape)
        told = (jax.random.uniform(kd, (len(x),)) >= self.dropped).astype(x.dtype)
        left = variance_left(t)[:, None]
        noisy = jnp.sqrt(left) * x + jnp.sqrt(1 - left) * noise
        error = jnp.square(net(inputs(noisy, t, y, told)) - noise).mean(-1)
        return (weight * error).mean(), {"error": error.mean()}


@partial(jax.jit, static_argnames=("count", "steps"))
def sample(
    nets: MLP, y: Array, guidance: Array, low: Array, high: Array, key: Array, *, count: int, steps: int
) -> Float[Array, "n z"]:
    """Coordinates of `count` designs for the standardised score `y`, from noise in `steps` steps of the deterministic sampler
    (Song, Meng and Ermon 2021), clipped to `low` and `high` in every step."""
    net = jax.tree.map(lambda leaf: leaf[0], nets)
    scores, one = jnp.full((count,), y), jnp.ones(count)

    def step(i, x):
        t, after = 1.0 - i / steps, 1.0 - (i + 1) / steps
        t, after = jnp.maximum(t, 1e-3), jnp.maximum(after, 0.0)
        given, free = (net(inputs(x, t * one, scores, told)) for told in (one, 0 * one))
        noise = (1 + guidance) * given - guidance * free
        left, then = variance_left(t), variance_left(after)
        clean = jnp.clip((x - jnp.sqrt(1 - left) * noise) / jnp.sqrt(left), low, high)
        noise = (x - jnp.sqrt(left) * clean) / jnp.sqrt(1 - left)  # the noise that leads to the clipped design
        return jnp.sqrt(then) * clean + jnp.sqrt(1 - then) * noise

    return jax.lax.fori_loop(0, steps, step, jax.random.normal(key, (count, len(low))))


class DDOM(Designer):
    """A guided diffusion model of designs given their score."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"sampling": "sampling_steps"}

    hidden: Sizes = static((1024, 1024))  # width of each hidden layer
    steps: Count = static(10_000)  # updates of the model
    batch_size: Count = static(128)  # batch size (designs per update)
    lr: NonNegative = 1e-3  # learning rate of the model
    bins: TwoOrMore = static(64)  # number of bins of the scores in which weights are computed
    smoothing: UnitInterval = 0.01  # smoothing of the bins' counts, as a share of the designs (K)
    temperature: Positive = 0.1  # temperature of the bins' weights, in ranges of the scores (T)
    guidance: NonNegative = 2.0  # weight of classifier-free guidance
    sampling_steps: Count = static(200)  # diffusion steps from noise to a design

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Designs sampled for the highest score of the data, which is the method's prediction for them."""
        data, view = setting.data, setting.data.coordinates
        learner = Denoiser(self.lr, 1, self.hidden, outputs=1, activation="swish", batch_size=self.batch_size)
        weight = score_weights(data.y, self.bins, self.smoothing, self.temperature)[:, None]
        best = (data.y.max() - view.y_mean) / view.y_std
        # Noise is unbounded, but designs are clipped: to the range of the data if the variables have no bounds.
        seen = view.encode(data.x)
        low, high = (np.where(np.isfinite(b), b, e) for b, e in zip(view.bounds, (seen.min(0), seen.max(0))))
        found = []
        for seed, (nets, _) in zip(setting.seeds, setting.train(learner, self.steps, "ddom", {"weight": weight})):
            key = key_for(jax.random.key(seed), "designs")
            x = sample(nets, best, self.guidance, low, high, key, count=setting.n, steps=self.sampling_steps)
            made = self.decoded(setting, seed, x, lambda x: (np.full(len(x), best), None))
            found.append(replace(made, fitted=None, requested=True))
        return found
