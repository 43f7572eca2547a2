"""Losses that are missing from a policy's rows by chance, in logs of single steps.

If rewards are equal except for rare losses, the few rows with the policy's actions may have no losses. Then no bootstrap sample
has one either: estimate and interval are those of a policy without losses. So this module computes the probability that this
many rows have none if losses do not depend on the action, and the lower end of the gain with as many losses as the log shows
that there may be.
"""

from typing import NamedTuple

import numpy as np
import scipy.special

from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.confounding import one_step
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.importance import counting, log_ratios
from deadreckon.ope.select import doubted, gains
from deadreckon.ope.support import Support
from deadreckon.stats import inference


def without_losses(case: OPEInput, found: Estimates, support: Support, model: BehaviorModel, alpha: float) -> list[str | None]:
    """For each policy a phrase if its gain may be due to losses missing from its rows; otherwise None.

    Args:
        case: log and policies, with the behaviour policy.
        found: the estimates that decide.
        support: of the policies in the log.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which one of the intervals may miss.
    """
    out: list[str | None] = [None] * len(case.policies)
    if found.ess is None or not one_step(case):
        return out
    rewards, every = np.asarray(case.data.rewards, np.float64), gains(found, alpha, doubted(found, support)[1])
    every = every[[name != LOGGED for name in found.names]]
    rows = counting(log_ratios(case, "auto", model, None)[: len(out)])
    for i in np.flatnonzero(~case.degenerate & (every[:, 1] > 0) & np.isfinite(every[:, 1])).tolist():
        least, low = rewards[rows[i]].min(), every[i, 1]
        lacks = lacking(case, np.maximum(least - rewards, 0.0), Basis.of(found, i).rest[0], alpha / len(out))
        if lacks.chance > alpha / 2 / len(out) and low <= lacks.most:
            out[i] = (
                f"none of its {lacks.rows:.0f} effective rows has a reward below {least:.4g}, but {lacks.share:.1%} of all "
                f"rows do; this happens by chance in {lacks.chance:.0%} of logs, and with as many of them as the log may have "
                f"its lower end would be {low - lacks.most:+.4g}"
            )
    return out


class Lacking(NamedTuple):
    """What the rows of a policy may lack by chance.

    Attributes:
        rows: how many effective rows it has.
        share: share of all rows that have something beyond what these have.
        chance: probability that so many rows have nothing of it if it does not depend on the action.
        most: upper confidence limit of the mean over all rows of what is beyond; 0 if the log has none of it, which then
            nobody can know.
    """

    rows: float
    share: float
    chance: float
    most: float


def lacking(case: OPEInput, beyond: np.ndarray, rows: float, alpha: float) -> Lacking:
    """What the rows of a policy may lack by chance.

    Args:
        case: a log of single steps.
        beyond: (rows,) by how much each row is beyond the rows of the policy, 0 if it is not.
        rows: how many effective rows the policy has.
        alpha: the limit is missed in half of this share of logs.
    """
    share, mean = float((beyond > 0).mean()), float(beyond.mean())
    units = int(case.cluster.max()) + 1
    influence = units * np.bincount(case.cluster, beyond - mean, units) / len(beyond)
    most = float(inference.student(np.array([mean]), influence[:, None], alpha)[1][0])
    if count := int((np.bincount(case.cluster, beyond, units) > 0).sum()):
        # Few events are not normal: Clopper and Pearson's limit of the share of clusters with one, of the size that they have.
        limit = scipy.special.betaincinv(count + 1, units - count, 1 - alpha / 2) if count < units else 1.0
        most = max(most, mean * units / count * float(limit))
    return Lacking(rows, share, (1.0 - share) ** rows, most)
