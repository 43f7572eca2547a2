"""The actions of policies on the rows of a log, as arrays: estimators use these and never a policy's network.

So policies of different kinds share one compiled program, and any Python function is a policy.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.legal import legal_at
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Spec
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.policies.candidates import OneStep
from deadreckon.policies.deployed import EnvPolicy, first_actions
from deadreckon.policies.kinds import Deterministic, Gaussian, TanhMeanGaussian
from deadreckon.randomness import generator, sequence

BLOCK = 8192  # rows at a time
LIMIT = 2**30  # bytes of a table above which it is kept in a file
NOISE = 0.01  # standard deviation, on the scale where actions are in [-1, 1], of noise for deterministic policies (thesis 8.5)
DRAWS = 100  # draws from a discrete policy that does not give its probabilities


@dataclass(frozen=True)
class Actor:
    """Several policies that act on batches of observations.

    Attributes:
        policies: with continuous actions, or all discrete ones.
        names: one each.
        spec: of the log.
        greedy: deterministic (greedy) instead of sampled actions.
        seed: of all draws; those of a table do not depend on other tables.
        noise: standard deviation, on the scale where actions are in [-1, 1], of noise that deterministic policies of continuous
            actions get if weights need a density (thesis 8.5); None: their logged actions have probability zero, and so have
            those of policies that give no probabilities.
        illegal: (probability of illegal actions, rows) so far of each policy that gives them any; it is evaluated as if it drew
            again until an action is legal.
        parts: slice of an observation that each policy acts on, such as the end of a history; None: all.

    Raises:
        UserError: a policy with a memory, without the requested kind of actions, or for other observations or actions.
    """

    policies: Sequence[Any]
    names: Sequence[str]
    spec: Spec
    greedy: bool
    seed: int
    noise: float | None = NOISE
    illegal: dict[int, tuple[float, int]] = field(default_factory=dict, init=False, compare=False)
    parts: Sequence[slice] | None = None

    def __post_init__(self):
        parts = self.parts or [slice(0, self.spec.observation_size)] * len(self.policies)
        for policy, name, part in zip(self.policies, self.names, parts):
            size = part.stop - part.start
            if jax.tree.leaves(policy.start(1)):
                raise UserError(f"{name} has a memory; estimators evaluate policies that act on the observation alone")
            if self.greedy and not self.spec.discrete and not isinstance(policy, EnvPolicy) and policy.has_log_prob:
                raise UserError(
                    f"{name} samples its actions and has no deterministic (greedy) one; evaluate sampled actions (greedy=False)"
                )
            wanted = _observation_size(policy)
            if wanted not in (None, size):
                raise UserError(f"{name} is made for observations of {wanted} numbers, {self.spec.name} has {size}")
            if isinstance(policy, EnvPolicy):
                self._fits(name, _action_shape(policy, size))

    def _seen(self, which: int, observations: np.ndarray) -> np.ndarray:
        """The part of observations that one policy acts on."""
        return observations if self.parts is None else observations[:, self.parts[which]]

    def _fits(self, name: str, shape: tuple[int, ...]) -> None:
        """Refuses a policy whose actions, of that shape a row, are not the log's."""
        wanted = () if self.spec.discrete else (self.spec.action_size,)
        if shape != wanted:
            given = f"of shape {shape}" if shape else "that are one number"
            has = f"one of {self.spec.action_size} choices" if self.spec.discrete else f"shape {wanted}"
            raise UserError(f"{name} gives actions {given}, {self.spec.name} has {has}")

    def table(self, observations: Any, samples: int, purpose: str, more: int = 0) -> np.ndarray:
        """The actions of each policy at each observation.

        Args:
            observations: (rows, *shape) raw, an array or an object whose slices are arrays.
            samples: draws per row, of continuous actions.
            purpose: name of the table; tables with different names have independent draws.
            more: number of further policies, whose entries the caller fills in.

        Returns:
            (rows, policies + more, samples, size) float32 actions in [-1, 1], or probabilities (rows, policies + more, n) of
            discrete ones.

        Raises:
            UserError: a policy whose actions or probabilities are not finite or do not fit the log.
        """
        rows = len(observations)
        inner = (self.spec.action_size,) if self.spec.discrete else (1 if self.greedy else samples, self.spec.action_size)
        out = _room((rows, len(self.policies) + more, *inner))
        for start in range(0, rows, BLOCK):
            part = np.asarray(observations[start : start + BLOCK])
            for i, name in enumerate(self.names):
                entropy = sequence(self.seed, f"actions, {purpose}", start, i)
                if self.spec.discrete:
                    found = self._probabilities(i, part, entropy)
                else:
                    found = self._actions(i, part, entropy, inner[0])
                if not np.isfinite(found).all():
                    raise UserError(f"{name} gives actions that are not finite")
                out[start : start + len(part), i] = found
        return out

    @property
    def degenerate(self) -> np.ndarray:
        """(policies,) whether importance weights are degenerate: actions are continuous, and the policy is deterministic or
        gives no probabilities of its actions."""
        if self.spec.discrete:
            return np.zeros(len(self.policies), bool)
        return np.array([self.greedy or draws_nothing(policy) or not policy.has_log_prob for policy in self.policies])

    def act(self, which: int, observations: np.ndarray, t: int) -> np.ndarray:
        """The actions of one policy at raw observations (rows, *shape) at step `t` of simulated episodes.

        Returns:
            (rows, size) actions in [-1, 1], or (rows,) indices.
        """
        entropy = sequence(self.seed, "actions, made up", t, which)
        if not self.spec.discrete:
            return self._actions(which, observations, entropy, 1)[:, 0]
        chances = self._probabilities(which, observations, entropy).cumsum(1)
        drawn = generator(self.seed, "choices, made up", t, which).random(len(observations)) * chances[:, -1]
        return (drawn[:, None] >= chances[:, :-1]).sum(1)

    def log_probs(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """(policies, rows) float64 log-densities of the environment's actions, or log-probabilities of discrete ones.

        A deterministic policy gets Gaussian noise with the standard deviation `noise`.

        Raises:
            UserError: a policy samples its actions and gives no probabilities of them.
        """
        out = np.empty((len(self.policies), len(actions)))
        view, degenerate = Normalizer.of(self.spec), self.degenerate
        for start in range(0, len(actions), BLOCK):
            part, taken = np.asarray(observations[start : start + BLOCK]), np.asarray(actions[start : start + BLOCK])
            for i, (policy, name) in enumerate(zip(self.policies, self.names)):
                entropy = sequence(self.seed, "probabilities", start, i)
                if self.spec.discrete:
                    chosen = self._probabilities(i, part, entropy)[np.arange(len(taken)), taken]
                    with np.errstate(divide="ignore"):
                        found = np.log(chosen)
                elif self.noise is None and degenerate[i]:
                    found = -np.inf
                elif self.greedy or draws_nothing(policy):
                    unit = self._actions(i, part, entropy, 1)[:, 0]
                    assert self.noise is not None
                    z = (view.to_unit(taken) - unit) / self.noise
                    found = -0.5 * np.square(z).sum(1) - z.shape[1] * np.log(self.noise * np.sqrt(2 * np.pi)) - view.log_scale
                elif policy.has_log_prob:
                    own, seen = isinstance(policy, EnvPolicy), self._seen(i, part)
                    found = _padded(_log_prob, policy, seen, taken) if own else policy.log_prob(seen, taken)
                    if (shape := np.shape(found)) != (len(taken),):
                        raise UserError(f"{name}: log_prob must give one number per row, ({len(taken)},), got {shape}")
                else:
                    raise UserError(
                        f"{name} samples its actions without giving their probabilities; use BlackBoxPolicy(fn, log_prob=...) "
                        "or an estimator that needs no probabilities, such as FQE"
                    )
                out[i, start : start + len(taken)] = found if np.isscalar(found) else np.asarray(found)
        if np.isnan(out).any() or np.isposinf(out).any():
            bad = int(np.argwhere(np.isnan(out) | np.isposinf(out))[0][0])
            raise UserError(f"{self.names[bad]} gives log-probabilities that are not finite")
        return out

    def _actions(self, which: int, observations: np.ndarray, entropy: np.random.SeedSequence, samples: int) -> np.ndarray:
        """(rows, samples, size) in [-1, 1]."""
        policy, observations = self.policies[which], self._seen(which, observations)
        if isinstance(policy, EnvPolicy):
            seed = jnp.uint32(entropy.generate_state(1)[0])
            drawn = _padded(_draw, policy, observations, seed=seed, samples=samples, greedy=self.greedy)
        else:
            rng = np.random.default_rng(entropy)
            step = Step(observations, np.zeros(len(observations)), np.ones(len(observations), bool))
            drawn = np.stack([policy.act(step, (), rng, greedy=self.greedy)[0] for _ in range(samples)], 1)
            self._fits(self.names[which], drawn.shape[2:])
        return np.asarray(Normalizer.of(self.spec).to_unit(np.asarray(drawn, np.float32)))

    def _probabilities(self, which: int, observations: np.ndarray, entropy: np.random.SeedSequence) -> np.ndarray:
        """(rows, n) probabilities of a discrete policy, by its method or by frequencies of draws, which are unbiased; legal
        actions only."""
        observations = self._seen(which, observations)
        tells = getattr(self.policies[which], "action_probs", None)
        shape = len(observations), self.spec.action_size
        if tells is None and not getattr(self.policies[which], "has_log_prob", False):
            found = self._legal(which, self._counted(which, observations, entropy), observations)
        else:
            told = np.asarray(self._told(which, observations) if tells is None else tells(observations), np.float64)
            if told.shape != shape or not (told >= 0).all() or np.abs(told.sum(1) - 1).max(initial=0) > 1e-3:
                sums = f" and sums from {told.sum(1).min():.4g} to {told.sum(1).max():.4g}" if told.shape == shape else ""
                by = "log_prob" if tells is None else "action_probs"
                raise UserError(
                    f"{by} must give {shape} probabilities that sum to 1 in each row, got shape {told.shape}{sums}"
                )
            found = self._legal(which, told / told.sum(1, keepdims=True), observations)
        return np.eye(shape[1], dtype=np.float32)[found.argmax(1)] if self.greedy else found.astype(np.float32)

    def _told(self, which: int, observations: np.ndarray) -> np.ndarray:
        """(rows, n) probabilities of a discrete policy that gives log-probabilities of actions."""
        actions = [np.full(len(observations), each) for each in range(self.spec.action_size)]
        return np.exp(np.stack([self.policies[which].log_prob(observations, each) for each in actions], 1))

    def _counted(self, which: int, observations: np.ndarray, entropy: np.random.SeedSequence) -> np.ndarray:
        """(rows, n) frequencies in `DRAWS` draws from a policy that does not give its probabilities."""
        policy, rng, rows = self.policies[which], np.random.default_rng(entropy), np.arange(len(observations))
        counts = np.zeros((len(rows), self.spec.action_size))
        step = Step(observations, np.zeros(len(rows)), np.ones(len(rows), bool))
        for _ in range(DRAWS):
            chosen = np.asarray(policy.act(step, (), rng, greedy=self.greedy)[0])
            if chosen.shape != rows.shape or chosen.min(initial=0) < 0 or chosen.max(initial=0) >= self.spec.action_size:
                raise UserError(f"a policy of this log gives one of 0 .. {self.spec.action_size - 1} per row")
            counts[rows, chosen.astype(int)] += 1.0
        return counts / DRAWS

    def _legal(self, which: int, chances: np.ndarray, observations: np.ndarray) -> np.ndarray:
        """Probabilities (rows, n), normalised over legal actions; those of illegal actions are added to `illegal`."""
        if (mask := legal_at(observations, self.spec.action)) is None:
            return chances
        lost, kept = (chances * ~mask).sum(1), (chances * mask).sum(1, keepdims=True)
        if not kept.all():
            row = int(np.argmin(kept[:, 0]))
            only = ", ".join(map(str, np.flatnonzero(mask[row])))
            raise UserError(f"{self.names[which]} gives only illegal actions at an observation where the legal ones are {only}")
        if lost.any():
            mass, rows = self.illegal.get(which, (0.0, 0))
            self.illegal[which] = mass + float(lost.sum()), rows + len(lost)
        return chances * mask / kept

    def warnings(self) -> list[str]:
        """Warnings about policies that give probability to illegal actions."""
        return [
            f"{self.names[i]} gives {mass / rows:.2%} of its probability to illegal actions: it is estimated as if it drew "
            "again until an action is legal"
            for i, (mass, rows) in sorted(self.illegal.items())
        ]


def _observation_size(policy: Any) -> int | None:
    """Number of observations of a policy of this package; None if not known."""
    if not isinstance(policy, EnvPolicy) or not hasattr(policy.inner, "net"):
        return None
    net = policy.inner.net
    # A one-step policy also has noise of the size of an action as input.
    return int(net.weights[0].shape[0]) - (int(net.biases[-1].shape[-1]) if isinstance(policy.inner, OneStep) else 0)


def _action_shape(policy: EnvPolicy, observation_size: int) -> tuple[int, ...]:
    """Shape of one action of a policy of this package."""
    seen = jax.ShapeDtypeStruct((1, observation_size), np.float32)
    return eqx.filter_eval_shape(lambda x: first_actions(policy, x, jax.random.key(0), True), seen).shape[1:]


def draws_nothing(policy: Any) -> bool:
    """Whether a policy of this package is deterministic."""
    if not isinstance(policy, EnvPolicy):
        return False
    inner = policy.inner
    if isinstance(inner, Gaussian) and not isinstance(inner, TanhMeanGaussian):  # published without a deviation
        return bool(np.isneginf(inner.net.biases[-1][inner.net.biases[-1].shape[0] // 2 :]).all())
    return isinstance(inner, Deterministic)


def _room(shape: tuple[int, ...]) -> np.ndarray:
    """A float32 array in memory, or above `LIMIT` in a file that is removed with it."""
    if 4 * int(np.prod(shape)) <= LIMIT:
        return np.empty(shape, np.float32)
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, np.float32, "w+", shape=shape)


def _padded(function: Any, policy: EnvPolicy, *columns: np.ndarray, **options: Any) -> np.ndarray:
    """`function` on columns padded to a whole block, so that the last, shorter block needs no further compilation."""
    rows = len(columns[0])
    size = min(BLOCK, 1 << (rows - 1).bit_length())
    wide = [np.concatenate([c, np.repeat(c[-1:], size - rows, 0)]) if size > rows else c for c in columns]
    return np.asarray(function(policy, *map(jnp.asarray, wide), **options))[:rows]


@eqx.filter_jit
def _draw(policy: EnvPolicy, observations: Any, *, seed: Any, samples: int, greedy: bool) -> Any:
    """(rows, samples, size) environment actions."""
    step = Step(observations, jnp.zeros(len(observations)), jnp.ones(len(observations), bool))
    keys = jax.random.split(jax.random.key(seed), samples)
    one = lambda key: policy.act(step, policy.start(len(observations)), key, greedy=greedy)[0]  # noqa: E731
    return jnp.moveaxis(jax.vmap(one)(keys), 0, 1)


@eqx.filter_jit
def _log_prob(policy: EnvPolicy, observations: Any, actions: Any) -> Any:
    return policy.log_prob(observations, actions)
