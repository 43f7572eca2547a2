"""NEMO: normalised maximum likelihood for offline model-based optimisation (thesis chapter 6, Algorithms 4 and 6).

There are K models, one for each bin of the score. Model k is fitted to the data and to hypothetical labels: that each of the M
designs of the search falls into bin k. Each of these should have the weight of one of the N rows, so one of the M is drawn per
update, with weight w = M / N relative to the mean over the data. (w = 1, far larger, is an adversarial regulariser, not NML.)
Where the data carries little information, every model fits its hypothetical labels, and

    p_NML(k | x) = p(k | x, theta_k) / sum_j p(j | x, theta_j)                                              (6.2)

is diffuse. Bins are counted from 0, scores are scaled such that those of the data range from 0 to 1, and with a logistic
distribution of mean mu(x) and scale s

    o_k(x) = P(bin >= k) = sigmoid((mu(x) - k / K) / s),  k = 1 .. K - 1,  o_0 = 1, o_K = 0,
    p(k | x) = o_k - o_{k+1},   E[g] = g_0 + sum_k (g_k - g_{k-1}) o_k.

The printed sigmoid(mu + k/K) would increase with k, although P(bin >= k) decreases, and it has no scale, which limits the
probability of an inner bin to 1/(4K): see the deviations on the method's page.
"""

import hashlib
import warnings
from collections.abc import Callable
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.mbo.coordinates import Coordinates
from deadreckon.mbo.designer import Designer, DesignInput, Proposals, starts
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nml import Net, cross_entropy, middles, nll, p_nml, quantise, reached
from deadreckon.nets.mlp import ensemble, joined, split
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.training.hyperparameters import (
    Count,
    CountOrZero,
    NonNegative,
    Positive,
    Sizes,
    TwoOrMore,
    UnitInterval,
    host,
    static,
)

STACKS = 4  # number of stacks of models; see `split`
SAMPLE = 1000  # rows of the data on which it is checked that the models predict different scores for different designs


class Search(NamedTuple):
    """State of the gradient ascent: coordinates of the designs, and the optimiser state."""

    x: Float[Array, "m z"]
    opt: optax.OptState

    def ascend(self, value: Callable[[Array], Array], lr: Any, low: Array, high: Array) -> "Search":
        """One step of gradient ascent (Adam) on `value` ((m, size) -> (m,)) for each design, clipped to bounds."""
        grads = jax.grad(lambda x: -value(x).sum())(self.x)
        x, opt = apply_gradients(self.x, grads, self.opt, lr)
        return Search(jnp.clip(x, low, high), opt)


class State(NamedTuple):
    """K models in `STACKS` stacks, their target networks, the optimiser state, and the search."""

    nets: tuple[Net, ...]
    targets: tuple[Net, ...]
    opt: optax.OptState
    search: Search
    origin: Float[Array, "m z"]  # initial coordinates of the designs


class Fixed:
    """A constant array of a compiled program, hashed by its bytes."""

    def __init__(self, value: np.ndarray):
        self.value = np.asarray(value, np.float32)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fixed) and np.array_equal(self.value, other.value)

    def __hash__(self) -> int:
        return hash(self.value.tobytes())

    def __repr__(self) -> str:  # part of a checkpoint folder's name, and Python's own hash differs between processes
        return f"Fixed({hashlib.blake2b(self.value.tobytes(), digest_size=8).hexdigest()})"


