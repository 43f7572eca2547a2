"""Sums over episodes, weighted by likelihood ratios, which importance sampling and doubly robust estimates share.

With rho_t the product of the ratios pi(a|s) / beta(a|s) of an episode's first t + 1 actions, an estimate is the sum over t of
N_t / D_t, where N_t = sum_i discount^t rho_t^i x_t^i over the episodes i, and D_t is their number or, self-normalised, the sum
of their rho_t. An episode that has ended keeps its last ratio, with terms of zero at later steps. One that was cut off (a
timeout) is no longer counted, because its later rewards are not known; the others are then weighted by the inverse probability
of not being cut off by that step (Kaplan and Meier 1958). Otherwise episodes that end early, and so are never cut off, would be
over-represented. With one weight for a whole episode, cut-off episodes count as they are.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import expit

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.sequences import cumulate, times
from deadreckon.randomness import generator
from deadreckon.stats.bootstrap import RESAMPLES, resample_counts

GROUPS = 1000  # most groups of episodes that are resampled; up to this number each episode is a group
FEW = 10.0  # effective sample size, in episodes, below which there is a warning
QUARTER = 0.25  # share of the discounted time at steps with an effective sample size below the reported one


@dataclass(frozen=True)
class Sums:
    """N and D of one policy, for groups of episodes.

    Attributes:
        numerators: (groups, steps).
        denominators: (groups, steps).
        ess: effective sample size of the weights, (sum w)^2 / sum w^2, in episodes: the lower quartile over the discounted
            time, because a mean would be dominated by the first steps, where it is largest.
    """

    numerators: np.ndarray
    denominators: np.ndarray
    ess: float

    def value(self) -> float:
        """The estimate."""
        return float(_ratios(self.numerators.sum(0), self.denominators.sum(0)).sum())

    def partial(self) -> np.ndarray:
        """(steps,) the estimate up to each step."""
        return np.cumsum(_ratios(self.numerators.sum(0), self.denominators.sum(0)))

    def redraw(self, counts: np.ndarray) -> np.ndarray:
        """(n,) estimates of bootstrap samples; `counts` (n, groups) says how often each group counts."""
        return self.redraw_steps(counts).sum(-1)

    def redraw_steps(self, counts: np.ndarray) -> np.ndarray:
        """(n, steps) the terms of each step in them."""
        return _ratios(counts @ self.numerators, counts @ self.denominators)

    def influence(self) -> np.ndarray:
        """(groups,) influence function of the estimate: its mean is zero, its sum of squares over groups^2 the variance."""
        return self.influence_steps().sum(1)

    def influence_steps(self) -> np.ndarray:
        """(groups, steps) the same for the term of each step."""
        total = self.denominators.sum(0)
        ratio = _ratios(self.numerators.sum(0), total)
        return len(self.numerators) * _ratios(self.numerators - ratio * self.denominators, total[None])


def effective(weights: np.ndarray) -> np.ndarray:
    """Effective sample size of the weights along the last axis, (sum w)^2 / sum w^2; 0 where all are 0."""
    return np.square(weights.sum(-1)) / np.maximum(np.square(weights).sum(-1), 1e-300)


def effective_of_logs(log_weights: np.ndarray) -> np.ndarray:
    """`effective` of weights that are given as logarithms, whose exponentials may overflow; minus infinity is a weight of 0."""
    top = log_weights.max(-1, keepdims=True)
    return effective(np.exp(log_weights - np.where(np.isfinite(top), top, 0.0)))


def few(names: tuple[str, ...], ess: np.ndarray, episodes: int) -> list[str]:
    """A warning if the effective sample size of a policy's weights, of so many episodes, is below `FEW`; else nothing."""
    below = np.flatnonzero(ess < FEW)
    if not len(below):
        return []
    worst = int(below[np.argmin(ess[below])])
    others = f", and {len(below) - 1} more below {FEW:g}" if len(below) > 1 else ""
    return [f"the weights of {names[worst]} rest on {ess[worst]:.1f} of {episodes:,} episodes{others}"]


def _ratios(numerators: np.ndarray, denominators: np.ndarray) -> np.ndarray:
    """The quotient; 0 where the denominator is 0."""
    return np.divide(numerators, denominators, out=np.zeros(np.broadcast_shapes(numerators.shape, denominators.shape)),
                     where=denominators > 0)  # fmt: skip


def _accumulated(shape: tuple[int, ...], where: tuple[np.ndarray, ...], logs: np.ndarray) -> np.ndarray:
    """Logarithms of cumulative sums along the last axis of exp(`logs`) at the indices `where`; later ones are left out."""
    out = np.full((*shape[:-1], shape[-1] + 1), -np.inf)
    np.logaddexp.at(out, where, logs)
    return np.logaddexp.accumulate(out[..., :-1], -1)


