"""Metrics of estimates against true values (thesis E.1), and the risks of a choice based on them."""

import json
import math
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.errors import UserError
from deadreckon.randomness import check_seed
from deadreckon.stats.ranks import spearman, spearman_of_each

RESAMPLES = 1000  # of the policies
PUBLIC_CLIP = 2.0  # at which the public notebook clips normalised estimates, so that overestimates tie


class Measured(NamedTuple):
    """A metric on a set of policies, with its mean and spread over resampled sets (the bootstrap).

    Thesis E.2 prints `mean` ± `spread`; compare those with it. For `regret` the mean differs from the value: a resampled set
    often lacks the best policy, or the one that was chosen.

    Attributes:
        value: on the original set.
        mean, spread: mean and standard deviation over resampled sets.
    """

    value: float
    mean: float
    spread: float


@dataclass(frozen=True)
class Metrics:
    """Metrics of one estimator on one set of policies.

    Attributes:
        absolute_error: mean |estimate - truth| (E.1), on the requested scale.
        rank_correlation: Spearman's (E.3 on ranks).
        regret: of the best of the k policies with the highest estimates (E.2), on the same scale.
        k: of `regret`.
        count: policies.
    """

    absolute_error: Measured
    rank_correlation: Measured
    regret: Measured
    k: int
    count: int


