"""Losses that are missing from a policy's rows by chance, in logs of single steps.

If rewards are equal except for rare losses, the few rows with the policy's actions may have no losses. Then no bootstrap sample
has one either: estimate and interval are those of a policy without losses. So this module computes the probability that this
many rows have none if losses do not depend on the action, and the lower end of the gain with the log's share of losses.
"""

import numpy as np

from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.confounding import one_step
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.importance import counting, log_ratios
from deadreckon.ope.select import doubted, gains
from deadreckon.ope.support import Support


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
        least = rewards[rows[i]].min()
        share, shift = float((rewards < least).mean()), float(np.maximum(least - rewards, 0.0).mean())
        count, low = Basis.of(found, i).rest[0], every[i, 1]
        chance = (1.0 - share) ** count
        if chance > alpha / 2 / len(out) and low <= shift:
            out[i] = (
                f"none of its {count:.0f} effective rows has a reward below {least:.4g}, but {share:.1%} of all rows do; this "
                f"happens by chance in {chance:.0%} of logs, and with the log's share of such rewards its lower end would be "
                f"{low - shift:+.4g}"
            )
    return out
