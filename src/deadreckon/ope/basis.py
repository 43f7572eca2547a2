"""The data that an estimate of one policy is based on, and whether it is enough for a valid interval.

If few episodes have most of the weight, an estimate says little about episodes that are not in the log. The requirements for an
estimate on all evaluated episodes also apply to an estimate on a part of them, such as a group.
"""

from typing import NamedTuple

import numpy as np

from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.importance import multiplied
from deadreckon.ope.pareto import diagnosed
from deadreckon.ope.support import SHORT
from deadreckon.ope.weights import FEW, effective_of_logs

UNITS = 20  # least number of episodes or clusters for a valid interval
HEAVY = 0.7  # Pareto k of the weights above which their mean is not reliable (Vehtari et al. 2024)
# Weights that are multiplied along an episode need an effective sample size of this share of the episodes, or of this number.
# With less, the episodes with the largest weights are probably not in the log, and no interval from the others is valid.
SHARE, MANY = 0.2, 50.0
ROUNDING = 1e-6  # rounding error of mean weights near one, if propensities are stored as float32
MORE = "record more episodes, or evaluate a policy closer to the behaviour policy"
ALONE = "if an action has no effect on later rows, read each row as an episode (--group in place of --episode)"


class Basis(NamedTuple):
    """The data that an estimate of one policy is based on.

    Attributes:
        units: number of episodes or clusters; None: not known.
        ess: effective sample size of its weights, in episodes; infinite if there are no weights.
        diagnostics: of the policy, by name; see `Estimates.diagnostics`.
    """

    units: int | None
    ess: float
    diagnostics: dict[str, float]

    @classmethod
    def of(cls, found: Estimates, which: int) -> "Basis":
        """The basis of one of the policies of an estimate."""
        units = found.units if found.influence is None else len(found.influence)
        told = {name: float(each[which]) for name, each in found.diagnostics.items()}
        return cls(units, np.inf if found.ess is None else float(found.ess[which]), told)

    @classmethod
    def of_weights(cls, case: OPEInput, log_ratios: np.ndarray, some: np.ndarray, *, whole: bool) -> "Basis":
        """The basis of a mean over a part of a case's evaluated episodes, weighted by one policy's ratios.

        Args:
            case: log and policies.
            log_ratios: (rows,) log of pi(a|s) / beta(a|s) of each logged action.
            some: (episodes,) bool, the part.
            whole: each episode has one weight, the product of all its ratios; otherwise each step has the product so far.
        """
        cluster = np.unique(case.cluster[some], return_inverse=True)[1]
        episodes = case.episodes_of(some)
        log_rho = episodes.cumulate(log_ratios[some[case.data.episode_of]])
        weights = episodes.typical(log_rho, whole=whole)
        with np.errstate(over="ignore", invalid="ignore"):
            if whole:
                average = np.exp(weights)
                ess = effective_of_logs(weights)
            else:
                average = episodes.average(log_rho)
                ess = episodes.sums(log_rho, np.zeros(len(log_rho)), normalised=False).ess
            told = {**multiplied(episodes, np.array([ess]), [average])}
        sums = np.full(int(cluster.max()) + 1, -np.inf)
        np.logaddexp.at(sums, cluster, weights)
        told |= diagnosed([sums]) | {"effective clusters": np.array([effective_of_logs(sums)])}
        return cls(len(sums), float(ess), {name: float(each[0]) for name, each in told.items()})

    @property
    def rest(self) -> tuple[float, str]:
        """The effective number of episodes or clusters, whichever is smaller, and a description; infinite without weights."""
        clusters = self.diagnostics.get("effective clusters", np.inf)
        return min(self.ess, clusters), f"{clusters:.1f} clusters" if clusters < self.ess else f"{self.ess:.1f} episodes"

    @property
    def overlaps(self) -> bool:
        """Whether there are no weights, or the weights are based on enough episodes and enough clusters."""
        return self.rest[0] >= FEW

    @property
    def lost(self) -> list[str]:
        """Reasons why the weights miss so much of a policy that no interval covers its value, one phrase each.

        In dm_control's cheetah-run and fish-swim, where weights are based on one episode, 4 of 13 such intervals covered it.
        """
        own, told = [], self.diagnostics
        more = f"{MORE}; {ALONE}" if "effective share" in told else MORE
        if not self.overlaps:
            own.append(f"its weights rest on {self.rest[1]}, {FEW:g} are needed; {more}")
        elif told.get("effective share", 1.0) < SHARE and self.ess < MANY:
            own.append(
                f"its weights, which are multiplied along an episode, rest on {self.ess:.1f} episodes, {MANY:g} or "
                f"{100 * SHARE:g} % of all are needed; {more}"
            )
        if told.get("mean weight high", 1.0) < 1.0 - ROUNDING:
            own.append(
                f"its weights average {told['mean weight']:.2f} instead of 1 (at most {told['mean weight high']:.2f} with "
                "99 % confidence): the log lacks the episodes with the largest weights"
            )
        if told.get("mass high", 1.0) < SHORT:
            own.append(
                f"its occupancy ratios amount to {told['mass']:.2f} instead of 1 (at most {told['mass high']:.2f} with 99 % "
                "confidence): the log does not cover the rest of its time"
            )
        return own

    @property
    def unreliable(self) -> list[str]:
        """Reasons why no interval of the estimate is valid, one phrase each."""
        own, told = [], self.diagnostics
        if self.units is not None and self.units < UNITS:
            own.append(
                f"there are only {self.units} episodes or clusters to evaluate on, {UNITS} are needed; use train --cross-fit "
                "if the log has that many"
            )
        own += self.lost
        # Weights that take few values are bounded, so their Pareto k means nothing: it counts only where the effective sample
        # size is small.
        if told.get("pareto k low", -np.inf) > HEAVY and self.rest[0] < MANY:
            k, low = told["pareto k"], told["pareto k low"]
            shape = f"Pareto k {k:.2f}, above {low:.2f} with 95 % confidence, at most {HEAVY:g}"
            own.append(f"its weights have too heavy a tail ({shape if k < np.inf else 'too heavy to fit a Pareto k'})")
        if told.get("settled", 1.0) < 1:
            own.append("the fit of its estimate has not converged")
        return own
