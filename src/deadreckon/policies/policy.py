"""What acts: the protocol, the kinds of policy that agents produce, and any Python function as a policy."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, Self, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from deadreckon.data.spec import Spec
from deadreckon.data.step import Step
from deadreckon.data.view import EDGE, View
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.nets.vae import VAE

KINDS: dict[str, type[eqx.Module]] = {}  # of policies that a file can hold, by name; each registers itself


@runtime_checkable
class Policy(Protocol):
    """Acts in `n` environments at once. Memoryless policies carry ()."""

    has_log_prob: bool

    def start(self, n: int) -> Any:
        """The carry before the first step."""
        ...

    def act(self, step: Step, carry: Any, key: Any, *, greedy: bool) -> tuple[Any, Any]:
        """Actions (n, size) and the next carry. `greedy` asks for the policy's best guess instead of a draw."""
        ...


class Inner(eqx.Module):
    """A policy in a method's coordinates: observations as trained on, actions in [-1, 1] or indices.

    Memoryless continuous ones implement `pre_actions` alone; those that remember, or choose among discrete actions,
    override `start` and `act`.
    """

    has_log_prob = False

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        KINDS[cls.__name__] = cls

    def start(self, n: int) -> Any:
        """The carry before the first step of `n` environments."""
        return ()

    def act(self, step: Step, carry: Any, key: PRNGKeyArray, *, greedy: bool) -> tuple[Array, Any]:
        """Actions in [-1, 1] (or indices) and the next carry."""
        return jnp.tanh(self.pre_actions(step.observation, key, greedy=greedy)), carry

    def pre_actions(
        self, observation: Float[Array, "n o"], key: PRNGKeyArray, *, greedy: bool, count: tuple[int, ...] = ()
    ) -> Float[Array, "*c n a"]:
        """Draws before the tanh; `count` of them along new leading axes."""
        raise NotImplementedError


class Deterministic(Inner):
    """a = tanh(net(s))."""

    net: MLP

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`; every draw is the same."""
        out = self.net(observation)
        return jnp.broadcast_to(out, (*count, *out.shape))


class TanhGaussian(Inner):
    """a = tanh(mean + std * noise); greedy is tanh(mean).

    Attributes:
        net: to mean and log-deviation.
        log_std: the range that log-deviations are clipped to.
    """

    net: MLP
    log_std: tuple[float, float] = eqx.field(static=True, default=(dist.LOG_STD_MIN, dist.LOG_STD_MAX))
    has_log_prob = True

    def _head(self, observation: Float[Array, "n o"]) -> dist.Gaussian:
        return dist.gaussian_head(self.net(observation), *self.log_std)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`."""
        d = self._head(observation)
        if greedy:
            return jnp.broadcast_to(d.mean, (*count, *d.mean.shape))
        return dist.sample(d, key, count)

    def log_prob(self, observation: Float[Array, "n o"], action: Float[Array, "*c n a"]) -> Float[Array, "*c n"]:
        """Log-density over [-1, 1] of actions, clipped to the open interval."""
        return dist.log_prob(self._head(observation), jnp.arctanh(jnp.clip(action, -EDGE, EDGE)))


class Gaussian(Inner):
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
        """See `Inner`; the action is not squashed."""
        return self.pre_actions(step.observation, key, greedy=greedy), carry

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`."""
        mean, log_std = jnp.split(self.net(observation), 2, axis=-1)
        if greedy:
            return jnp.broadcast_to(mean, (*count, *mean.shape))
        return dist.sample(dist.Gaussian(mean, log_std), key, count)

    def log_prob(self, observation: Float[Array, "n o"], action: Float[Array, "*c n a"]) -> Float[Array, "*c n"]:
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
        """See `Inner`."""
        return jnp.clip(self.pre_actions(step.observation, key, greedy=greedy), -1.0, 1.0), carry

    def log_prob(self, observation: Float[Array, "n o"], action: Float[Array, "*c n a"]) -> Float[Array, "*c n"]:
        """Sum of log-densities of actions between the bounds, and log-probabilities of those at them."""
        mean, log_std = jnp.split(self.net(observation), 2, axis=-1)
        beyond = jax.scipy.stats.norm.logcdf((jnp.sign(action) * mean - 1.0) * jnp.exp(-log_std))
        return jnp.where(jnp.abs(action) >= EDGE, beyond, _log_densities(mean, log_std, action)).sum(-1)


