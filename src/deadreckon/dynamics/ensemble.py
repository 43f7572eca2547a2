"""Fits of an ensemble as MBPO makes them: bootstrapped members, a hold-out that stops each, the best of them as elites.

Thesis 5.3 and B.3, settings of the public code: inputs are standardised anew at every fit and targets are not; every member has
its own redrawn rows, shuffled anew in each epoch; of each member the weights of its best epoch are kept, and the fit ends when
for more than `patience` epochs in a row no member has got better by a hundredth. A later fit goes on from the weights of the
one before. An epoch is one compiled program, whatever the number of rows.
"""

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from deadreckon.data.normalizer import STD_FLOOR
from deadreckon.data.spec import Spec
from deadreckon.dynamics.model import Model, known_of, unsaid
from deadreckon.errors import DivergedError, UserError
from deadreckon.nets.optim import init_opt
from deadreckon.randomness import generator, keys
from deadreckon.training.hyperparameters import Count, Range, UnitInterval, static
from deadreckon.training.program import choose

FEWEST = 10  # rows, of which some must be held out


class Ensemble(NamedTuple):
    """A fitted ensemble.

    Attributes:
        params, opt: of all members, and their optimiser.
        mean, std: (inputs,) of the rows that it was fitted to.
        elites: (elites,) members with the least error on rows held out, best first.
    """

    params: Any
    opt: Any
    mean: Float[Array, "i"]
    std: Float[Array, "i"]
    elites: Int[Array, "e"]

    @classmethod
    def unfitted(cls, model: Model, spec: Spec, elites: int, key: PRNGKeyArray) -> "Ensemble":
        """Fresh networks, of which the first are called elites."""
        params, size = model.create(spec, key), spec.observation_size + spec.action_size
        return cls(params, init_opt(params), jnp.zeros(size), jnp.ones(size), jnp.arange(elites, dtype=jnp.int32))

    def standardise(self, inputs: Array) -> Array:
        """Inputs as the networks see them."""
        return (inputs - self.mean) / self.std

    def best(self, order: Int[Array, "e"] | None = None) -> Any:
        """Parameters of the elites alone, from the best one on, or in another order."""
        which = self.elites if order is None else self.elites[order]
        return jax.tree.map(lambda leaf: leaf[which], self.params)


class Report(NamedTuple):
    """How a fit went.

    Attributes:
        epochs: how many.
        error: (members,) mean squared error on the rows held out, of the weights kept.
        elite_error: mean of the elites'.
        rows: to learn from.
    """

    epochs: int
    error: np.ndarray
    elite_error: float
    rows: int


