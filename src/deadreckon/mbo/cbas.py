"""CbAS: conditioning by adaptive sampling (Brookes, Park and Listgarten 2019), and autofocused oracles (Fannjiang and
Listgarten 2020).

A generative model p_0 of the data's designs is adapted towards high scores. In each round designs are sampled from the current
model q and weighted by

    w = p_0(x | z) / q(x | z) P(y >= c | x)

and q is fitted to them. The threshold c is a percentile of the predicted scores of the sampled designs and never decreases. P
comes from an ensemble fitted to the data. Autofocusing refits the ensemble in every round, with the weights (q(x | z) /
p_0(x | z))^a of the data's designs, so that it becomes more accurate where q samples.
"""

from typing import Annotated, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec, redrawn
from deadreckon.mbo.coordinates import Coordinates
from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.forward import Gaussian, mixture
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Range, Sizes, host, static

LOG_RATIO = 10.0  # limit at which log-ratios of densities are clipped, so that no single design dominates
STD = 0.1  # least standard deviation of a decoded coordinate


class Layout(NamedTuple):
    """Order of the coordinates: numbers first, then groups of categorical variables with equally many levels."""

    numbers: int
    groups: tuple[tuple[int, int], ...]  # number of variables, and of the levels of each

    @classmethod
    def of(cls, view: Coordinates) -> "Layout":
        """The layout of some coordinates."""
        return cls(len(view.numeric), tuple((len(columns), levels) for columns, levels in view.groups))

    @property
    def outputs(self) -> int:
        """Size of a decoder's output: a mean and a log standard deviation per number, a logit per level."""
        return 2 * self.numbers + sum(count * levels for count, levels in self.groups)

    def parts(self, out: Float[Array, "b o"]) -> tuple[Array, Array, list[Array]]:
        """Means and log standard deviations of numbers, and (b, variables, levels) log-probabilities of each group."""
        mean, log_std, at = out[:, : self.numbers], out[:, self.numbers : 2 * self.numbers], 2 * self.numbers
        groups = []
        for count, levels in self.groups:
            logits = out[:, at : at + count * levels].reshape(-1, count, levels)
            groups.append(jax.nn.log_softmax(logits))
            at += count * levels
        return mean, jnp.clip(log_std, jnp.log(STD), 1.0), groups

    def log_prob(self, out: Float[Array, "b o"], x: Float[Array, "b z"]) -> Float[Array, "b"]:
        """Log-likelihood of coordinates under a decoder's output."""
        mean, log_std, groups = self.parts(out)
        total = jax.scipy.stats.norm.logpdf(x[:, : self.numbers], mean, jnp.exp(log_std)).sum(-1)
        at = self.numbers
        for (count, levels), probs in zip(self.groups, groups):
            level = with_first(x[:, at : at + count * (levels - 1)].reshape(-1, count, levels - 1)).argmax(-1)
            total += jnp.take_along_axis(probs, level[..., None], -1)[..., 0].sum(-1)
            at += count * (levels - 1)
        return total

    def draw(self, out: Float[Array, "b o"], key: Array) -> Float[Array, "b z"]:
        """Samples coordinates from a decoder's output."""
        mean, log_std, groups = self.parts(out)
        k_numbers, k_groups = keys(key, "numbers", "groups")
        drawn = [mean + jnp.exp(log_std) * jax.random.normal(k_numbers, mean.shape)]
        for i, ((count, levels), probs) in enumerate(zip(self.groups, groups)):
            one = jax.nn.one_hot(jax.random.categorical(jax.random.fold_in(k_groups, i), probs), levels)
            drawn.append((one[..., 1:] - one[..., :1]).reshape(-1, count * (levels - 1)))
        return jnp.concatenate(drawn, -1)


def with_first(logits: Float[Array, "b v l1"]) -> Float[Array, "b v l"]:
    """The logits of all levels: that of the first is zero and is not among the coordinates."""
    return jnp.concatenate([jnp.zeros_like(logits[..., :1]), logits], -1)


