"""The lower tail of a policy's return, by importance weights of whole episodes.

The conditional value at risk at a share alpha is the mean return of the worst alpha of episodes (Rockafellar and Uryasev 2002),

    CVaR = max over q of q - E[(q - G)+] / alpha,

where the alpha-quantile of G attains the maximum. The distribution of G under the policy is that of the log's episodes, each
with its weight over the sum of weights (Chandak et al. 2021; Huang, Leqi, Lipton and Azizzadenesheli 2021).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import WEIGHTLESS, OPEInput
from deadreckon.ope.importance import log_ratios
from deadreckon.ope.settings import check_share
from deadreckon.stats import inference
from deadreckon.stats.interval import ALPHA

FEW = 10.0  # least effective sample size of the tail's weights, in episodes


@dataclass(frozen=True)
class Tail:
    """The lower tail of one policy's return.

    Attributes:
        value: CVaR, in units of the return.
        quantile: the return that the worst share of episodes does not exceed.
        influence: (episodes,) influence function of the value; its mean is zero, and its variance over n is that of the value.
        ess: effective sample size of the weights of the tail, (sum w)^2 / sum w^2, in episodes.
    """

    value: float
    quantile: float
    influence: np.ndarray
    ess: float

    @property
    def error(self) -> float:
        """Standard error of the value."""
        return float(self.influence.std(ddof=1) / np.sqrt(len(self.influence)))


def lower_tail(log_weights: np.ndarray, returns: np.ndarray, share: float, least: float = FEW) -> Tail:
    """The mean return of the worst `share` of a policy's episodes.

    The influence of an episode is w (q - (q - G)+ / share - CVaR) over the mean weight: to first order the estimated quantile
    adds nothing, because it attains the maximum.

    Args:
        log_weights: (episodes,) logarithms of whole episodes' weights; minus infinity is a weight of zero.
        returns: (episodes,) discounted returns.
        share: alpha, above 0 and at most 1, where the value is the self-normalised mean.
        least: effective sample size of the tail, in episodes, below which there is no estimate.

    Raises:
        UserError: a share out of range, no weight at all, or a tail of too few episodes.
    """
    check_share(share)
    logs, returns = np.asarray(log_weights, float), np.asarray(returns, float)
    top = logs.max(initial=-np.inf)
    if not np.isfinite(top):
        raise UserError("no episode has a weight: each has an action that the policy never takes")
    weights = np.exp(logs - top)
    weights /= weights.mean()
    order = np.argsort(returns, kind="stable")
    total = np.cumsum(weights[order])
    # Rounding must not move a quantile that falls on an edge to the next return.
    last = min(int(np.searchsorted(total, share * total[-1] * (1 - 1e-12))), len(order) - 1)
    quantile = float(returns[order[last]])
    # Of the episodes at the quantile, which may be many, the tail has as much as fills the share.
    below, at = weights[returns < quantile], weights[returns == quantile]
    left = np.clip((share * total[-1] - below.sum()) / at.sum(), 0.0, 1.0)
    ess = float((share * total[-1]) ** 2 / (np.square(below).sum() + left * np.square(at).sum()))
    if ess < least:
        raise UserError(
            f"the worst {100 * share:g} % of episodes rest on {ess:.1f} of {len(returns):,} in the log, fewer than the "
            f"{least:g} that an estimate needs; use a larger share or more episodes"
        )
    each = quantile - np.maximum(quantile - returns, 0.0) / share
    value = float((weights * each).mean())
    return Tail(value, quantile, weights * (each - value), ess)


def tails(
    case: OPEInput, which: int, share: float, model: BehaviorModel, alpha: float = ALPHA, wider: float = 0.0
) -> dict[str, Any]:
    """The lower tail of one of a case's policies, chosen among them by any rule, beside that of the behaviour policy, as JSON
    values.

    The interval of the difference is Student's, of influences that are paired unit by unit.

    Args:
        case: log and policies.
        which: index of the policy.
        share: share of the worst episodes.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which the interval of any of the policies may miss.
        wider: added at both ends; see `select.Choice`.

    Raises:
        UserError: weights of whole episodes cannot estimate it.
    """
    if case.degenerate[which]:
        raise UserError(f"tails {WEIGHTLESS}")
    if not case.complete:
        raise UserError(f"{case.data.name}: tails need whole episodes; give a horizon that all of them reach")
    episodes, returns = case.episodes, case.data.returns(case.discount)
    row = log_ratios(case, "auto", model, None)[which]
    if lost := Basis.of_weights(case, row, np.ones(episodes.count, bool), whole=True).lost:
        raise UserError(f"by whole episodes {'; '.join(lost)}")
    weights = episodes.cumulate(row)[case.data.ends]
    own, logged = lower_tail(weights, returns, share), lower_tail(np.zeros(len(returns)), returns, share)
    gain, pulls = own.value - logged.value, episodes.means(own.influence - logged.influence)[1]
    low, high = inference.student(np.array([gain]), case.inflation[which] * pulls[:, None], alpha / len(case.policies))
    return {"share": share, "value": own.value, "logged": logged.value, "gain": gain, "low": float(low[0]) - wider,
            "high": float(high[0]) + wider, "effective": own.ess}  # fmt: skip
