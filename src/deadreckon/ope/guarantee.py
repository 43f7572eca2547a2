"""A lower bound of a gain that holds for any number of episodes, not only for many.

With w the weight of a whole episode, G its return, which lies in [low, high], and gain = J(policy) - E[G],

    x = (w - 1) (G - low) + (high - low)

is never negative, because w is not and G - low is at most high - low; and its mean is at most gain + (high - low): weights have
mean one, or less where the log does not cover the policy's actions, and episodes that it does not cover return `low` or more.
So a lower bound of the mean of x by betting (`stats/betting.py`), less high - low, bounds the gain, without a bound of the
weights. Both returns come from the same episode, so their common variation cancels. It holds for all policies at once
(Bonferroni).

It assumes that propensities are those with which actions were sampled, that episodes are independent of each other and of the
policies, and that the range is known independently of the log.
"""

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.case import OPEInput
from deadreckon.settings import check_kind
from deadreckon.stats.betting import lower
from deadreckon.stats.interval import ALPHA

LARGEST = 300.0  # log of a weight; larger ones are cut, which can only lower the bound


def refuse(case: OPEInput, return_range: tuple[float, float] | None) -> None:
    """Refuses cases that do not meet the assumptions of a guarantee, or with a return outside the range.

    Raises:
        UserError: in one line.
    """
    check_kind("return_range", return_range, tuple[float, float] | None)
    episodes, lacks = case.episodes, []
    if return_range is None:
        lacks.append("the least and the greatest possible return of an episode (--return-range LOW HIGH)")
    elif not (np.isfinite(return_range).all() and return_range[0] < return_range[1]):
        lacks.append(f"a finite range of returns, least before greatest, instead of {return_range[0]:g} .. {return_range[1]:g}")
    if "behavior_log_probs" not in case.data.extras:
        lacks.append("logged propensities (column behavior_log_probs): learned ones may be wrong")
    if case.degenerate.any():
        lacks.append("policies with probabilities of their actions")
    if not episodes.ended.all():
        lacks.append(f"whole episodes: {(~episodes.ended).sum():,} are cut off; give a horizon that all of them reach")
    if case.clustered:
        lacks.append("independent episodes: episodes of one cluster are not independent")
    if case.cross_fitted.any():
        lacks.append(
            "policies that were trained on none of the evaluated episodes: those of a cross-fit were trained on each other's"
        )
    if lacks:
        raise UserError(f"a guarantee needs {'; and '.join(lacks)}")
    assert return_range is not None
    (low, high), returns = return_range, case.data.returns(case.discount)
    slack = 1e-6 * (high - low)  # returns are sums of rewards in single precision
    if returns.min() < low - slack or returns.max() > high + slack:
        beyond = float(returns.min() if returns.min() < low - slack else returns.max())
        raise UserError(f"an episode returns {beyond:.6g}, outside of the range {low:g} .. {high:g} that must hold for all")


def guaranteed(case: OPEInput, which: int, return_range: tuple[float, float] | None, alpha: float = ALPHA) -> float:
    """Lower bound of the gain of one of a case's policies, chosen among them by any rule.

    Args:
        case: log and policies.
        which: index of the policy.
        return_range: smallest and largest return of an episode, as defined by the estimand.
        alpha: probability that the bound of any of the policies fails.

    Raises:
        UserError: something is missing, or a return lies outside of the range.
    """
    refuse(case, return_range)
    assert return_range is not None
    low, high = return_range
    gained = np.clip(case.data.returns(case.discount) - low, 0.0, high - low)
    logs = case.log_densities[which] - np.asarray(case.data.extras["behavior_log_probs"], np.float64)
    weights = np.exp(np.minimum(case.episodes.cumulate(logs)[case.data.ends], LARGEST))
    return float(lower((weights - 1.0) * gained + (high - low), alpha / len(case.policies))) - (high - low)
