"""Whether the log supports a policy: checks that do not use rewards.

Importance weights correct for the frequency of actions in the log, not for actions that were never taken: without support in
the log, the mean of the weights is below one, and the rewards of the missing actions are not in the log.
"""

from typing import NamedTuple

import numpy as np

from deadreckon.data.legal import legal_at
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.coverage import LEVEL, coverage
from deadreckon.ope.importance import learns, log_ratios
from deadreckon.stats import inference

RARE = 0.1  # share of the probability of a uniform choice below which an action has no support
MISSING = 0.10  # share of a policy's actions without support above which there is an objection
SHORT = 0.95  # least upper end of the interval of the mean weight of one step
LONG = 1.05  # mean weight of one step above which logged propensities are wrong


class Support(NamedTuple):
    """The support of the log for each policy; (policies,) without the behaviour policy, NaN if not known.

    Attributes:
        missing: share of the policy's actions, in states of the log, without logged support: discrete actions that the
            behaviour policy takes less than a tenth as often as a uniform choice would; continuous ones with a likelihood below
            that of 99 % of the log's own actions.
        ratio: mean weight of one step, pi(a|s) / beta(a|s) of the logged action, which is one where there is support.
        ratio_high: upper end of its one-sided 99 % interval.
        ratio_low: its lower end, if propensities were logged; above one, these are wrong; None: not known.
        degenerate: whether the weights are degenerate; see `Actor.degenerate`.
    """

    missing: np.ndarray
    ratio: np.ndarray
    ratio_high: np.ndarray
    degenerate: np.ndarray
    ratio_low: np.ndarray | None = None

    def objections(self, which: int) -> list[str]:
        """Reasons why the log does not support a policy, one phrase each."""
        found = []
        if self.missing[which] > MISSING:
            found.append(f"{100 * self.missing[which]:.0f} % of its actions have no support in the log")
        if self.ratio_high[which] < SHORT:
            found.append(
                f"its importance weights average {self.ratio[which]:.2f} per step instead of 1 (at most "
                f"{self.ratio_high[which]:.2f} with 99 % confidence): it takes actions that the log does not show, or "
                "propensities are wrong"
            )
        if self.ratio_low is not None and self.ratio_low[which] > LONG:
            found.append(
                f"its importance weights average {self.ratio[which]:.2f} per step instead of 1 (at least "
                f"{self.ratio_low[which]:.2f} with 99 % confidence): logged propensities are wrong"
            )
        return found


def support(case: OPEInput, model: BehaviorModel, folds: int = 5) -> Support:
    """Checks a case's policies; the models of the behaviour policy are those of its estimators.

    Args:
        case: log and policies.
        model: settings of the behaviour model.
        folds: number of parts of the evaluated episodes.
    """
    return case.once(("support", model, folds), lambda: _support(case, model, folds))


def _support(case: OPEInput, model: BehaviorModel, folds: int) -> Support:
    count, discrete = len(case.policies), case.data.spec.discrete
    nothing = np.full(count, np.nan)
    degenerate = case.degenerate
    if discrete:
        missing = missing_by_row(case, model, folds).mean(0)
    else:
        missing = 1.0 - (coverage(case, model) / LEVEL).clip(max=1.0)
    if degenerate.all():
        return Support(missing, nothing, nothing, degenerate)
    mean, low, high = mean_weights(log_ratios(case, "auto", model, None, folds)[:count], case.units[case.data.episode_of])
    blank = lambda x: np.where(degenerate, np.nan, x)  # noqa: E731
    return Support(missing, blank(mean), blank(high), degenerate, None if learns(case, "auto") else blank(low))


def missing_by_row(case: OPEInput, model: BehaviorModel, folds: int = 5) -> np.ndarray:
    """(rows, policies) share of each policy's actions at a row that have no support; for discrete actions."""
    chances = out_of_fold(case, model, folds).chances
    assert chances is not None
    legal = legal_at(case.data.observations, case.data.action_space)  # a uniform choice is one among these
    rare = chances < RARE / (chances.shape[1] if legal is None else legal.sum(1, keepdims=True))
    return (case.current_actions(1)[:, : len(case.policies)] * rare[:, None]).sum(-1).astype(float)


def mean_weights(log_ratios: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(policies,) mean weights of one step, and the lower and upper ends of their one-sided 99 % intervals.

    Args:
        log_ratios: (policies, rows) log of pi(a|s) / beta(a|s) of each logged action.
        unit: (rows,) number 0 .. n - 1 of the episode, cluster or group of clusters that each row belongs to.
    """
    ratios, units = np.exp(np.minimum(log_ratios, 50.0)), int(unit.max()) + 1
    rows, mean = np.bincount(unit, minlength=units), ratios.mean(1)
    totals = np.stack([np.bincount(unit, row, units) for row in ratios], 1)
    influence = units * (totals - mean * rows[:, None]) / len(unit)
    return mean, *inference.student(mean, influence, 2 * inference.SURE)