class Generator(NamedTuple):
    """A variational autoencoder of designs."""

    encoder: MLP
    decoder: MLP

    def elbo(self, layout: Layout, x: Float[Array, "b z"], key: Array) -> Float[Array, "b"]:
        """Evidence lower bound of each design."""
        mean, log_std = self.encode(x)
        latent = mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)
        divergence = -0.5 * (1 + 2 * log_std - jnp.square(mean) - jnp.exp(2 * log_std)).sum(-1)
        return layout.log_prob(self.decoder(latent), x) - divergence

    def encode(self, x: Float[Array, "b z"]) -> tuple[Array, Array]:
        """Mean and log standard deviation of the latent variables of designs."""
        mean, log_std = jnp.split(self.encoder(x), 2, -1)
        return mean, jnp.clip(log_std, -6.0, 2.0)


class Autoencoding(eqx.Module):
    """The learner: the generator of the data's designs."""

    settings: "CbAS"
    layout: Layout = eqx.field(static=True)

    def needs(self, spec):
        """Batches of designs."""
        return BatchSpec(columns=(), batch_size=self.settings.batch_size)

    def init(self, spec, key):
        """An initial generator and its optimiser state."""
        ke, kd = keys(key, "encoder", "decoder")
        latent, hidden = self.settings.latent_size, self.settings.hidden
        encoder = MLP.create(spec.size, hidden, 2 * latent, ke)
        made = Generator(encoder, MLP.create(latent, hidden, self.layout.outputs, kd))
        return made, init_opt(made)

    def update(self, state, batch: Batch, *, step, key):
        """One update of the generator."""
        assert batch.extra is not None
        generator, opt = state
        even = jnp.ones(self.settings.batch_size)
        generator, opt, bound = learn(generator, opt, self.layout, batch.extra["x"], even, self.settings.lr, key)
        return (generator, opt), {"elbo": bound}


def learn(generator: Generator, opt: Any, layout: Layout, x: Array, weight: Array, lr: Any, key: Array):
    """One update of a generator on weighted designs: the new one, its optimiser state, and the mean evidence lower bound."""

    def loss(generator: Generator) -> tuple[Array, Array]:
        bound = generator.elbo(layout, x, key)
        return -(weight * bound).mean(), bound.mean()

    grads, bound = jax.grad(loss, has_aux=True)(generator)
    return *apply_gradients(generator, grads, opt, lr), bound


class Rounds(NamedTuple):
    """State between rounds: q and its optimiser state, the ensemble and its optimiser state, and the threshold c."""

    q: Generator
    opt: Any
    nets: MLP
    nets_opt: Any
    threshold: Array


class CbAS(Designer):
    """Conditioning by adaptive sampling; with `refit` above 0 autofocused."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"latent": "latent_size", "draws": "samples"}

    refit: NonNegative = 0.0  # exponent of the importance weights that the ensemble is refitted with; 0: never refitted
    hidden: Sizes = static((256, 256))  # width of each hidden layer of generator and ensemble
    latent_size: Count = static(32)  # dimension of the latent variables
    members: Count = static(5)  # number of networks, each fitted on a bootstrap resample of the designs
    steps: Count = host(5000)  # updates of the ensemble, and of the generator, before the first round
    rounds: Count = host(20)  # rounds of sampling, weighting and fitting
    updates: Count = static(100)  # updates per round of the generator, and of the ensemble where it is refitted
    samples: Count = static(1000)  # designs sampled per round
    percentile: Annotated[float, Range(ge=0, lt=100)] = 80.0  # percentile of the predicted scores that designs have to exceed
    batch_size: Count = static(128)  # batch size (designs per update)
    lr: NonNegative = 3e-4  # learning rate of all networks

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "Autofocus" if self.refit > 0 else "CbAS"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Designs sampled from the last q."""
        view = setting.data.coordinates
        layout = Layout.of(view)
        ensemble = _ensemble(self)
        weight = redrawn(len(setting.data), self.members, 0)
        proxies = setting.train(ensemble, self.steps, "forward", {"weight": weight})
        priors = setting.train(Autoencoding(self, layout), self.steps, "generator")
        x = jnp.asarray(view.encode(setting.data.x))
        y = jnp.asarray((setting.data.y - view.y_mean) / view.y_std, jnp.float32)
        fixed = x, y, jnp.asarray(weight)
        found = []
        for seed, (nets, nets_opt), (prior, _) in zip(setting.seeds, proxies, priors):
            k_rounds, k_designs = keys(jax.random.key(seed), "rounds", "designs")
            state = Rounds(prior, init_opt(prior), nets, nets_opt, jnp.float32(-jnp.inf))
            for i in range(self.rounds):
                state = _round(self, layout, prior, state, *fixed, jax.random.fold_in(k_rounds, i), *setting.bounds)
                setting.watch(f"{self.label.lower()} seed {seed}", i + 1, self.rounds)
            drawn = _draw(layout, state.q, k_designs, setting.n)[0]
            found.append(self.decoded(setting, seed, drawn, lambda x, nets=state.nets: mixture(nets, x)))
        return found