def normalise(values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(x - worst) / (best - worst) by the true values (thesis 8.5).

    Raises:
        UserError: all true values are the same.
    """
    low, high = float(np.min(truth)), float(np.max(truth))
    if low == high:
        raise UserError("all policies have the same true value, so nothing can be normalised by their range")
    return (np.asarray(values, float) - low) / (high - low)


def absolute_error(estimates: np.ndarray, truth: np.ndarray) -> float:
    """Mean |estimate - truth| (E.1)."""
    return float(np.abs(np.asarray(estimates) - truth).mean())


def rank_correlation(estimates: np.ndarray, truth: np.ndarray) -> float:
    """Spearman's rank correlation; NaN where all estimates, or all true values, are the same."""
    if np.ptp(estimates) == 0 or np.ptp(truth) == 0:
        return float("nan")
    return spearman(estimates, truth)


def regret(estimates: np.ndarray, truth: np.ndarray, k: int = 1) -> float:
    """The best true value minus the best among the k policies with the highest estimates (E.2).

    For equal estimates it is the expected regret of choosing at random, the mean over all orders that k allows.
    """
    estimates, truth = np.asarray(estimates, float), np.asarray(truth, float)
    edge = np.sort(estimates)[::-1][k - 1]
    sure, tied = truth[estimates > edge], np.sort(truth[estimates == edge])
    free, floor = k - len(sure), max(sure, default=-np.inf)
    # The largest of `free` draws from n ties is the j-th smallest with probability C(j, free - 1) / C(n, free), j from 0.
    weights = np.array([math.comb(j, free - 1) for j in range(len(tied))]) / math.comb(len(tied), free)
    return max(0.0, float(truth.max() - weights @ np.maximum(tied, floor)))  # rounding could make it negative


def compare(
    estimates: np.ndarray,
    truth: np.ndarray,
    *,
    k: int = 1,
    normalised: bool = True,
    clip: float | None = None,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Metrics:
    """All three metrics, each with its mean and standard deviation over resampled policies (`Measured`).

    Args:
        estimates: (policies,).
        truth: (policies,).
        k: of the regret.
        normalised: on the scale where the worst policy is 0 and the best 1, by the whole set (thesis 8.5).
        clip: clip normalised estimates above this (the public notebook: `PUBLIC_CLIP`); None: no clipping.
        resamples: number of resampled sets of policies.
        seed: of the bootstrap.

    Raises:
        UserError: different numbers of true values and estimates, too few policies, or values that are not finite.
    """
    estimates, truth = np.asarray(estimates, float), np.asarray(truth, float)
    if estimates.shape != truth.shape or estimates.ndim != 1:
        raise UserError(f"as many true values as estimates are needed, got {truth.shape} and {estimates.shape}")
    if not 1 <= k <= len(truth) or len(truth) < 2:
        raise UserError(f"k must be 1 .. the number of policies, of which there are {len(truth)}, got {k}")
    if resamples < 1:
        raise UserError(f"resamples must be 1 or more, got {resamples}")
    check_seed(seed)
    for what, values in (("estimate", estimates), ("true value", truth)):
        if not np.isfinite(values).all():
            raise UserError(f"the {what} of policy {int(np.flatnonzero(~np.isfinite(values))[0])} is not finite")
    if normalised:
        estimates, truth = normalise(estimates, truth), normalise(truth, truth)
    if clip is not None:
        estimates = np.minimum(estimates, clip)
    draws = np.random.default_rng(seed).integers(0, len(truth), (resamples, len(truth)))
    # A resampled set that holds only one policy has no ranks.
    draws = draws[(draws != draws[:, :1]).any(1)]
    of_all = {"absolute_error": absolute_error, "rank_correlation": rank_correlation, "regret": partial(regret, k=k)}
    redrawn = {
        "absolute_error": np.abs(estimates - truth)[draws].mean(1),
        "rank_correlation": spearman_of_each(estimates[draws], truth[draws]),
        "regret": np.array([regret(estimates[d], truth[d], k) for d in draws]),
    }
    found = {name: Measured(of(estimates, truth), *_mean_and_spread(redrawn[name])) for name, of in of_all.items()}
    return Metrics(**found, k=k, count=len(truth))


def _mean_and_spread(values: np.ndarray) -> tuple[float, float]:
    kept = values[np.isfinite(values)]
    return (float(kept.mean()), float(kept.std())) if len(kept) else (float("nan"), float("nan"))


def sharpe_ratio(estimates: np.ndarray, truth: np.ndarray, behavior: float, k: int) -> float:
    """(best true value among the k with the highest estimates - the logged policy's) / their standard deviation.

    SharpeRatio@k (Kiyohara et al. 2024): the gain of trying these k, relative to its risk. NaN for a deviation of zero. Of
    equal estimates, those of the first policies count.
    """
    top = np.asarray(truth, float)[np.argsort(-np.asarray(estimates), kind="stable")[:k]]
    return float((top.max() - behavior) / top.std()) if top.std() > 0 else float("nan")


def error_rates(estimates: np.ndarray, truth: np.ndarray, threshold: float) -> tuple[float, float]:
    """Type I and type II error rates of deploying policies with estimates of at least `threshold`.

    Type I: of the policies truly below, the share that is deployed. Type II: of those truly at or above, the share that is
    not. NaN where there are none.
    """
    good, taken = np.asarray(truth) >= threshold, np.asarray(estimates) >= threshold
    first = float(taken[~good].mean()) if (~good).any() else float("nan")
    return first, float((~taken[good]).mean()) if good.any() else float("nan")


@lru_cache
def published() -> dict[str, Any]:
    """The six tables of thesis E.2: metric -> `d4rl` or `rl_unplugged` -> task -> method -> [mean, std] or None.

    Numbers that the scan does not show are None.
    """
    return json.loads((Path(__file__).parent / "published.json").read_text())


class PublishedReturn(NamedTuple):
    """The returns of one of DOPE's policies of dm_control's tasks.

    Attributes:
        agent: `D4PG`, `ABM`, `CRR` (with exponential weights) or `BC`.
        seed: of the training.
        updates: number of updates of the snapshot.
        mean, deviation: of undiscounted returns, as DOPE gives them.
    """

    agent: str
    seed: int
    updates: int
    mean: float
    deviation: float


@lru_cache
def published_returns() -> dict[str, tuple[PublishedReturn, ...]]:
    """Returns of DOPE's 861 policies of nine tasks of dm_control, by task. The policies themselves are not in the package."""
    found = json.loads((Path(__file__).parent / "published_policies.json").read_text())["policies"]
    return {
        task: tuple(PublishedReturn(agent, *row) for agent, rows in agents.items() for row in rows)
        for task, agents in found.items()
    }
