"""Critics of all policies at once: networks stacked as (members, policies, ...) with the same input rows, and their values.

With continuous actions a network takes (observation, action) and has one output; with discrete ones it takes the observation
and has one output per action.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Spec
from deadreckon.nets.mlp import MLP, ensemble

LOOK_RATE, LOOK_EVERY = 0.01, 50  # rate of the running mean of the validation loss, and updates between checks of it
NONE_YET = 1e30  # not infinite, which would count as diverged
BLOCK = 512  # rows at a time: with 11 policies, 10 samples and 256 units, hidden layers of 60 MB


def create(spec: Spec, hidden: tuple[int, ...], members: int, policies: int, key: PRNGKeyArray) -> MLP:
    """Newly initialised networks (members, policies, ...)."""
    inputs = spec.observation_size + (0 if spec.discrete else spec.action_size)
    make = lambda k: MLP.create(inputs, hidden, spec.action_size if spec.discrete else 1, k)  # noqa: E731
    return ensemble(lambda k: ensemble(make, policies, k), members, key)


def taken(critics: MLP, observation: Float[Array, "b o"], action: Array) -> Float[Array, "m p b"]:
    """Every critic's value of one action per row, the same for all critics."""
    if action.ndim == 1:
        out = _each(critics, observation)
        return jnp.take_along_axis(out, action[None, None, :, None], -1)[..., 0]
    return _each(critics, jnp.concatenate([observation, action], -1))[..., 0]


def expected(
    critics: MLP, observation: Float[Array, "b o"], table: Array, through: Callable[[Array], Array] = lambda x: x
) -> Float[Array, "m p b"]:
    """Every critic's mean value over its policy's actions: (b, policies, samples, size), or probabilities (b, policies, n).

    `through` is applied to the networks' outputs before the mean.
    """
    if table.ndim == 3:
        return jnp.einsum("mpbn,bpn->mpb", through(_each(critics, observation)), table)

    def one(net: MLP, own: Float[Array, "b s a"]) -> Float[Array, "b"]:
        # The first layer's product with the observations is done once, however many samples there are.
        size = observation.shape[-1]
        if own.shape[1] == 1:
            return through(net(jnp.concatenate([observation, own[:, 0]], -1))[..., 0])
        pre = (observation @ net.weights[0][:size] + net.biases[0])[:, None] + own @ net.weights[0][size:]
        return through(net.after_first(pre)[..., 0]).mean(1)

    return jax.vmap(lambda member: jax.vmap(one, (0, 1))(member, table))(critics)


def sizes(q: Float[Array, "m p b"]) -> dict[str, Array]:
    """Metrics of a fit by which `Fits.convergence` tells whether it has ended: of each policy the mean of the values and their
    root mean square."""
    means, squares = q.mean((0, 2)), jnp.square(q).mean((0, 2))
    each = {f"q {i}": means[i] for i in range(len(means))}
    return each | {f"size {i}": jnp.sqrt(squares[i]) for i in range(len(squares))}


def where_known(error: Float[Array, "m p b"], extra: dict[str, Array]) -> Float[Array, "m p b"]:
    """Errors of critics, 0 where it is not known what the policy does next; see `OPEInput.known_next`."""
    return error * extra["known"].T if "known" in extra else error


def _each(critics: MLP, inputs: Float[Array, "b i"]) -> Float[Array, "m p b o"]:
    return jax.vmap(jax.vmap(lambda net: net(inputs)))(critics)


_expected, _taken = jax.jit(expected), jax.jit(taken)


class Best(NamedTuple):
    """Early stopping inside a compiled program: the parameters with the lowest loss on rows that they are not trained on.

    Attributes:
        params: (lanes..., *) the best so far; lanes are the separate fits, such as folds.
        loss: (lanes...,) their loss.
        running: (lanes...,) running mean of the current loss.
        looks: (lanes...,) updates whose batch had rows to compute it from.
    """

    params: Any
    loss: Array
    running: Array
    looks: Array

    @classmethod
    def begin(cls, params: Any, lanes: tuple[int, ...]) -> "Best":
        """Before the first update."""
        return cls(jax.tree.map(jnp.copy, params), jnp.full(lanes, NONE_YET), jnp.zeros(lanes), jnp.zeros(lanes))

    def look(self, params: Any, loss: Array, known: Array, step: Array, first: Any) -> "Best":
        """After an update; from update `first` on the parameters of every 50th may be kept.

        Args:
            params: after it.
            loss: (lanes...,) on the batch's rows of early stopping.
            known: whether the batch has such rows, of the loss's first axes; otherwise the loss says nothing.
            step: number of the update.
            first: see above.
        """
        known = jnp.broadcast_to(known.reshape(*known.shape, *[1] * (loss.ndim - known.ndim)), loss.shape)
        rate = jnp.maximum(LOOK_RATE, 1.0 / (self.looks + 1))
        running = self.running + jnp.where(known, rate * (loss - self.running), 0.0)
        looks = self.looks + known
        better = (running < self.loss) & (looks > 0) & (step >= first) & (step % LOOK_EVERY == 0)
        keep = lambda new, old: jnp.where(better.reshape(*better.shape, *[1] * (new.ndim - better.ndim)), new, old)  # noqa: E731
        params = jax.lax.cond(better.any(), lambda: jax.tree.map(keep, params, self.params), lambda: self.params)
        return Best(params, jnp.where(better, running, self.loss), running, looks)