class Training(eqx.Module):
    """The learner: the models alone at first, then models and designs in alternation (Algorithm 6)."""

    settings: "NEMO"  # resolved: its learning rates and label weight are not None
    designs: int = eqx.field(static=True)  # number of designs in the search
    scale: tuple[float, float] = eqx.field(static=True)  # least and greatest standardised score
    low: Fixed = eqx.field(static=True)  # bounds of the coordinates
    high: Fixed = eqx.field(static=True)
    reach: Fixed = eqx.field(static=True)  # (size,) largest distance of each coordinate from its start
    worths: Fixed | None = eqx.field(static=True)  # g at the middle of each bin

    def needs(self, spec):
        """Batches of designs and scores."""
        return BatchSpec(columns=(), batch_size=self.settings.batch_size)

    def init(self, spec, key):
        """Initial models; the target networks are copies."""
        settings, logistic = self.settings, self.settings.architecture == "logistic"
        make = lambda k: Net.create(spec.size, settings.hidden, settings.bins, logistic, k)  # noqa: E731
        nets = split(ensemble(make, settings.bins, key), STACKS)
        x = starts(spec.designs, self.designs, settings.start == "worst")
        return State(nets, copy(nets), init_opt(nets), Search(x, init_opt(x)), jnp.array(x))

    def update(self, state: State, batch: Batch, *, step, key):
        """One update of all models; after pretraining, every `model_updates` of them are followed by a step of all designs."""
        assert batch.extra is not None
        settings, x, y = self.settings, batch.extra["x"], batch.extra["y"]
        assert settings.search_lr is not None  # both are resolved
        assert settings.label_weight is not None
        low, high = self.scale
        label = quantise((y - low) / (high - low), settings.bins)
        # One design, the same for all models; its hypothetical label is each model's own bin.
        which = jax.random.randint(key, (), 0, len(state.search.x))
        weight = jnp.where(step < settings.pretrain, 0.0, settings.label_weight)
        grads, metrics = jax.grad(self.loss, has_aux=True)(state.nets, x, label, state.search.x[which][None], weight)
        lr = jnp.where(step < settings.pretrain, settings.lr, settings.search_lr)
        nets, opt = apply_gradients(state.nets, grads, state.opt, lr)
        # Target networks are copies during pretraining, so that they do not lag behind when it ends.
        rate = jnp.where(step < settings.pretrain, 1.0, settings.tau)
        targets = polyak_update(state.targets, nets, rate)
        turn = (step >= settings.pretrain) & ((step - settings.pretrain) % settings.model_updates == settings.model_updates - 1)
        within = self.within(state.origin)
        rise = lambda search: search.ascend(lambda z: self.worth(targets, z), settings.design_lr, *within)  # noqa: E731
        search = jax.lax.cond(turn, rise, lambda search: search, state.search)
        return State(nets, targets, opt, search, state.origin), metrics

    def within(self, origin: Float[Array, "m z"]) -> tuple[Array, Array]:
        """(m, size) least and greatest coordinates of designs that started at `origin`, by the bounds and by `reach`."""
        low, high = self.bounds
        reach = self.reach.value
        return jnp.maximum(low, origin - reach), jnp.minimum(high, origin + reach)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the coordinates."""
        return jnp.asarray(self.low.value), jnp.asarray(self.high.value)

    def loss(self, stacks: tuple[Net, ...], x: Array, label: Array, design: Array, weight: Array):
        """Sum of the losses of all models: each on the batch, plus w times that on the design with the model's bin as label."""
        settings = self.settings
        of = cross_entropy if settings.loss == "bce" and settings.architecture == "logistic" else nll

        def one(net: Net, claim: Array) -> tuple[Array, Array]:
            each = of(net, jnp.concatenate([x, design]), jnp.append(label, claim))
            return each[:-1].mean(), each[-1]

        found = [jax.vmap(one)(*part) for part in zip(stacks, split(jnp.arange(settings.bins), len(stacks)))]
        data, claims = joined(found)
        return (data + weight * claims).sum(), {"loss": data.mean(), "claim": claims.mean()}

    def worth(self, stacks: tuple[Net, ...], z: Float[Array, "m z"]) -> Float[Array, "m"]:
        """The objective that the designs maximise."""
        if self.settings.objective == "internal":
            return jnp.concatenate([jax.vmap(lambda net: net.internal(z))(nets) for nets in stacks]).mean(0)
        probs = jnp.exp(p_nml(joined(stacks), z))
        if self.settings.objective == "confidence":
            return reached(probs, self.settings.confidence)
        return probs @ (middles(self.settings.bins) if self.worths is None else jnp.asarray(self.worths.value))