class VAEDecoder(Inner):
    """a = tanh(decode(s, z)) with z a clamped standard normal; greedy decodes z = 0."""

    vae: VAE

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`."""
        if greedy:
            size = self.vae.decoder.weights[0].shape[0] - observation.shape[-1]
            return self.vae.decode(observation, jnp.zeros((*count, *observation.shape[:-1], size)))
        return self.vae.sample(observation, key, count)


def moved(mover: MLP, reach: Any, observation: Float[Array, "n o"], action: Float[Array, "*c n a"]) -> Float[Array, "*c n a"]:
    """Actions in [-1, 1], each moved by `reach` tanh(mover(s, a)) and kept within."""
    return jnp.clip(action + reach * jnp.tanh(mover.beside(observation, action)), -1.0, 1.0)


class Moved(Inner):
    """Actions of a VAE, each moved a little by a network (BCQ's).

    Attributes:
        vae: makes actions.
        mover: of observation and action, to which way an action goes.
        reach: how far at most.
    """

    vae: VAE
    mover: MLP
    reach: Array

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`."""
        pre = VAEDecoder(self.vae).pre_actions(observation, key, greedy=greedy, count=count)
        return jnp.arctanh(jnp.clip(moved(self.mover, self.reach, observation, jnp.tanh(pre)), -EDGE, EDGE))


class OneStep(Inner):
    """a = net(s, z), cut to [-1, 1], with z standard normal (FQL's). It draws also when `greedy`: no z is the best."""

    net: MLP

    def drawn(self, observation: Float[Array, "n o"], key: PRNGKeyArray, count: tuple[int, ...] = ()) -> Float[Array, "*c n a"]:
        """Actions in [-1, 1]."""
        z = jax.random.normal(key, (*count, *observation.shape[:-1], self.net.biases[-1].shape[-1]))
        seen = jnp.broadcast_to(observation, (*z.shape[:-1], observation.shape[-1]))
        return jnp.clip(self.net(jnp.concatenate([seen, z], -1)), -1.0, 1.0)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`."""
        return jnp.arctanh(jnp.clip(self.drawn(observation, key, count), -EDGE, EDGE))


class Categorical(Inner):
    """A choice among discrete actions by a network's logits; greedy is the likeliest."""

    net: MLP
    has_log_prob = True

    @classmethod
    def create(cls, spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> "Categorical":
        """A fresh network."""
        return cls(MLP.create(spec.observation_size, hidden, spec.action_size, key))

    def chances(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action."""
        return jax.nn.softmax(self.net(observation))

    def log_chances(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """Its logarithm."""
        return jax.nn.log_softmax(self.net(observation))

    def log_prob(self, observation: Float[Array, "n o"], action: Int[Array, "n"]) -> Float[Array, "n"]:
        """Log-probability of one action each."""
        return jnp.take_along_axis(self.log_chances(observation), action[:, None], -1)[:, 0]

    def act(self, step, carry, key, *, greedy):
        """See `Inner`."""
        logits = self.net(step.observation)
        return (logits.argmax(-1) if greedy else jax.random.categorical(key, logits)).astype(jnp.int32), carry


def create_actor(spec: Spec, hidden: tuple[int, ...], key: PRNGKeyArray) -> MLP | Categorical:
    """A stochastic actor: a network to mean and log-deviation before the tanh, or the logits of discrete actions."""
    if spec.discrete:
        return Categorical.create(spec, hidden, key)
    return MLP.create(spec.observation_size, hidden, 2 * spec.action_size, key)


def stochastic(actor: MLP | Categorical) -> Inner:
    """What `create_actor` made as a policy; greedy is its mean, or its likeliest action."""
    return actor if isinstance(actor, Categorical) else TanhGaussian(actor)


class Supported(Inner):
    """Of the discrete actions that a model of the log finds likely enough, the best by a critic (discrete BCQ).

    Attributes:
        behavior: the model.
        critic: to a value an action.
        share: of the likeliest action's probability, which others need.
    """

    behavior: Categorical
    critic: MLP
    share: Array

    def act(self, step, carry, key, *, greedy):
        """See `Inner`; nothing is drawn."""
        values = jnp.where(supported(self.behavior, self.share, step.observation), self.critic(step.observation), -jnp.inf)
        return values.argmax(-1).astype(jnp.int32), carry

    def chances(self, observation: Float[Array, "n o"]) -> Float[Array, "n c"]:
        """The probability of every action: all of it on one."""
        step = Step(observation, None, None)
        chosen, _ = self.act(step, (), jax.random.key(0), greedy=True)
        return jax.nn.one_hot(chosen, self.critic.biases[-1].shape[-1])


def supported(behavior: Categorical, share: Any, observation: Float[Array, "n o"]) -> Bool[Array, "n c"]:
    """Which actions have at least this share of the likeliest one's probability."""
    log_chances = behavior.log_chances(observation)
    return log_chances >= log_chances.max(-1, keepdims=True) + jnp.log(share)


class GreedyQ(Inner):
    """The best of `samples` actions of `actor` by the first critic (thesis 4.3, test time; A.4)."""

    actor: Inner
    critic: MLP
    samples: int = eqx.field(static=True, default=10)

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `Inner`. The candidates are drawn also when `greedy`: choosing among them is what makes it so."""
        pre = self.actor.pre_actions(observation, key, greedy=False, count=(self.samples, *count))
        critics = jax.tree.map(lambda w: w[None], self.critic)
        q = q_values(critics, observation, jnp.tanh(pre))[0]
        best = jnp.argmax(q, 0)
        return jnp.take_along_axis(pre, best[None, ..., None], 0)[0]


class Deployed(eqx.Module):
    """An inner policy between raw observations and the environment's actions: what is saved, evaluated and shipped.

    Attributes:
        inner: in the method's coordinates.
        mean, std: of the observations, or None.
        low, high: (size,) bounds of the actions.
    """

    inner: Inner
    mean: Array | None
    std: Array | None
    low: Array | None
    high: Array | None

    @classmethod
    def of(cls, inner: Inner, view: View) -> "Deployed":
        """`inner` seen through `view`."""
        arrays = (None if v is None else jnp.asarray(v) for v in (view.mean, view.std, view.low, view.high))
        return cls(inner, *arrays)

    @property
    def view(self) -> View:
        """The change of coordinates."""
        return View(self.mean, self.std, self.low, self.high)  # pyright: ignore[reportArgumentType]

    @property
    def has_log_prob(self) -> bool:
        """Whether `log_prob` is defined."""
        return self.inner.has_log_prob

    def start(self, n: int) -> Any:
        """The inner policy's carry."""
        return self.inner.start(n)

    def act(self, step: Step, carry: Any, key: PRNGKeyArray, *, greedy: bool) -> tuple[Array, Any]:
        """Actions in the environment's bounds."""
        seen = step._replace(observation=self.view.observe(step.observation))
        action, carry = self.inner.act(seen, carry, key, greedy=greedy)
        return self.view.from_unit(action), carry

    def log_prob(self, observation: Any, action: Any) -> Array:
        """Log-density of environment actions (n, size) at raw observations (n, *shape); see also `ClippedGaussian`."""
        if not isinstance(self.inner, TanhGaussian | Gaussian | Categorical):
            raise UserError(f"a {type(self.inner).__name__} policy has no log-probabilities")
        view = self.view
        unit = view.to_unit(jnp.asarray(action))
        log_prob = self.inner.log_prob(view.observe(jnp.asarray(observation)), unit)
        if self.low is None or self.high is None:
            return log_prob
        # As `View.log_scale`, but also where the bounds are traced; what a bound has of a clipped Gaussian is no density.
        scale = jnp.log(0.5 * (self.high - self.low))
        dense = jnp.abs(unit) < EDGE if isinstance(self.inner, ClippedGaussian) else 1.0
        return log_prob - (dense * scale).sum(-1)

    @property
    def action_probs(self) -> Callable[[Any], np.ndarray] | None:
        """Of discrete actions, what gives the probabilities (n, actions) at raw observations; None for continuous ones.

        Those of a mixture are of an episode's first action; what it does later depends on which member was drawn.
        """
        if isinstance(self.inner, Mixture):
            found = [member.action_probs for member in self.inner.members]
            told = [tells for tells in found if tells is not None]
            if len(told) < len(found):
                return None
            return lambda observations: np.mean([tells(observations) for tells in told], 0)
        if not isinstance(self.inner, Categorical | Supported):
            return None
        return lambda observations: np.asarray(_chances(self, jnp.asarray(observations)))

    def __call__(self, observations: Any) -> np.ndarray:
        """Greedy first actions for one observation or a batch of them, as numpy; draws nothing that is not seeded."""
        x = np.asarray(observations, np.float32)
        single = x.ndim == 1
        actions = first_actions(self, jnp.asarray(x[None] if single else x), jax.random.key(0), True)
        return np.asarray(actions[0] if single else actions)


class Mixture(Inner):
    """One of several policies, drawn with equal chances when an episode begins, also when `greedy`, and kept to its end.

    A policy that came of another part of a log has its own coordinates, so these are whole policies: a mixture sees raw
    observations and gives the environment's actions.

    Attributes:
        members: the policies.
    """

    members: tuple[Deployed, ...]

    @classmethod
    def of(cls, members: Sequence[Deployed]) -> Deployed:
        """Of policies with equal sizes, as what is saved and judged."""
        return Deployed(cls(tuple(members)), None, None, None, None)

    def start(self, n: int) -> tuple[Array, tuple[Any, ...]]:
        """(n,) which member acts, not drawn yet, and the members' carries."""
        return jnp.zeros(n, jnp.int32), tuple(member.start(n) for member in self.members)

    def act(self, step, carry, key, *, greedy):
        """See `Inner`; in the environment's bounds."""
        which, carries = carry
        draw, *keys = jax.random.split(key, 1 + len(self.members))
        first = jnp.asarray(step.first, bool)
        which = jnp.where(first, jax.random.randint(draw, first.shape, 0, len(self.members)), which)
        acts = [member.act(step, c, k, greedy=greedy) for member, c, k in zip(self.members, carries, keys)]
        actions = jnp.stack([action for action, _ in acts])
        return actions[which, jnp.arange(len(which))], (which, tuple(kept for _, kept in acts))


@eqx.filter_jit
def first_actions(policy: Deployed, observations: Array, key: PRNGKeyArray, greedy: bool) -> Array:
    """What the policy does at raw observations (n, *shape) as the first of an episode, (n, size)."""
    n = len(observations)
    step = Step(observations, jnp.zeros(n), jnp.ones(n, bool))
    return policy.act(step, policy.start(n), key, greedy=greedy)[0]


@eqx.filter_jit
def _chances(policy: Deployed, observations: Array) -> Array:
    assert isinstance(policy.inner, Categorical | Supported)
    return policy.inner.chances(policy.view.observe(observations))


class BlackBoxPolicy:
    """Any Python function `fn(observations, rng) -> actions` on numpy arrays as a policy.

    Args:
        fn: gets observations (n, *shape) and a `numpy.random.Generator`, gives actions (n, size), or (n,) discrete ones.
        log_prob: gets observations and actions, gives their log-densities (n,); None where it is not known.
        action_probs: of discrete actions: gets observations, gives (n, actions) probabilities; None where it is not known.
    """

    def __init__(
        self,
        fn: Callable[[np.ndarray, np.random.Generator], np.ndarray],
        log_prob: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
        action_probs: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        self.fn, self._log_prob, self.action_probs = fn, log_prob, action_probs

    @property
    def has_log_prob(self) -> bool:
        """Whether `log_prob` is defined."""
        return self._log_prob is not None

    def log_prob(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """(n,) log-densities of actions, where the function came with them."""
        if self._log_prob is None:
            raise UserError("this BlackBoxPolicy has no log-probabilities; give it log_prob=")
        return np.asarray(self._log_prob(observations, actions))

    def start(self, n: int) -> tuple[()]:
        """Nothing is carried; what the function remembers is its own affair."""
        return ()

    def act(self, step: Step, carry: Any, key: Any, *, greedy: bool = False) -> tuple[np.ndarray, Any]:
        """Calls the function. `key` may be a numpy generator or a JAX key."""
        if not isinstance(key, np.random.Generator):
            key = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        actions = np.asarray(self.fn(np.asarray(step.observation), key))
        if len(actions) != len(step.observation):
            raise UserError(f"the policy function gave {len(actions)} actions for {len(step.observation)} observations")
        return actions, carry

    def __call__(self, observations: Any) -> np.ndarray:
        """The function's actions with a generator seeded with 0."""
        x = np.asarray(observations)
        single = x.ndim == 1
        actions = self.act(Step(x[None] if single else x, None, None), (), np.random.default_rng(0))[0]
        return actions[0] if single else actions
