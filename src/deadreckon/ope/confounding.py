"""The possible effect of an unrecorded variable on gains, if it influenced both the logged actions and the rewards.

The marginal sensitivity model (`ope/sensitivity.py`) lets the odds of each logged action be off by a factor between 1 / Gamma
and Gamma. The logged return of an episode does not depend on this; the policy's does, within the box of weights. For one-step
episodes only the residual of a critic is uncertain, r - Q(s, a), with critics out of fold; for longer ones it is the return of
whole episodes, whose boxes grow with every step.

The bounds are estimates themselves. The threshold of the extreme weights is where the ratio of sums is extreme, so to first
order it adds no variance, and the influence of an episode on a bound is that of a ratio with these weights:

    baseline - mean(baseline) + w (y - ratio) / mean(w).
"""

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import WEIGHTLESS, OPEInput
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.importance import log_ratios, logged_probs
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.sensitivity import bounds, tipping, weight_box
from deadreckon.ope.sequences import totals
from deadreckon.stats import inference
from deadreckon.stats.interval import ALPHA


class Confounding:
    """Bounds of the gains of a case's policies under unmeasured confounding.

    Args:
        case: log and policies.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which one of the intervals may miss.
        wider: added at both ends; see `select.Choice`.

    Attributes:
        lost: for each policy the reasons why there is no bound, one phrase each: its weights are degenerate, or those of whole
            episodes are based on too few of them.

    Raises:
        UserError: degenerate weights of all policies, or episodes that are cut off at different steps.
    """

    def __init__(self, case: OPEInput, model: BehaviorModel, alpha: float = ALPHA, wider: float = 0.0):
        possible(case)
        self.case, self.alpha, self.wider, data = case, alpha, wider, case.data
        self.ratios = log_ratios(case, "auto", model, None)[: len(case.policies)]
        self.logged = logged_probs(case, "auto", model) if data.spec.discrete else None
        returns = data.returns(case.discount)
        if one_step(case):
            found = DoublyRobust(kind="dr", fqe=LinearFQE(), model=model).nuisances(case)[0]
            self.outcomes, self.baseline = found.errors, found.begins - returns
        else:
            self.outcomes, self.baseline = (np.broadcast_to(x, (case.count, len(returns))) for x in (returns, -returns))
        every, whole = range(len(case.policies)), np.ones(case.data.episodes, bool)
        self.lost = [
            ["its importance weights are degenerate, because it is deterministic with continuous actions"] if degenerate
            else Basis.of_weights(case, row, whole, whole=True).lost
            for row, degenerate in zip(self.ratios, case.degenerate)
        ]  # fmt: skip
        # Simultaneous, like the intervals of the gains: one factor for all policies, from their bounds without confounding.
        influence = np.stack([self._one(i, 1.0)[1][0] for i in every], 1)
        known = (influence.std(0) > 0) & [not lost for lost in self.lost]  # a lost policy must not widen those of others
        self.factor = inference.simultaneous(influence[:, known], alpha, case.seed)

    def gain(self, which: int, gamma: float) -> tuple[float, float]:
        """Ends of an interval of one policy's gain if odds are off by up to `gamma`: its bounds, widened by their error."""
        if self.lost[which]:
            return -np.inf, np.inf
        ends, influence = self._one(which, gamma)
        error = self.case.inflation[which] * inference.errors(influence.T) * self.factor
        return float(ends[0] - error[0] - self.wider), float(ends[1] + error[1] + self.wider)

    def tipping(self, which: int) -> float:
        """The largest Gamma at which the lower end stays above zero; NaN where it never is, infinite beyond
        `sensitivity.MOST`."""
        return tipping(lambda gamma: self.gain(which, gamma)[0])

    def _one(self, which: int, gamma: float) -> tuple[np.ndarray, np.ndarray]:
        """(2,) least and largest gain, and (2, units) their influence functions."""
        units, lengths = self.case.episodes.groups, self.case.data.lengths
        low, high = (totals(each, lengths) for each in weight_box(self.ratios[which], gamma, self.logged))
        top = high.max()
        if not np.isfinite(top):
            return np.array([-np.inf, np.inf]), np.zeros((2, units))
        y, base = self.outcomes[which], self.baseline[which]
        ends = np.array(bounds(y, low, high, base))
        small, large = np.exp(low - top), np.exp(high - top)
        pulls = []
        for ratio, below, above in zip(ends - base.mean(), (large, small), (small, large)):
            weight = np.where(y <= ratio, below, above)
            pull = base - base.mean() + weight * (y - ratio) / weight.mean()
            pulls.append(units * np.bincount(self.case.episodes.group, pull, units) / len(y))
        return ends, np.array(pulls)


def possible(case: OPEInput) -> None:
    """Refuses cases without bounds.

    Raises:
        UserError: degenerate weights of all policies, or episodes that are cut off at different steps.
    """
    if case.degenerate.all():
        raise UserError(f"bounds for confounding {WEIGHTLESS}")
    if not case.complete:
        raise UserError(f"{case.data.name}: bounds for confounding need whole episodes; give a horizon that all reach")


def one_step(case: OPEInput) -> bool:
    """Whether every episode has one step, which ends the task."""
    return bool(case.data.lengths.max() == 1 and case.episodes.ended.all())
