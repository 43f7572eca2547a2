"""What every model of dynamics is: an ensemble that learns, and draws the next observation, the reward and whether it ends.

Observations are standardised, and the changes that are learned are of these; rewards are in their standard deviations.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Spec
from deadreckon.nets.mlp import joined, split, stacks
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, Weights, static
from deadreckon.training.learner import Metrics

LOG_VARIANCE = -10.0, 0.5  # first soft bounds of a learned log-variance (Chua et al. 2018)


class Change(NamedTuple):
    """What a step makes of a state, (members, *b, ...): standardised observation, reward in its unit, chance of an end."""

    observation: Array
    reward: Array
    ends: Array


class Limits(NamedTuple):
    """What the log has seen of observations and rewards, on the model's scale; nothing beyond is believed.

    `marks` (0, n) has no numbers: its n is how many of the last numbers of an observation say which actions are legal.
    """

    low: Array
    high: Array
    reward_low: Array
    reward_high: Array
    marks: Array

    @classmethod
    def of(cls, spec: Spec) -> "Limits":
        """The range of a log."""
        o, r, unit = spec.observation, spec.reward, reward_unit(spec)
        view = Normalizer.of(spec, standardise=True)  # in which marks of legal actions are as they are
        low, high = (jnp.asarray(view.observe(edge), jnp.float32).reshape(-1) for edge in (o.min, o.max))
        # Arrays, because numbers of Python would be part of a compiled program, which another log then could not use.
        return cls(low, high, jnp.float32(r.min / unit), jnp.float32(r.max / unit), jnp.zeros((0, spec.mask_size)))

    def hold(self, change: Change) -> Change:
        """The change, cut to the range, with one legal action or more: that which is most likely to be, if no other is."""
        observation = jnp.clip(change.observation, self.low, self.high)
        if count := self.marks.shape[-1]:
            marks = observation[..., -count:]
            legal = (marks > 0.5) | (marks == marks.max(-1, keepdims=True))
            observation = observation.at[..., -count:].set(legal.astype(observation.dtype))
        return change._replace(observation=observation, reward=jnp.clip(change.reward, self.reward_low, self.reward_high))


def unsaid(observation: Any, following: Any, terminal: Any) -> Any:
    """(b,) whether a log does not say what a row led to: it ends an episode, and what follows repeats its own observation; see
    `Dataset.next_observations`. Observations are (b, o), terminals (b,)."""
    return (following == observation).all(-1) & (terminal > 0.5)


def known_of(target: Array) -> tuple[Array, Array]:
    """Targets with a zero where one is not known, and which are."""
    known = ~jnp.isnan(target)
    return jnp.where(known, target, 0.0), known


def reward_unit(spec: Spec) -> float:
    """A model's reward of 1 in the log's own."""
    return float(spec.reward.std) or 1.0


class Model(eqx.Module):
    """Hyperparameters of an ensemble in, pure functions out; a `Learner`.

    Each member learns from the rows by its own weights: the column `weight` (members,) of a batch's `extra`, or all alike.
    """

    members: Count = static(5)  # networks
    hidden: Sizes = static((200, 200, 200, 200))  # width of each hidden layer
    lr: NonNegative = 1e-3  # learning rate
    weight_decay: NonNegative = 1e-5  # decoupled from the gradient (AdamW)
    batch_size: Count = static(256)  # batch size (transitions per update)
    layer_decay: Weights = static(())  # of half the squared weights of each layer, in the loss; none if empty

    def needs(self, spec: Spec) -> BatchSpec:
        """Transitions, standardised."""
        return BatchSpec(batch_size=self.batch_size, standardise=True)

    def create(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The parameters of all members."""
        raise NotImplementedError

    def losses(self, params: Any, inputs: Array, target: Array, terminal: Array, key: PRNGKeyArray) -> Float[Array, "m b"]:
        """Negative log-likelihood of every row under every member, and terms that only the parameters know.

        Args:
            params: of all members.
            inputs: (members, b, observation + action), every member's own rows.
            target: (members, b, observation + 1) change of the observation, and the reward last; NaN where it is not known.
            terminal: (members, b).
            key: of what is random in it.
        """
        raise NotImplementedError

    def sample(self, params: Any, inputs: Float[Array, "m b i"], key: PRNGKeyArray | None) -> tuple[Array, Array]:
        """Changes of the observation with the reward last (members, b, observation + 1), and logits of an end (members, b).

        They are drawn, every member's from its own inputs; without a key they are the means.
        """
        raise NotImplementedError

    def draw(self, params: Any, observation: Float[Array, "m b o"], action: Array, key: PRNGKeyArray) -> Change:
        """A draw of what follows, every member from its own observations (members, b, ...) and actions."""
        drawn, logit = self.sample(params, join(observation, action, self._choices(params)), key)
        return Change(observation + drawn[..., :-1], drawn[..., -1], jax.nn.sigmoid(logit))

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """Parameters and optimiser, and the reward's unit."""
        params = self.create(spec, key)
        return params, init_opt(params), jnp.float32(reward_unit(spec))

    def update(self, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> tuple[Any, Metrics]:
        """One step of maximum likelihood."""
        params, opt, unit = state
        inputs = join(batch.observation, batch.action, self._choices(params))
        change = batch.next_observation - batch.observation
        change = jnp.where(unsaid(batch.observation, batch.next_observation, batch.terminal)[:, None], jnp.nan, change)
        target = jnp.concatenate([change, batch.reward[:, None] / unit], -1)
        weight = 1.0 if batch.extra is None or "weight" not in batch.extra else batch.extra["weight"].T
        inputs, target, terminal = (jnp.broadcast_to(x, (self.members, *x.shape)) for x in (inputs, target, batch.terminal))
        params, opt, metrics = self.step(params, opt, inputs, target, terminal, weight, key)
        return (params, opt, unit), metrics

    def step(self, params: Any, opt: Any, inputs: Array, target: Array, terminal: Array, weight: Any, key: PRNGKeyArray) -> Any:
        """One step of maximum likelihood on every member's own rows, see `losses`, with weights (members, b) or 1."""

        def loss(params, inputs, target, terminal, weight, key):
            each = self.losses(params, inputs, target, terminal, key)
            decay = sum(d * jnp.square(w).sum() / 2.0 for d, w in zip(self.layer_decay, params["nets"].weights))
            return (weight * each).mean(-1).sum() + decay, each

        parts = split((params, inputs, target, terminal, jnp.broadcast_to(weight, terminal.shape)), stacks())
        keys = jax.random.split(key, len(parts))
        grads, each = joined([jax.grad(loss, has_aux=True)(*part, k) for part, k in zip(parts, keys)])
        new, opt = apply_gradients(params, grads, opt, self.lr, self.weight_decay)
        return new, opt, {"model_nll": each.mean()}

    def _choices(self, params: Any) -> int:
        """How many discrete actions there are, 0 for continuous ones."""
        return params["choices"].shape[-1]


def join(observation: Array, action: Array, choices: int) -> Array:
    """A network's input: discrete actions, of which there are `choices`, become one-hot."""
    if choices:
        action = jax.nn.one_hot(action, choices)
    return jnp.concatenate([observation, action], -1)


def choices(spec: Spec, members: int) -> Array:
    """Remembers in a pytree of parameters how many discrete actions there are; it has no numbers."""
    return jnp.zeros((members, 0, spec.action_size if spec.discrete else 0))


def soft_bounds(log_variance: Array, bounds: Array) -> Array:
    """Between the learned `bounds` (2, n), least and greatest, without an edge (Chua et al. 2018)."""
    upper = bounds[1] - jax.nn.softplus(bounds[1] - log_variance)
    return bounds[0] + jax.nn.softplus(upper - bounds[0])


def gaussian_nll(mean: Array, log_variance: Array, target: Array) -> Array:
    """-log N(target; mean, exp(log_variance)) of each number."""
    return 0.5 * (jnp.square(target - mean) * jnp.exp(-log_variance) + log_variance + jnp.log(2 * jnp.pi))


def bernoulli_nll(logit: Array, happened: Array) -> Array:
    """-log of the probability that a logit gives what happened (0 or 1)."""
    return jax.nn.softplus(logit) - happened * logit
