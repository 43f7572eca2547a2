"""The behaviour policy, fitted out of fold: propensities of rows come from models not trained on their episode.

A model that was trained on a row overestimates the probability of its action, which makes the weights too small. So each fold
has its own models, a network and a linear one. They are trained on the other folds and on all episodes that are not evaluated,
except for a tenth of these, on which training stops where the loss is smallest. The models of all folds are trained at once, in
one vectorised program.

Of discrete actions the model with the smaller loss is used, because a network needs more rows than a log often has. Its
temperature is then fitted on that tenth as well (Guo et al. 2017), shifts give each action its logged frequency, and the
probabilities are smoothed towards the actions' overall frequencies, which count as a few rows. The densities of continuous
actions are a mixture of both models, with shares that are fitted on that tenth (stacking; Yao et al. 2018), and of the overall
density, which counts as a few rows: where a network extrapolates, it may find an action impossible. Clipped Gaussians, which
have probabilities at the bounds, are not mixed.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import logsumexp, ndtr, softmax

from deadreckon.data.batch import Batch, BatchSpec, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.legal import legal_at
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import ensemble
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import Best, in_blocks
from deadreckon.ope.ends import within_bounds
from deadreckon.ope.propensities import shifts, stacked, temperature
from deadreckon.policies import behavior as models
from deadreckon.policies.kinds import Categorical, create_actor
from deadreckon.randomness import generator

PRIOR = 10.0  # weight, in rows, of the prior that the temperature is one
SHARES = 20.0  # weight, in rows, of the prior that an action is as likely everywhere as it is overall
REVISION = 2  # 2: densities are mixtures; part of the identity of estimates that are made out of fold
EQUAL = 1.0  # weight, in rows, of the prior that a network and a linear model have equal shares of a density
LOOKED_AT = 4096  # most rows on which propensities are calibrated
CHECKED = 0.1  # share of the episodes outside a fold that early stopping uses


class State(NamedTuple):
    """Networks and linear models (folds, ...), their optimiser, and the best parameters of each so far."""

    nets: tuple[Any, ...]
    opt: Any
    best: tuple[Best, ...]


class Folds(eqx.Module):
    """The learner: a network and a linear model for each fold, by maximum likelihood."""

    model: BehaviorModel
    folds: int = eqx.field(static=True)

    def needs(self, spec):
        """Observations and actions; each row also has the columns `weight` and `check` (folds,)."""
        return BatchSpec(columns=("observation", "action"), batch_size=self.model.batch_size, standardise=True)

    def init(self, spec, key):
        """Initial models."""
        make = models.Clipped.create if self.model.clipped else create_actor
        shapes = dict.fromkeys((self.model.hidden, ()))
        # Networks and linear models may share a key: their shapes differ, and only their losses are compared.
        nets = tuple(ensemble(lambda k, hidden=hidden: make(spec, hidden, k), self.folds, key) for hidden in shapes)
        return State(nets, init_opt(nets), tuple(Best.begin(each, (self.folds,)) for each in nets))

    def update(self, state: State, batch: Batch, *, step, key):
        """One step of maximum likelihood for every fold, on the rows outside the fold."""
        assert batch.extra is not None
        weight, check = batch.extra["weight"].T, batch.extra["check"].T

        def loss(nets):
            nll = [-jax.vmap(lambda net: models.log_prob(net, batch.observation, batch.action))(each) for each in nets]
            checked = [(each * check).sum(-1) / jnp.maximum(check.sum(-1), 1e-6) for each in nll]
            return sum((each * weight).mean(-1).sum() for each in nll), checked

        grads, checked = jax.grad(loss, has_aux=True)(state.nets)
        nets, opt = apply_gradients(state.nets, grads, state.opt, self.model.lr)
        known = check.sum(-1) > 0
        best = tuple(best.look(own, seen, known, step, 0.0) for best, own, seen in zip(state.best, nets, checked))
        return State(nets, opt, best), {"behavior_nll": jnp.stack(checked).min(0).mean()}


class Behavior(NamedTuple):
    """The behaviour policy on the evaluated rows, by models that were not trained on their episodes.

    Attributes:
        log_probs: (rows,) log-probabilities of the logged actions, or log-densities.
        chances: (rows, actions) probabilities of all actions; None for continuous actions.
        ranks: (rows, size) for continuous actions the probability that each number of an action is below the logged one, and
            half of the probability that it is equal, by the models without the overall density; uniform if they are right. None
            for discrete actions.
    """

    log_probs: np.ndarray
    chances: np.ndarray | None
    ranks: np.ndarray | None


def out_of_fold(case: OPEInput, model: BehaviorModel, folds: int, *, clipped: bool = False) -> Behavior:
    """Propensities of a case's rows; computed once.

    Args:
        case: log and policies.
        model: size of the networks and of the fit.
        folds: number of parts of the evaluated episodes.
        clipped: whether the model has probabilities at the bounds of continuous actions; see `OPEInput.clips`.
    """
    model = dataclasses.replace(model, clipped=clipped)
    return case.once(("propensities", model, folds), lambda: _fit(case, model, folds))


def masks(case: OPEInput, fold: np.ndarray, whole: OPEInput) -> tuple[np.ndarray, np.ndarray]:
    """(episodes of the whole log, folds) of 0 and 1: the training episodes of each fold's model, and those of its early
    stopping.

    Clusters stay whole. With few clusters, the training episodes also decide when to stop. Where clusters are of unequal
    sizes, see `_stopping`.
    """
    count = int(fold.max()) + 1
    of_all = np.full(whole.data.episodes, -1)
    of_all[case.held] = fold
    weight = (of_all[:, None] != np.arange(count)).astype(np.float32)
    clusters = whole.clusters
    draw = generator(case.seed, "check").random((int(clusters.max()) + 1, count))
    rows = np.stack([np.bincount(clusters, own * whole.data.lengths, len(draw)) for own in weight.T], 1)
    some = np.stack([_stopping(u, own) for u, own in zip(draw.T, rows.T)], 1)[clusters]
    check = weight * some
    alone = (check.sum(0) == 0) | (weight.sum(0) < 20)
    return np.where(alone, weight, weight * ~some), np.where(alone, weight, check)


def _stopping(draw: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(clusters,) bool, those of early stopping: a random share.

    Where clusters are of unequal sizes, these may have few rows. If their share of the rows is less than half of their share of
    the clusters, further ones are added until they have half of `CHECKED` of the rows; never more than half of the rows.

    Args:
        draw: (clusters,) uniform random numbers.
        rows: (clusters,) numbers of training rows.
    """
    out, total = draw < CHECKED, rows.sum()
    some = rows[out].sum()
    if some >= out[rows > 0].mean() / 2 * total:
        return out
    for each in np.argsort(draw)[int(out.sum()) :].tolist():  # the first are those of early stopping already
        if some >= CHECKED / 2 * total:
            break
        if some + rows[each] <= total / 2:
            out[each], some = True, some + rows[each]
    return out


