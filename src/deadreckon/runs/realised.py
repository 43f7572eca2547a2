"""The realised value of a policy against its estimate, with an interval that is valid after every episode.

The interval is a confidence sequence (`stats.confidence_sequence`) of the returns of finished episodes, in the order of time,
or of means of successive ones if returns of the reference depend on those before (`stats.serial`). It needs a range that
contains all returns, which does not depend on the new log: as given, or that of the returns in the reference, widened on each
side by half of its width unless these take few different values, such as 0 and 1. If an estimate lies above the range, the
range is extended, as no return within it could support such an estimate. A return outside the range makes the end of the
interval that is based on it infinite from then on, and is reported.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit

from deadreckon.data.dataset import Dataset
from deadreckon.data.neighbours import in_order
from deadreckon.data.split import group_of, units_of
from deadreckon.errors import UserError
from deadreckon.ope.estimand import TAIL, Estimand, discounted_steps
from deadreckon.stats import serial
from deadreckon.stats.confidence_sequence import ConfidenceSequence, confidence_sequence, refuted_at
from deadreckon.stats.interval import ALPHA, Interval

FEW = 10  # most different returns of the reference with which its range is not widened
WIDER = 0.5  # share of the range of returns by which it is widened on each side
ROUNDING = 1e-6  # share of that range by which sums of rewards in single precision may lie outside


@dataclass(frozen=True)
class Realised:
    """The value that a policy realised.

    Attributes:
        estimand: of the returns.
        sequence: the realised mean and its ends, after growing numbers of episodes; all hold simultaneously.
        estimated: the estimate, with an interval that holds simultaneously for all policies among which it may have been
            chosen; None if no estimates are known.
        among: number of these policies.
        range: of the returns, on which the interval is based.
        source: a description of the range's origin.
        beyond: episodes whose return lies outside it.
        length: number of successive episodes whose mean is a sample; more than one if returns depend on those before.
        below_at: number of episodes after which the mean was significantly below the lower end of the estimate; None if it is
            not.
    """

    estimand: Estimand
    sequence: ConfidenceSequence
    estimated: Interval | None
    range: tuple[float, float]
    source: str
    beyond: int
    below_at: int | None
    among: int = 1
    length: int = 1

    @property
    def interval(self) -> Interval:
        """The realised mean after all episodes, or all whole parts of `length` of them, with its ends."""
        return Interval(*(float(ends[-1]) for ends in (self.sequence.means, self.sequence.low, self.sequence.high)))


def finished(log: Dataset, like: Dataset) -> Dataset:
    """A log without its last episode if that may be unfinished: it has no terminal and is shorter than the longest in `like`.

    Raises:
        UserError: no episode is finished.
    """
    if log.terminals[-1] or log.lengths[-1] >= like.lengths.max():
        return log
    if log.episodes == 1:
        raise UserError(f"{log.name}: its only episode may not be finished, since it ends without a terminal")
    return log.select(np.arange(log.episodes - 1))


def returns_of(log: Dataset, estimand: Estimand) -> np.ndarray:
    """(episodes,) returns as the estimand defines them."""
    time = np.arange(len(log)) - np.repeat(log.starts, log.lengths)
    counted = np.ones(len(log), bool) if estimand.horizon is None else time < estimand.horizon
    weights = np.where(counted, np.power(estimand.discount, time), 0.0)
    return np.add.reduceat(weights * np.asarray(log.rewards, np.float64), log.starts)


def _cut(log: Dataset, estimand: Estimand) -> np.ndarray:
    """(n,) lengths of the episodes that a timeout cuts off."""
    cut = log.lengths[~np.asarray(log.terminals)[log.ends]]
    return cut if estimand.horizon is None else cut[cut < estimand.horizon]


def unseen(log: Dataset, estimand: Estimand) -> float:
    """The largest share of the discounted time of an episode that lies beyond a timeout, and so is not in the log."""
    cut = _cut(log, estimand)
    if not len(cut):
        return 0.0
    if estimand.horizon is None:
        return float(estimand.discount ** cut.min())
    return 1.0 - discounted_steps(estimand.discount, float(cut.min())) / discounted_steps(estimand.discount, estimand.horizon)


def realised(
    new: Dataset, old: Dataset, told: tuple[dict[str, Any], int] | None, given: tuple[float, float] | None, alpha: float
) -> Realised | str:
    """The realised value of a new log against the estimate, or the reason why they cannot be compared.

    Args:
        new: the new log, of finished episodes in the order of time.
        old: the reference.
        told: the estimates, and the policy's index there; None: only the mean of returns is shown.
        given: the range of returns; None: that of the reference, see the docstring of the module.
        alpha: probability that the policy's value is ever reported as below the estimate without being so; each end of the
            interval has this level.

    Raises:
        UserError: an invalid range.
    """
    estimand = Estimand(1.0)
    if told is not None:
        estimand = Estimand(**{key: told[0]["estimand"][key] for key in ("discount", "horizon", "greedy")})
    if told is not None and (share := max(before := unseen(old, estimand), unseen(new, estimand))) > TAIL:
        beyond = f"the estimate includes rewards after timeouts ({100 * share:.0f} % of the discounted time)"
        how = "estimate with a horizon (`deadreckon ope --horizon`)"
        if before <= TAIL:  # parallel episodes, of which several may be unfinished
            cut = _cut(new, estimand)
            those = f"{len(cut):,} of {new.episodes:,} episodes of {new.name} end without a terminal"
            those = f"{those}, after {cut.min():,} steps or more"
            how = f"{those}: if these are not finished, give only the episodes that started before the first of them"
        return f"not compared: {beyond}, which a log does not show; {how}"
    if (units := len(np.unique(units_of(new)))) < new.episodes:
        group = group_of(new)
        of = f"come from {units:,} values of {group}" if group else f"are copies of {units:,} different ones"
        those = f"the {new.episodes:,} episodes {of}"
        return f"not compared: {those}, and the interval needs independent ones; give one episode of each"
    if given is not None and not (np.isfinite(given).all() and given[0] < given[1]):
        raise UserError(f"return_range must be least and greatest return of an episode, got {given[0]:g} .. {given[1]:g}")
    x, source = returns_of(new, estimand), "as given"
    estimated, least, among = None, -np.inf, 1
    if told is not None:
        first, i, among = told[0]["results"][0], told[1], len(told[0]["policies"])
        value, low, high = (first[key][i] for key in ("value", "low", "high"))
        # Intervals hold for each policy separately, and the estimate of a policy that was chosen among several is biased
        # upwards. With few clusters, the factor of Student's quantiles is larger than that of a normal distribution's.
        freedom = max(told[0].get("judged", {}).get("units", np.inf) - 1, 1)
        more = float(stdtrit(freedom, 1 - ALPHA / (2 * among)) / stdtrit(freedom, 1 - ALPHA / 2))
        estimated = Interval(value, value - more * (value - low), value + more * (high - value))
        least = estimated.low if np.isfinite(estimated.low) else -np.inf
    if given is None:
        before = returns_of(old, estimand)
        low, high = float(before.min()), float(before.max())
        source = f"that of {old.name}"
        if low == high or len(np.unique(before)) > FEW:
            room = WIDER * (high - low) or max(abs(high), 1.0)
            source = f"{source}, {low:.4g} .. {high:.4g}, and half of its width on each side"
            low, high = low - room, high + room
        if least >= high:
            source, high = f"{source}, and up to the estimate", least + WIDER * (high - low)
        given = low, high
    edge = np.clip(x, *given)
    x = np.where(np.abs(x - edge) <= ROUNDING * (given[1] - given[0]), edge, x)
    outside = int(((x < given[0]) | (x > given[1])).sum())
    length = _together(old, estimand)
    if not (parts := _means(x, length, given)).size:
        together = f"returns depend on those of the episodes before, so means of {length:,} episodes are compared"
        return f"not compared: {together}, of which the new log has none"
    sequence = confidence_sequence(parts, given, 2 * alpha)
    below = refuted_at(parts, given, least, alpha) if np.isfinite(least) else None
    return Realised(
        estimand, sequence._replace(counts=sequence.counts * length), estimated, given, source, outside,
        None if below is None else below * length, among, length,
    )  # fmt: skip


def _together(old: Dataset, estimand: Estimand) -> int:
    """The number of successive episodes whose mean is one sample: more than one if returns of the reference depend on those of
    the episodes before, as the confidence sequence needs samples that do not. A change of level is no such dependence."""
    if (episodes := in_order(old)) is None or len(episodes) < serial.LEAST:
        return 1
    returns = returns_of(old, estimand)[episodes]
    return serial.together(returns) if serial.follows(returns, serial.ERRORS) else 1


def _means(x: np.ndarray, length: int, given: tuple[float, float]) -> np.ndarray:
    """(parts,) means of so many successive returns; one of a part that has returns beyond the range is beyond it, too."""
    parts = x[: len(x) // length * length].reshape(-1, length)
    low, high = parts.min(1, initial=np.inf), parts.max(1, initial=-np.inf)
    return np.where(high > given[1], high, np.where(low < given[0], low, parts.mean(1)))
