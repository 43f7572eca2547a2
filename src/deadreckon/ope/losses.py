"""Rewards that are missing from a policy's rows by chance, in single steps, and in rows or the whole of longer episodes.

If rewards are equal except for rare losses, the few rows with the policy's actions may have no losses. Then no bootstrap sample
has one either: estimate and interval are those of a policy without losses. So this module computes the probability that this
many rows have none if losses do not depend on the action, and the lower end of the gain with as many losses as the log shows
that there may be.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.special

from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.confounding import one_step
from deadreckon.ope.estimand import discounted_steps
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.importance import counting, log_ratios
from deadreckon.ope.select import doubted, gains
from deadreckon.ope.support import Support
from deadreckon.ope.weights import effective
from deadreckon.stats import inference
from deadreckon.stats.interval import ALPHA


def without_losses(
    case: OPEInput, found: Estimates, support: Support, model: BehaviorModel, alpha: float, ratios: np.ndarray | None = None
) -> list[str | None]:
    """For each policy a phrase if its gain may be due to losses missing from its rows; otherwise None.

    Args:
        case: log and policies, with the behaviour policy.
        found: the estimates that decide.
        support: of the policies in the log.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which one of the intervals may miss.
        ratios: (policies, rows) ratios of occupancies, if these are the weights of the estimates.
    """
    if ratios is not None:
        return _without_losses_in_rows(case, found, support, ratios, alpha)
    out: list[str | None] = [None] * len(case.policies)
    single = found.ess is not None and one_step(case)
    # Of longer episodes it counts where estimates rest on products of weights and the log shows each return as a whole.
    if not single and ("effective share" not in found.diagnostics or case.data.successors is not None or not case.complete):
        return out
    unit, what = ("rows", "reward") if single else ("episodes", "return")
    returns, every = case.data.returns(case.discount), gains(found, alpha, doubted(found, support)[1])
    every = every[[name != LOGGED for name in found.names]]
    rows, bases = _own(case, model)
    open_to = ~case.degenerate & (every[:, 1] > 0) & np.isfinite(every[:, 1]) & rows.any(1)
    for i in np.flatnonzero(open_to).tolist():
        least, low = returns[rows[i]].min(), every[i, 1]
        count = Basis.of(found, i).rest[0] if single else bases[i]
        lacks = lacking(case, np.maximum(least - returns, 0.0), count, alpha / len(out))
        if lacks.chance > alpha / 2 / len(out) and low <= lacks.most:
            out[i] = _words(count, unit, what, least, lacks, low - lacks.most)
    return out


def _without_losses_in_rows(
    case: OPEInput, found: Estimates, support: Support, ratios: np.ndarray, alpha: float
) -> list[str | None]:
    """The same where ratios of occupancies weight the rows of longer episodes: rewards of rows may be missing."""
    out: list[str | None] = [None] * len(case.policies)
    rewards, every = np.asarray(case.data.rewards, np.float64), gains(found, alpha, doubted(found, support)[1])
    every = every[[name != LOGGED for name in found.names]]
    steps = case.effective_horizon
    if np.asarray(case.data.terminals)[case.data.ends].all():  # also where the horizon ends them
        steps = float(np.mean([discounted_steps(case.discount, length) for length in case.data.lengths]))
    for i in np.flatnonzero((every[:, 1] > 0) & np.isfinite(every[:, 1])).tolist():
        weights = np.maximum(ratios[i], 0.0)
        with np.errstate(divide="ignore"):
            rows = counting(np.log(weights)[None])[0]
        if not rows.any():
            continue
        least, low, count = rewards[rows].min(), every[i, 1], float(effective(weights[None])[0])
        lacks = lacking(case, np.maximum(least - rewards, 0.0), count, alpha / len(out))
        # Losses may come in rows or in whole clusters, of which there are fewer: the greater chance counts.
        hit = float((np.bincount(case.cluster[case.data.episode_of], rewards < least) > 0).mean())
        lacks = lacks._replace(chance=max(lacks.chance, (1.0 - hit) ** Basis.of(found, i).rest[0]))
        if lacks.chance > alpha / 2 / len(out) and low <= steps * lacks.most:
            out[i] = _words(count, "rows", "reward", least, lacks, low - steps * lacks.most)
    return out


def _words(count: float, unit: str, what: str, least: float, lacks: "Lacking", low: float) -> str:
    """The objection, with the lower end that the gain would have."""
    return (
        f"none of its {count:.0f} effective {unit} has a {what} below {least:.4g}, but {lacks.share:.1%} of all {unit} do; "
        f"this happens by chance in {lacks.chance:.0%} of logs, and with as many of them as the log may have its lower end "
        f"would be {low:+.4g}"
    )


def with_rare_rewards(case: OPEInput, found: Estimates, model: BehaviorModel) -> Estimates:
    """An estimate whose intervals allow for rewards that a policy's rows lack by chance, in logs of single steps.

    What none of n rows has may have the probability 1 - (alpha / 2)^(1 / n) (the exact limit of Clopper and Pearson 1934). The
    ends reach at least as far as if, with this probability, the smallest of the policy's rewards were the smallest of the log,
    and likewise the largest. That matters if rewards take few values, such as successes all of whose rows succeed; otherwise
    the intervals reach further by themselves.

    Args:
        case: log and policies, with or without the behaviour policy.
        found: an estimate of these.
        model: settings of the behaviour model, if propensities were not logged.
    """
    if found.ess is None or not one_step(case):
        return found
    rewards, low, high = np.asarray(case.data.rewards, np.float64), found.low.copy(), found.high.copy()
    rows, _ = _own(case, model)
    for i in np.flatnonzero(~case.degenerate & (found.ess[: len(case.policies)] > 0) & rows.any(1)).tolist():
        share = 1.0 - (ALPHA / 2) ** (1.0 / Basis.of(found, i).rest[0])
        own = rewards[rows[i]]
        low[i] = min(low[i], found.value[i] - share * (own.min() - rewards.min()))
        high[i] = max(high[i], found.value[i] + share * (rewards.max() - own.max()))
    return replace(found, low=low, high=high)


def _own(case: OPEInput, model: BehaviorModel) -> tuple[np.ndarray, np.ndarray]:
    """(policies, episodes) bool, which episodes count for each policy by their weights as a whole, and (policies,) how many
    effective episodes or clusters these are; made once."""

    def make() -> tuple[np.ndarray, np.ndarray]:
        ratios, every = log_ratios(case, "auto", model, None)[: len(case.policies)], np.ones(case.data.episodes, bool)
        rows = counting(np.stack([case.episodes.cumulate(own)[case.data.ends] for own in ratios]))
        return rows, np.array([Basis.of_weights(case, own, every, whole=True).rest[0] for own in ratios])

    return case.once(("episodes of each policy", model), make)


class Lacking(NamedTuple):
    """What the rows of a policy may lack by chance.

    Attributes:
        share: share of all rows that have something beyond what these have.
        chance: probability that as many rows have nothing of it if it does not depend on the action.
        most: upper confidence limit of the mean over all rows of what is beyond; 0 if the log has none of it, which then
            nobody can know.
    """

    share: float
    chance: float
    most: float


def lacking(case: OPEInput, beyond: np.ndarray, rows: float, alpha: float) -> Lacking:
    """What the rows of a policy may lack by chance.

    Args:
        case: log and policies.
        beyond: (episodes,) or (rows,) by how much each is beyond those of the policy, 0 if it is not.
        rows: how many effective rows the policy has.
        alpha: the limit is missed in half of this share of logs.
    """
    share, mean = float((beyond > 0).mean()), float(beyond.mean())
    cluster = case.cluster if len(beyond) == len(case.cluster) else case.cluster[case.data.episode_of]
    units = int(cluster.max()) + 1
    influence = units * np.bincount(cluster, beyond - mean, units) / len(beyond)
    most = float(inference.student(np.array([mean]), influence[:, None], alpha)[1][0])
    if count := int((np.bincount(cluster, beyond, units) > 0).sum()):
        # Few events are not normal: Clopper and Pearson's limit of the share of clusters with one, of the size that they have.
        limit = scipy.special.betaincinv(count + 1, units - count, 1 - alpha / 2) if count < units else 1.0
        most = max(most, mean * units / count * float(limit))
    return Lacking(share, (1.0 - share) ** rows, most)