class Trained(NamedTuple):
    """The models of all folds.

    Attributes:
        nets: networks and linear models, each (folds, ...).
        which: (folds,) index of the better of both.
        view: how they see observations and actions.
        weight, check: (rows of the whole log, folds) 0 or 1, on which rows they were trained, and by which they were stopped.
    """

    nets: tuple[Any, ...]
    which: Any
    view: Normalizer
    weight: np.ndarray
    check: np.ndarray

    def outputs(self, function: Callable[..., Any], observations: Any, *columns: np.ndarray) -> np.ndarray:
        """What a jitted `function` of models, index of the better, observations and further columns returns; rows last."""
        run = lambda seen, *more: function(self.nets, self.which, self.view.observe(np.asarray(seen)), *more)  # noqa: E731
        return in_blocks(run, observations, *columns)

    def gaussians(self, observations: Any, fold: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each model of a fold the (rows, size) means and deviations of actions before the tanh."""
        heads = self.outputs(_heads, np.asarray(observations))[:, :, fold].astype(np.float64)
        return [(mean.T, std.T) for mean, std in heads]


def _fit(case: OPEInput, model: BehaviorModel, folds: int) -> Behavior:
    fold, whole = case.folds(folds), case.whole()
    weight, check = (each[whole.data.episode_of] for each in masks(case, fold, whole))
    gaussian = not (model.clipped or whole.data.spec.discrete)
    learner, data = Folds(model, weight.shape[1]), within_bounds(whole.data) if gaussian else whole.data
    rows = TransitionSource(data, learner.needs(data.spec), {"weight": weight, "check": check})
    state = case.train(learner, rows, model.steps, "behaviour by folds")
    which = jnp.stack([best.loss for best in state.best]).argmin(0)
    trained = Trained(tuple(best.params for best in state.best), which, rows.view, weight, check)
    own, of_row, rng = case.data, fold[case.data.episode_of], generator(case.seed, "calibration")
    if data.spec.discrete:
        return _discrete(trained, data, own, of_row, rng)
    return _gaussian(trained, data, own, of_row, case.within, rng) if gaussian else _clipped(trained, own, of_row)


def _discrete(trained: Trained, data: Dataset, own: Dataset, of_row: np.ndarray, rng: np.random.Generator) -> Behavior:
    """Probabilities of all actions.

    Args:
        trained: models.
        data: the whole log, as models have seen it.
        own: the evaluated episodes.
        of_row: (rows of `own`,) the fold of each.
        rng: of the rows that calibrate.
    """
    of_all = lambda seen: np.moveaxis(trained.outputs(_logits, seen), 1, 2)  # noqa: E731 - (folds, rows, actions)
    logits = of_all(own.observations)[of_row, np.arange(len(own))].astype(np.float64)
    actions = logits.shape[1]
    mixed, kept = np.empty((len(own), actions)), np.empty(len(own))
    taken = np.asarray(data.actions)
    for k in range(trained.check.shape[1]):
        # The temperature is fitted on the rows of early stopping, the shifts on all rows outside the fold; a few thousand are
        # enough.
        told = [_some(columns[:, k] > 0, rng) for columns in (trained.check, trained.weight + trained.check)]
        logits_of = [of_all(np.asarray(data.observations[some]))[k].astype(np.float64) for some in told]
        sure = temperature(logits_of[0], taken[told[0]], PRIOR)
        logits[of_row == k] = logits[of_row == k] / sure + shifts(logits_of[1] / sure, taken[told[1]])
        # Smoothing towards the overall frequencies, and towards equal ones with the weight of one row: no action has
        # probability zero, even if rows are few, and the number of rows bounds the weights.
        n = trained.weight[:, k].sum()
        shares = np.bincount(taken[told[1]], minlength=actions) / len(told[1])
        mixed[of_row == k] = (SHARES * shares + 1.0 / actions) / (n + SHARES + 1.0)
        kept[of_row == k] = n / (n + SHARES + 1.0)
    chances = kept[:, None] * softmax(logits, axis=1) + mixed
    if (mask := legal_at(own.observations, data.action_space)) is not None:  # overall frequencies ignore what was legal
        chances = chances * mask
        chances /= chances.sum(1, keepdims=True)
    return Behavior(np.log(chances[np.arange(len(own)), np.asarray(own.actions)]), chances, None)


def _gaussian(
    trained: Trained, data: Dataset, own: Dataset, of_row: np.ndarray, actions: np.ndarray, rng: np.random.Generator
) -> Behavior:
    """Densities of mixtures of tanh-Gaussians at these (rows, size) actions, and ranks; arguments as for `_discrete`."""
    pre_of = lambda taken: np.arctanh(np.asarray(trained.view.to_unit(np.asarray(taken))).astype(np.float64))  # noqa: E731
    pre, every = pre_of(actions), pre_of(data.actions)
    out, ranks = np.empty(len(own)), np.zeros(pre.shape)
    for k in range(trained.check.shape[1]):
        rows, checked = np.flatnonzero(of_row == k), _some(trained.check[:, k] > 0, rng)
        told = trained.gaussians(data.observations[checked], k)
        shares = stacked(np.stack([normal(every[checked], *one) for one in told]), EQUAL)
        each = trained.gaussians(own.observations[rows], k)
        for share, (mean, std) in zip(shares, each):
            ranks[rows] += share * ndtr((pre[rows] - mean) / std)
        # As many rows as `SHARES` have the density of all rows: none is impossible, even if rows are few.
        outside = every[(trained.weight + trained.check)[:, k] > 0]
        each.append((outside.mean(0), np.maximum(outside.std(0), np.exp(dist.LOG_STD_MIN))))
        smooth = SHARES / (trained.weight[:, k].sum() + SHARES)
        shares = np.append((1.0 - smooth) * shares, smooth)
        out[rows] = logsumexp([normal(pre[rows], *one) for one in each], axis=0, b=shares[:, None])
    return Behavior(out - np.log1p(-np.square(np.tanh(pre))).sum(1) - trained.view.log_scale, None, ranks)


def normal(x: np.ndarray, mean: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(rows,) log-densities of independent normal numbers (rows, size)."""
    return (-0.5 * np.square((x - mean) / std) - np.log(std * np.sqrt(2.0 * np.pi))).sum(1)


def _clipped(trained: Trained, own: Dataset, of_row: np.ndarray) -> Behavior:
    """Densities of clipped Gaussians, which have probabilities at the bounds, and ranks; arguments as for `_discrete`."""
    unit, rows = np.asarray(trained.view.to_unit(np.asarray(own.actions))), np.arange(len(own))
    told = trained.outputs(_densities, own.observations, unit)[of_row, rows].astype(np.float64)
    ranks = trained.outputs(_ranks, own.observations, unit)[of_row, :, rows].astype(np.float64)
    return Behavior(told - trained.view.log_scale_within(unit), None, ranks)


def _some(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """At most `LOOKED_AT` of the rows that are marked."""
    found = np.flatnonzero(rows)
    return np.sort(rng.choice(found, min(len(found), LOOKED_AT), replace=False))


@jax.jit
def _heads(nets: tuple[Any, ...], which: Any, observation: Any) -> Any:
    """(models, 2, folds, size, rows) means and deviations before the tanh, of networks and of linear models."""

    def head(net: Any) -> Any:
        d = dist.gaussian_head(net(observation))
        return jnp.stack([d.mean.T, jnp.exp(d.log_std).T])

    return jnp.stack([jax.vmap(head, out_axes=1)(each) for each in nets])


@jax.jit
def _densities(nets: tuple[Any, ...], which: Any, observation: Any, action: Any) -> Any:
    return _taken([jax.vmap(lambda net: models.log_prob(net, observation, action))(each) for each in nets], which)


@jax.jit
def _ranks(nets: tuple[Any, ...], which: Any, observation: Any, action: Any) -> Any:
    """(folds, size, rows)."""
    return _taken([jax.vmap(lambda net: models.clipped_rank(net, observation, action).T)(each) for each in nets], which)


@jax.jit
def _logits(nets: tuple[Categorical, ...], which: Any, observation: Any) -> Any:
    """(folds, actions, rows)."""
    return _taken([jax.vmap(lambda net: net.log_probs(observation).T)(each) for each in nets], which)


def _taken(found: list[Any], which: Any) -> Any:
    """(folds, *) outputs of the better model of each fold."""
    return jnp.take_along_axis(jnp.stack(found), which.reshape(1, -1, *[1] * (found[0].ndim - 1)), 0)[0]