class NEMO(Designer):
    """Normalised maximum likelihood for offline model-based optimisation."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"weight": "label_weight", "ratio": "model_updates"}

    bins: TwoOrMore = static(40)  # bins of the score, and models (K)
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    architecture: Literal["logistic", "categorical"] = static("logistic")
    """output of a model: discretised logistic (6.3), or K logits"""
    loss: Literal["bce", "likelihood"] = static("bce")
    """loss of the logistic: binary cross-entropy as printed, or the likelihood of the bins"""
    objective: Literal["internal", "mean", "confidence"] = static("internal")
    """ascended quantity: mu (Alg. 6), E[g] under p_NML (Alg. 4), or a quantile"""
    g: Callable[[np.ndarray], np.ndarray] | None = static(None)
    """value of a score for objective="mean", of the table's scores; None: the score itself"""
    confidence: UnitInterval = 0.9  # probability of exceeding the score that objective="confidence" raises
    steps: Count = host(100)
    """updates of the models after pretraining; the designs move by about design_lr after every model_updates of them"""
    pretrain: CountOrZero = static(2000)  # updates of the models before the designs move
    model_updates: Count = static(1)  # model updates per design update
    batch_size: Count = static(128)  # batch size (designs of the data per update; missing in Algorithm 6)
    lr: NonNegative = 0.005  # learning rate of the models (alpha_theta); 0.05 of some presets is too large for wide networks
    search_lr: NonNegative | None = None  # learning rate of the models while designs move; None: lr; 0: the models stay fixed
    design_lr: NonNegative | None = None
    """step size of the standardised designs (alpha_x); None: 0.01, or 0.1 for discrete designs"""
    tau: UnitInterval = 0.05  # Polyak rate of the target models, per update
    label_weight: NonNegative | None = None
    """weight of a hypothetical label relative to the mean over the data; None: proposals / rows, one row's weight each (NML)"""
    max_travel: Positive | None = host(1.0)
    """largest distance of a numeric variable from where its design began, in standard deviations of the data; None: no limit"""
    start: Literal["best", "worst"] = static("best")  # designs of the data to start from

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "NEMO"

    def training(self, setting: DesignInput) -> Training:
        """The learner for some data."""
        data, view = setting.data, setting.data.coordinates
        y = (data.y - view.y_mean) / view.y_std
        worths = None if self.g is None else Fixed(self._worths(data))
        resolved = self.replace(
            search_lr=self.lr if self.search_lr is None else self.search_lr,
            design_lr=self.design_lr if self.design_lr is not None else 0.1 if view.discrete else 0.01,
            # One of n hypothetical labels is drawn per update, each of which should have the weight of one row of the data.
            label_weight=setting.n / len(data) if self.label_weight is None else self.label_weight,
            g=None,  # a function has no lasting name; `worths` holds its values at the bins
        )
        scale = float(y.min()), float(y.max())
        low, high = view.bounds
        return Training(resolved, setting.n, scale, Fixed(low), Fixed(high), Fixed(self._reach(view)), worths)

    def _reach(self, view: Coordinates) -> np.ndarray:
        """(size,) largest distance of each coordinate from its start; unlimited for those of categories."""
        reach = np.full(view.size, np.inf)
        if self.max_travel is not None:
            reach[: len(view.numeric)] = self.max_travel
        return reach

    def _worths(self, data: Designs) -> np.ndarray:
        """(bins,) values of g at the middle of each bin."""
        assert self.g is not None
        return np.asarray(self.g(data.shown(data.y.min() + np.ptp(data.y) * np.asarray(middles(self.bins)))), np.float64)

    def settings_text(self, data: Designs) -> str:
        """See `Designer`; a function g is identified by its values at the bins."""
        if self.g is None:
            return super().settings_text(data)
        return f"{self.replace(g=None).settings_text(data)}, g {self._worths(data).tolist()}"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """The designs at the end of the search, with mean and standard deviation under p_NML of the target networks."""
        learner = self.training(setting)
        states = setting.train(learner, self.pretrain + self.steps, "nemo")
        low, high = learner.scale
        self._warn_if_constant(learner, states, setting)
        found = []
        for seed, state in zip(setting.seeds, states):
            middle = low + (high - low) * (np.arange(self.bins) + 0.5) / self.bins

            nets = joined(state.targets)

            def predicted(x: Array, nets: Net = nets, middle: np.ndarray = middle) -> tuple[np.ndarray, np.ndarray]:
                probs = np.exp(np.asarray(jax.jit(p_nml)(nets, x), np.float64))
                mean = probs @ middle
                return mean, np.sqrt(np.maximum(probs @ np.square(middle) - np.square(mean), 0.0))

            found.append(self.decoded(setting, seed, state.search.x, predicted))
        return found

    def _warn_if_constant(self, learner: Training, states: list[State], setting: DesignInput) -> None:
        """Warns if the models predict the same for all data: a large learning rate can leave them without active units."""
        data = setting.data
        some = np.linspace(0, len(data) - 1, min(len(data), SAMPLE)).astype(int)
        z = jnp.asarray(data.coordinates.encode(data.x[some]))
        worths = [np.asarray(learner.worth(state.targets, z), np.float64) for state in states]
        constant = [seed for seed, worth in zip(setting.seeds, worths) if np.ptp(worth) <= 1e-6 * np.abs(worth).max()]
        if constant:
            text = f"NEMO: its models predict the same for every design (seeds {constant}), so the search is void; lower lr"
            warnings.warn(f"{text} (now {self.lr:g})", stacklevel=4)
