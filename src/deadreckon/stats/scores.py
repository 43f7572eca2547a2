"""Statistics of tables of scores: aggregates, intervals, probabilities of improvement and performance profiles.

Aggregates, the stratified bootstrap, the probability of improvement and performance profiles are those of Agarwal et al.
(2021), "Deep RL at the Edge of the Statistical Precipice" (rliable). All of them describe the distribution of a method's runs
on these tasks; none generalises to other tasks.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deadreckon.errors import UserError
from deadreckon.stats.bootstrap import resample_counts
from deadreckon.stats.by_task import Scores, by_task, check_level, numbers, pairs_of
from deadreckon.stats.interval import LEVEL, Interval

RESAMPLES = 5000  # limits of a 95 % interval then have errors of about 1 % of its width

# From one (..., seeds) array per task to a number, or a (...) array of numbers.
Statistic = Callable[[list[np.ndarray]], Any]


@dataclass(frozen=True)
class Profile:
    """The share of runs above each threshold, (thresholds,) each, with limits that hold for one threshold at a time."""

    thresholds: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray


def _generator(level: float, resamples: int, seed: int) -> np.random.Generator:
    check_level(level)
    if resamples < 1:
        raise UserError(f"resamples must be >= 1, got {resamples}")
    if seed < 0:
        raise UserError(f"seed must be >= 0, got {seed}")
    return np.random.default_rng(seed)


def _limits(values: np.ndarray, level: float) -> tuple[Any, Any]:
    """Percentiles over (resamples, ...)."""
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


def iqm(scores: Scores) -> Any:
    """Interquartile mean: of all runs of all tasks pooled, without the lowest and the highest quarter.

    The quarters are rounded down, as in rliable, so three runs or fewer give the plain mean. Every run counts alike, and so a
    task with more runs counts for more. Of (..., seeds) arrays it gives a (...) array, as `median`, `mean` and
    `optimality_gap` do.
    """
    runs = np.concatenate(list(by_task(scores, stacked=True).values()), axis=-1)
    n = runs.shape[-1]
    cut = n // 4
    return np.partition(runs, (cut, n - cut - 1), axis=-1)[..., cut : n - cut].mean(-1)


def mean(scores: Scores) -> Any:
    """Mean over tasks of each task's mean, so that every task counts alike."""
    return np.mean(_means(scores), axis=0)


def median(scores: Scores) -> Any:
    """Median over tasks of each task's mean."""
    return np.median(_means(scores), axis=0)


def optimality_gap(scores: Scores, target: float) -> Any:
    """Mean over tasks of the mean over runs of how far a run falls short of `target`, 0 for runs beyond it.

    Raises:
        UserError: a target that is not finite, or what `by_task` raises.
    """
    if not math.isfinite(target):
        raise UserError(f"target must be a finite score, got {target}")
    return np.mean([np.maximum(target - x, 0.0).mean(-1) for x in by_task(scores, stacked=True).values()], axis=0)


def _means(scores: Scores) -> np.ndarray:
    """(tasks, ...)."""
    return np.stack([x.mean(-1) for x in by_task(scores, stacked=True).values()])


def interval(
    scores: Scores, statistic: Statistic = iqm, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """A statistic with its percentile bootstrap interval, stratified: runs are resampled within each task.

    Few seeds make it too narrow, because resampled means of n runs have only sqrt((n - 1) / n) of the standard deviation that
    they should have. With 3 seeds per task, the 95 % interval of a mean covers the true value in no more than 89 % of cases
    however many tasks there are (5 seeds: 92 %, 10: 94 %), and for one task alone it is from the worst run to the best, which
    include the centre of a symmetric distribution in 75 %. So with 3 seeds, intervals that just do not overlap do not show that
    methods are different; use `comparison.paired`, whose t limits are wider for that reason. A task of a single run would add
    no width although it varies, so one such task makes the limits NaN.

    Args:
        scores: of one method.
        statistic: of one (..., seeds) array a task, reducing the last axis, such as `partial(optimality_gap, target=100)`.
        level: share of cases in which the interval is meant to cover the true value.
        resamples: number of bootstrap samples.
        seed: of the bootstrap.

    Raises:
        UserError: no task, no run, numbers that are not finite, or a statistic that does not reduce the last axis.
    """
    rng, tasks = _generator(level, resamples, seed), list(by_task(scores).values())
    value = float(statistic(tasks))
    if min(map(len, tasks)) < 2:
        return Interval(value, math.nan, math.nan)
    redrawn = np.asarray(statistic([x[rng.integers(0, len(x), (resamples, len(x)))] for x in tasks]))
    if redrawn.shape != (resamples,):
        raise UserError(f"statistic must reduce the last axis only: of (resamples, seeds) arrays it gave shape {redrawn.shape}")
    low, high = _limits(redrawn, level)
    return Interval(value, float(low), float(high))


def probability_of_improvement(
    ours: Scores, theirs: Scores, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """Mean over tasks of P(X > Y) + P(X = Y) / 2 for a run X of ours and a run Y of theirs, with its bootstrap interval.

    By task it is the Mann-Whitney statistic over the number of pairs of runs. Runs of both methods are resampled within tasks,
    independently. If every run of ours is better than every run of theirs, so is every bootstrap sample: [1, 1] then means that
    no overlap was observed, not that there is none. Limits are NaN if a task has a single run of either, as in `interval`.

    Raises:
        UserError: different tasks, or what `interval` raises.
    """
    rng, pairs = _generator(level, resamples, seed), pairs_of(ours, theirs)
    total, redrawn = 0.0, np.zeros(resamples)
    for _, x, y in pairs:
        wins = (x[:, None] > y) + (x[:, None] == y) / 2
        total += float(wins.mean())
        of_x, of_y = (resample_counts(rng, len(each), resamples) for each in (x, y))
        redrawn += ((of_x @ wins) * of_y).sum(-1) / wins.size
    value = total / len(pairs)
    if min(min(len(x), len(y)) for _, x, y in pairs) < 2:
        return Interval(value, math.nan, math.nan)
    low, high = _limits(redrawn / len(pairs), level)
    return Interval(value, float(low), float(high))


def performance_profile(
    scores: Scores, thresholds: ArrayLike, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Profile:
    """The share of runs that score above each threshold, every task counting alike, with a bootstrap band.

    The band is stratified and too narrow for few seeds, see `interval`, and holds for each threshold separately, not for the
    whole curve. Where no run or every run is above, it has no width. It is NaN if a task has a single run.

    Args:
        scores: of one method.
        thresholds: (thresholds,) on the scale of the scores.
        level: of the band.
        resamples: number of bootstrap samples.
        seed: of the bootstrap.

    Raises:
        UserError: thresholds that are not a list of finite numbers, or what `interval` raises.
    """
    rng, tasks = _generator(level, resamples, seed), list(by_task(scores).values())
    cuts = numbers(thresholds, "thresholds", False)
    share, redrawn = np.zeros(cuts.size), np.zeros((resamples, cuts.size))
    for x in tasks:
        above = (x[:, None] > cuts).astype(np.float64)
        share += above.mean(0)
        redrawn += resample_counts(rng, len(x), resamples) @ above / len(x)
    share, redrawn = share / len(tasks), redrawn / len(tasks)
    if min(map(len, tasks)) < 2:
        return Profile(cuts, share, np.full(cuts.size, np.nan), np.full(cuts.size, np.nan))
    return Profile(cuts, share, *_limits(redrawn, level))