class Fitted(NamedTuple):
    """Fitted critics, whose values are on the scale of returns.

    Attributes:
        critics: (members, policies, ...).
        unit: the return for which their output is 1.
        view: normaliser of their inputs.
    """

    critics: MLP
    unit: float
    view: Normalizer

    def values(self, observations: Any, table: np.ndarray) -> np.ndarray:
        """(members, policies, rows) state values of raw observations, with the table of the policies' actions there."""
        return self._of(_expected, observations, table)

    def of_actions(self, observations: Any, actions: np.ndarray) -> np.ndarray:
        """(members, policies, rows) values of the environment's actions."""
        return self._of(_taken, observations, np.asarray(self.view.to_unit(np.asarray(actions))))

    def _of(self, function: Any, observations: Any, other: np.ndarray) -> np.ndarray:
        of = lambda seen, part: function(self.critics, self.view.observe(seen), part)  # noqa: E731
        return self.unit * in_blocks(of, observations, other)


def in_blocks(function: Callable[..., Any], *columns: Any) -> np.ndarray:
    """`function` of columns, a block of rows at a time; rows are the last axis of its result.

    All blocks have the same shape, so that the function is compiled once.
    """
    rows = len(columns[0])
    size = min(BLOCK, 1 << (rows - 1).bit_length())
    out: np.ndarray | None = None
    for start in range(0, rows, size):
        parts = [np.asarray(column[start : start + size]) for column in columns]
        count = len(parts[0])
        if count < size:
            parts = [np.concatenate([part, np.repeat(part[-1:], size - count, 0)]) for part in parts]
        found = np.asarray(function(*parts))[..., :count]
        if out is None:
            out = np.empty((*found.shape[:-1], rows), np.float32)
        out[..., start : start + count] = found
    assert out is not None
    return out


@dataclass
class OutOfFold:
    """Predictions of nuisance models for episodes that they were not trained on.

    Attributes:
        begins: (policies, episodes) value of the initial observation.
        errors: (policies, rows) r + discount V(s') - Q(s, a); with a horizon, V and Q are of the steps that are left.
        weighted: (policies, rows) the same summed over the steps of an episode, weighted by the ratio of the policy's occupancy
            over the log's rows; None if not requested.
        weights: (policies, rows) these ratios, whose mean over rows is one; likewise.
        mass: (policies, rows) what each row adds to the mass of the policy's occupancy, whose mean over rows is one where the
            log shows all that the policy does (the flow into an end, or into what is discounted away); likewise.
        settled: (policies,) whether the critics' backup converged.
        fitted: (policies,) mean squared error on the rows that the critics were trained on, to compare `errors` with.
        by_fold: function that returns (folds, policies) mean values of all initial observations, by the critics that were
            trained without each fold; None if not needed, or without cross-fitting.
        left_out: share of one fold in all episodes that critics are trained on.
    """

    begins: np.ndarray
    errors: np.ndarray
    weighted: np.ndarray | None
    weights: np.ndarray | None
    mass: np.ndarray | None
    settled: np.ndarray
    fitted: np.ndarray
    by_fold: Callable[[], np.ndarray] | None = None
    left_out: float = np.nan

    @classmethod
    def empty(cls, policies: int, episodes: int, rows: int, marginal: bool) -> "OutOfFold":
        """Arrays of zeros to be filled; `settled` is true."""
        more = lambda: np.zeros((policies, rows)) if marginal else None  # noqa: E731
        begins, errors, fitted = np.zeros((policies, episodes)), np.zeros((policies, rows)), np.zeros(policies)
        return cls(begins, errors, more(), more(), more(), np.ones(policies, bool), fitted)

    @classmethod
    def of_values(cls, case: Any, begins: np.ndarray, now: np.ndarray, last: np.ndarray, chosen: np.ndarray) -> "OutOfFold":
        """From a critic's values.

        Args:
            case: log and policies.
            begins: (policies, episodes) of the initial observations.
            now: (policies, rows) of each row's observation.
            last: (policies, episodes) of the final observations.
            chosen: (policies, rows) of each row's observation and action.
        """
        data, ends = case.data, case.data.ends
        out = cls.empty(case.count, data.episodes, len(data), marginal=False)
        following = np.empty_like(now, np.float64)
        following[:, :-1] = now[:, 1:]
        unknown = ~(case.followed[ends] | np.asarray(data.terminals)[ends])
        following[:, ends] = np.where(np.asarray(data.terminals)[ends] | unknown, 0.0, last)
        out.begins[:] = begins
        out.errors[:] = np.asarray(data.rewards, np.float64) + case.discount * following - chosen
        # No correction where the next observation or, for the behaviour policy, its next action is not known.
        out.errors[:, ends[unknown]] = 0.0
        if case.logged:
            out.errors[-1, ~(case.shown | np.asarray(data.terminals))] = 0.0
        return out