def _ensemble(of: CbAS) -> Gaussian:
    return Gaussian(of.lr, of.members, of.hidden, outputs=2, activation="relu", batch_size=of.batch_size)


def _draw(layout: Layout, q: Generator, key: Array, count: int) -> tuple[Array, Array]:
    """Samples designs, some of them out of bounds; returns their coordinates and latent variables."""
    kz, kx = keys(key, "latent", "design")
    latent = jax.random.normal(kz, (count, q.decoder.weights[0].shape[0]))
    return layout.draw(q.decoder(latent), kx), latent


@eqx.filter_jit
def _round(of: CbAS, layout: Layout, prior: Generator, state: Rounds, x, y, weight, key, low, high) -> Rounds:
    """One round: sample and weight designs, fit q, and with autofocusing refit the ensemble."""
    k_draw, k_generator, k_ensemble = keys(key, "draw", "generator", "ensemble")
    drawn, latent = _draw(layout, state.q, k_draw, of.samples)
    mean, std = mixture(state.nets, jnp.clip(drawn, low, high))  # as they would be proposed; densities are of the samples
    threshold = jnp.maximum(state.threshold, jnp.percentile(mean, of.percentile))
    ratio = layout.log_prob(prior.decoder(latent), drawn) - layout.log_prob(state.q.decoder(latent), drawn)
    log_importance = jnp.clip(ratio, -LOG_RATIO, LOG_RATIO) + jax.scipy.stats.norm.logsf((threshold - mean) / std)
    importance = jnp.exp(log_importance - log_importance.max())
    importance = importance / importance.mean()

    def fit(i, carry):
        q, opt = carry
        k_rows, k_loss = keys(jax.random.fold_in(k_generator, i), "rows", "loss")
        rows = jax.random.randint(k_rows, (of.batch_size,), 0, of.samples)
        return learn(q, opt, layout, drawn[rows], importance[rows], of.lr, k_loss)[:2]

    q, opt = jax.lax.fori_loop(0, of.updates, fit, (state.q, state.opt))
    nets, nets_opt = state.nets, state.nets_opt
    if of.refit > 0:
        code = prior.encode(x)[0]
        far = layout.log_prob(q.decoder(code), x) - layout.log_prob(prior.decoder(code), x)
        focus = jnp.exp(of.refit * jnp.clip(far, -LOG_RATIO, LOG_RATIO))
        focus = focus / focus.mean()
        loss = _ensemble(of).loss

        def refocus(i, carry):
            nets, opt = carry
            k_rows, k_loss = keys(jax.random.fold_in(k_ensemble, i), "rows", "loss")
            rows = jax.random.randint(k_rows, (of.batch_size,), 0, len(x))
            each = lambda net, w: loss(net, x[rows], y[rows], w * focus[rows], k_loss)[0]  # noqa: E731
            grads = jax.grad(lambda nets: jax.vmap(each)(nets, weight[rows].T).sum())(nets)
            return apply_gradients(nets, grads, opt, of.lr)

        nets, nets_opt = jax.lax.fori_loop(0, of.updates, refocus, (nets, nets_opt))
    return Rounds(q, opt, nets, nets_opt, threshold)