class Trainer(eqx.Module):
    """How an ensemble is fitted."""

    elites: Count = static(5)  # members that are believed
    holdout: Annotated[float, Range(gt=0, lt=1)] = static(0.2)  # share of the rows that are held out
    most_holdout: Count = static(5000)  # of them
    patience: Count = static(5)  # epochs in a row without a better member that a fit goes on after
    better: UnitInterval = static(0.01)  # share by which an error must fall to count
    most_epochs: Count = static(1000)  # of a fit

    def fit(
        self, model: Model, spec: Spec, columns: dict[str, np.ndarray], seed: int, start: Ensemble | None = None
    ) -> tuple[Ensemble, Report]:
        """Fits an ensemble to transitions.

        Args:
            model: what it consists of.
            spec: of the observations and actions.
            columns: `observation`, `action`, `reward`, `next_observation` and `terminal` of some rows.
            seed: random seed.
            start: an earlier ensemble, from whose weights the fit starts.

        Raises:
            UserError: too few rows.
            DivergedError: errors that are not finite.
        """
        inputs, target, terminal = rows_of(columns)
        n = len(inputs)
        if n < FEWEST:
            raise UserError(f"{n} rows are too few to fit a model to, {FEWEST} or more are needed")
        rng = generator(seed, "rows")
        order = rng.permutation(n)
        held = max(1, min(int(self.holdout * n), self.most_holdout))
        held, train = order[:held], order[held:]
        # A sum of many numbers of 32 bits, far from zero, would lose what they differ by.
        mean, std = (of(inputs[train], axis=0, dtype=np.float64).astype(np.float32) for of in (np.mean, np.std))
        std = np.where(std < STD_FLOOR, 1.0, std).astype(np.float32)
        inputs = (inputs - mean) / std
        k_init, k_update = keys(jax.random.key(seed), "init", "update")
        if start is None:
            params = model.create(spec, k_init)
            opt = init_opt(params)
        else:
            params, opt = start.params, start.opt
        data = tuple(_padded(part, room(n)) for part in (inputs, target, terminal))
        judged = _padded(inputs[held], room(len(held))), _padded(target[held], room(len(held)))
        own = rng.integers(0, len(train), (model.members, len(train)))  # one redraw a member
        batches = -(-len(train) // model.batch_size)
        width = room(len(train)) + model.batch_size
        kept = params
        best = np.full(model.members, np.inf)
        idle, epochs = 0, 0
        while idle <= self.patience and epochs < self.most_epochs:
            shuffled = np.take_along_axis(own, np.argsort(rng.random(own.shape), 1), 1)
            # The last batch is filled up from the beginning.
            rows = np.resize(train[shuffled].T, (batches * model.batch_size, model.members)).T
            rows = np.pad(rows, ((0, 0), (0, width - rows.shape[1]))).astype(np.int32)
            part = jax.random.fold_in(k_update, epochs)
            params, opt = _epoch(model, params, opt, data, jnp.asarray(rows), jnp.int32(batches), part)
            error = np.asarray(_errors(model, params, judged, jnp.int32(len(held))), float)
            if not np.isfinite(error).all():
                raise DivergedError(f"model: its error was not finite after epoch {epochs + 1}; a lower learning rate may help")
            improved = error < (1.0 - self.better) * best
            best = np.where(improved, error, best)
            kept = choose(jnp.asarray(improved), params, kept)
            idle = 0 if improved.any() else idle + 1
            epochs += 1
        elites = np.argsort(best, kind="stable")[: self.elites].astype(np.int32)
        found = Ensemble(kept, opt, jnp.asarray(mean, jnp.float32), jnp.asarray(std), jnp.asarray(elites))
        return found, Report(epochs, best, float(best[elites].mean()), len(train))


def rows_of(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs (n, observation + action), targets (n, observation + 1) and terminals (n,) of continuous transitions.

    Changes of observations are NaN in rows that end an episode where the log does not say what they led to.
    """
    observation = np.asarray(columns["observation"], np.float32)
    inputs = np.concatenate([observation, np.asarray(columns["action"], np.float32)], 1)
    reward = np.asarray(columns["reward"], np.float32).reshape(-1, 1)
    following, terminal = (np.asarray(columns[key], np.float32) for key in ("next_observation", "terminal"))
    terminal = terminal.reshape(-1)
    change = np.where(unsaid(observation, following, terminal)[:, None], np.float32(np.nan), following - observation)
    return inputs, np.concatenate([change, reward], 1), terminal


@eqx.filter_jit
def _epoch(
    model: Model, params: Any, opt: Any, data: tuple[Array, ...], rows: Int[Array, "m n"], batches: Array, key: PRNGKeyArray
) -> tuple[Any, Any]:
    def body(i: Array, carry: tuple[Any, Any]) -> tuple[Any, Any]:
        index = jax.lax.dynamic_slice_in_dim(rows, i * model.batch_size, model.batch_size, 1)
        inputs, target, terminal = (part[index] for part in data)
        params, opt, _ = model.step(*carry, inputs, target, terminal, 1.0, jax.random.fold_in(key, i))
        return params, opt

    return jax.lax.fori_loop(0, batches, body, (params, opt))


@eqx.filter_jit
def _errors(model: Model, params: Any, data: tuple[Array, Array], count: Array) -> Float[Array, "m"]:
    """Mean squared error of every member's means over the first `count` rows."""
    inputs, target = data
    mean, _ = model.sample(params, jnp.broadcast_to(inputs, (model.members, *inputs.shape)), None)
    there = jnp.arange(len(inputs)) < count
    target, known = known_of(target)
    error = jnp.where(known, jnp.square(mean - target), 0.0).sum(-1) / known.sum(-1)
    return (error * there).sum(-1) / count


def check_sizes(who: str, members: int, elites: int, hidden: tuple[int, ...], decay: tuple[float, ...]) -> None:
    """Refuses settings of an ensemble that do not fit each other; `who` has them as elites and model_weight_decay.

    Raises:
        UserError: names the setting.
    """
    if elites > members:
        raise UserError(f"{who}.elites are members at most, got {elites} of {members}")
    if len(decay) not in (0, len(hidden) + 1):
        raise UserError(f"{who}.model_weight_decay needs {len(hidden) + 1} numbers, one a layer of the model, got {len(decay)}")


def room(n: int) -> int:
    """The power of two that holds so many rows, 1,024 at least, so that few programs serve data that grows."""
    return 1 << max(n - 1, 1023).bit_length()


def _padded(part: np.ndarray, length: int) -> Array:
    return jnp.asarray(np.pad(part, ((0, length - len(part)), *[(0, 0)] * (part.ndim - 1))))