class Episodes:
    """The lengths and ends of a log's episodes, and their bootstrap samples: the same for all policies and estimators.

    Args:
        data: the log.
        discount: per step.
        seed: of the bootstrap.
        units: (episodes,) number of the group, 0 .. n - 1, with which each episode is resampled.

    Raises:
        UserError: the log's rows do not follow each other.
    """

    def __init__(self, data: Dataset, discount: float, seed: int, units: np.ndarray):
        if data.successors is not None:
            raise UserError(f"{data.name}: its rows do not follow each other, so ratios cannot be multiplied along them")
        self.lengths, self.count, self.discount = data.lengths, data.episodes, discount
        self.ends = data.ends
        self.of = data.episode_of
        self.time = times(data.lengths)
        self.ended = np.asarray(data.terminals)[self.ends]  # else cut off
        self.steps = int(self.lengths.max())
        # Whether nothing is cut off before the last step: then plain sums are means over episodes.
        self.even = bool((self.ended | (self.lengths == self.steps)).all())
        self.uncensored = self._uncensored()
        self.log_uncensored = np.log(self.uncensored[:-1])[self.time]  # (rows,)
        self.seed = seed
        self.group = units  # (episodes,)
        self.groups = int(units.max()) + 1

    @cached_property
    def counts(self) -> np.ndarray:
        """(n_bootstrap, groups) how often each group counts."""
        # The same for every policy, so that common errors cancel in differences between them.
        return resample_counts(generator(self.seed, "redrawn groups"), self.groups, RESAMPLES)

    def means(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Mean of `x` (episodes,), its (groups,) influence function, and its (n_bootstrap,) bootstrap means."""
        total, size = (np.bincount(self.group, weights, self.groups) for weights in (x, None))
        mean = float(x.mean())
        return mean, self.groups * (total - mean * size) / self.count, (self.counts @ total) / (self.counts @ size)

    def _uncensored(self) -> np.ndarray:
        """(steps + 1,) probability that an episode that does not end is not cut off within so many steps (Kaplan-Meier)."""
        cut = np.bincount(self.lengths[~self.ended], minlength=self.steps + 1)
        over = np.bincount(self.lengths, minlength=self.steps + 1)
        # At risk of a cut-off after s steps are the episodes that continue, and those that are cut off there.
        beyond = self.count - np.cumsum(over)
        at_risk = np.maximum(beyond + cut, 1)
        return np.cumprod(1.0 - cut / at_risk)

    def cumulate(self, log_ratios: np.ndarray) -> np.ndarray:
        """(rows,) log of rho_t: sums of the log-ratios over each episode so far."""
        return cumulate(log_ratios, self.lengths)

    def sums(self, log_rho: np.ndarray, x: np.ndarray, *, normalised: bool, alive_only: bool = False) -> Sums:
        """The sums of one policy, from `log_rho` and `x` (rows,). `alive_only` drops ended episodes, as in the public code."""
        if not alive_only:
            log_rho = log_rho - self.log_uncensored
        last = log_rho[self.ends]
        stays = self.ended & (not alive_only)
        # Sums of the ended episodes' last ratios, in logarithms: (groups, steps) and (steps,).
        where = self.group[stays], self.lengths[stays]
        over = _accumulated((self.groups, self.steps), where, last[stays])
        over_plain = _accumulated((self.steps,), where[1:], last[stays])
        over_squares = _accumulated((self.steps,), where[1:], 2 * last[stays])
        # Weights are taken relative to the largest of their step, so that none overflows.
        top = over_plain.copy()
        np.maximum.at(top, self.time, log_rho)
        top = np.where(np.isfinite(top), top, 0.0)
        cell = self.group[self.of] * self.steps + self.time
        size, shape = self.groups * self.steps, (self.groups, self.steps)
        relative = np.exp(log_rho - top[self.time])
        if normalised:
            rho = relative
            denominators = np.bincount(cell, relative, size).reshape(shape) + np.exp(over - top)
        else:
            with np.errstate(over="ignore"):
                rho = np.exp(log_rho)
            if alive_only:
                denominators = np.bincount(cell, minlength=size).reshape(shape).astype(float)
            else:
                denominators = np.broadcast_to(np.bincount(self.group, minlength=self.groups)[:, None].astype(float), shape)
        numerators = np.bincount(cell, rho * x * self.discount**self.time, size).reshape(shape)
        plain = np.bincount(self.time, relative, self.steps) + np.exp(over_plain - top)
        squares = np.bincount(self.time, np.square(relative), self.steps) + np.exp(over_squares - 2 * top)
        return Sums(numerators, denominators, self.quartile(_ratios(np.square(plain), squares)))

    def quartile(self, ess: np.ndarray) -> float:
        """Lower quartile of (steps,) effective sample sizes, weighted by the discount."""
        fade = self.discount ** np.arange(self.steps)
        order = np.argsort(ess)
        share = np.cumsum(fade[order]) / fade.sum()
        return float(ess[order][np.searchsorted(share, QUARTER)])

    def typical(self, log_rho: np.ndarray, *, whole: bool) -> np.ndarray:
        """(episodes,) logarithm of each episode's weight: its last one if `whole`, else the discounted sum of its weights over
        all steps. After its end an episode keeps its last weight; after a cut-off others have more weight, as in `sums`."""
        if whole:
            return log_rho[self.ends]
        log_rho = log_rho - self.log_uncensored
        with np.errstate(divide="ignore"):
            fade = np.log(self.discount ** np.arange(self.steps))
            rest = np.log(np.append(np.cumsum(np.exp(fade[::-1]))[::-1], 0.0))[self.lengths]
        out = np.where(self.ended, log_rho[self.ends] + rest, -np.inf)
        np.logaddexp.at(out, self.of, log_rho + fade[self.time])
        return out

    def average(self, log_rho: np.ndarray) -> np.ndarray:
        """(episodes,) discounted mean of each episode's weights over all steps, whose expectation is one.

        An ended episode keeps its last. NaN where episodes are cut off before the last step.
        """
        if not self.even:
            return np.full(self.count, np.nan)
        fade = self.discount ** np.arange(self.steps)
        with np.errstate(over="ignore"):
            total = np.bincount(self.of, np.exp(log_rho) * fade[self.time], self.count)
            rest = np.append(np.cumsum(fade[::-1])[::-1], 0.0)[self.lengths]
            return (total + rest * np.exp(log_rho[self.ends])) / fade.sum()

    def going_on(self, log_rho: np.ndarray) -> np.ndarray:
        """(steps,) weighted share of the policy's episodes that no terminal has ended after each step; one where all weights
        are zero. An episode that is cut off counts as continuing."""
        log_rho, last = log_rho - self.log_uncensored, self.ends[self.ended]
        over = _accumulated((self.steps + 1,), (self.lengths[self.ended],), log_rho[last])[1:]
        goes, on = np.ones(len(log_rho), bool), np.full(self.steps, -np.inf)
        goes[last] = False
        np.logaddexp.at(on, self.time[goes], log_rho[goes])
        some = np.isfinite(np.maximum(on, over))
        return expit(np.subtract(on, over, out=np.full(self.steps, np.inf), where=some))

    def contributions(self, log_rho: np.ndarray, x: np.ndarray, *, whole: bool = False) -> np.ndarray:
        """(episodes,) terms of the estimate without normalisation; their mean is the estimate of `sums` or, if cut-offs are
        `even`, with one weight per episode that of `whole`."""
        log_rho = log_rho if whole else log_rho - self.log_uncensored
        with np.errstate(over="ignore"):
            rho = np.exp(np.repeat(log_rho[self.ends], self.lengths) if whole else log_rho)
        return np.bincount(self.of, rho * x * self.discount**self.time, self.count)

    def whole(self, log_rho: np.ndarray, x: np.ndarray, *, normalised: bool) -> Sums:
        """As `sums`, with one weight per episode, its last, for its discounted sum of `x`."""
        total = np.bincount(self.of, x * self.discount**self.time, self.count)
        last = log_rho[self.ends]
        top = last.max()
        with np.errstate(over="ignore"):
            rho = np.exp(last - (top if normalised and np.isfinite(top) else 0.0))
        numerators = np.bincount(self.group, rho * total, self.groups)[:, None]
        denominators = np.bincount(self.group, rho if normalised else np.ones(self.count), self.groups)[:, None]
        return Sums(numerators, denominators, float(effective_of_logs(last)))

    def warnings(
        self, names: tuple[str, ...], ess: np.ndarray, *, whole: bool = False, ahead: float = 0.0
    ) -> list[str]:
        """Reasons not to trust weighted sums of this log, one line each.

        Args:
            names: of the policies.
            ess: (policies,) effective sample sizes of the weights, in episodes.
            whole: each episode has one weight.
            ahead: share of the discounted time after episodes are cut off that is not counted (`OPEInput.cut_ahead`); 0 if it
                is estimated otherwise.
        """
        found = few(names, ess, self.count)
        cut = ~self.ended
        if whole and not self.even:
            found.append("episodes are cut off at different steps, which one weight per episode cannot take into account")
        if ahead > TAIL:
            found.append(
                f"{cut.sum():,} of {self.count:,} episodes are cut off, after {self.lengths[cut].mean():,.0f} steps on "
                f"average, where {100 * ahead:.0f} % of the discounted time remains and is not counted"
            )
        return found
