"""The result of every estimator."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.ope.estimand import TAIL, Estimand
from deadreckon.provided import Shown
from deadreckon.stats import inference
from deadreckon.stats.bootstrap import ensemble_interval
from deadreckon.stats.interval import PERCENT, decimals, fixed

if TYPE_CHECKING:
    from deadreckon.ope.case import OPEInput

LOGGED = "behaviour policy"  # the name of the policy that recorded the log
LEAST_ESS = 2.0  # effective episodes, or clusters, from which on there is a spread: of normalised weights one has none


@dataclass(frozen=True)
class Estimates(Shown):
    """The estimates of an estimator for each policy.

    Attributes:
        method: the estimator.
        names: of the policies.
        value: (policies,) expected discounted return of an episode.
        low, high: (policies,) ends of intervals at `stats.interval.LEVEL`; NaN if the method gives none.
        estimand: what is estimated.
        bootstrap: (n_bootstrap, policies) estimates of bootstrap samples of the log, or of the members of an ensemble; the same
            samples for all policies, so that differences between policies have intervals. None if there are none.
        influence: (units, policies) influence function of the estimates at each unit of the log (`OPEInput.units`: episodes,
            clusters or groups of them), which has mean zero; the sum of its squares over units^2 is the variance of the
            estimate. The same units for all policies and methods of a case, so that gains are paired. None if there is none.
        ess: (policies,) effective sample size of the weights, (sum w)^2 / sum w^2 in episodes; None without weights.
        corrected: whether logged rewards, weighted by the policy's probability of the logged actions, correct the estimate.
            Otherwise it is model-based: nothing corrects an error of the fitted model. For single policies: `corrects`.
        warnings: reasons not to trust it, one line each.
        seconds: the time it took, without computations shared with earlier estimators.
        diagnostics: further numbers about the estimate by name, each (policies,); the checks of a decision read them.
        nuisance: (groups, policies) error of fitted models that the influence function does not include, by the groups of the
            data from which it is estimated: the sum of the squares is its variance, with groups - 1 degrees of freedom, and it
            is paired between policies. NaN if it is not known; None if there is none.
        inflation: (policies,) factors of the errors, beyond the influence function; None: one. See `OPEInput.inflation`.
        units: number of units of the log (`OPEInput.units`) that it is based on; set by `Estimator.on`.
    """

    method: str
    names: tuple[str, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    estimand: Estimand
    bootstrap: np.ndarray | None = field(default=None, repr=False)
    influence: np.ndarray | None = field(default=None, repr=False)
    ess: np.ndarray | None = None
    corrected: bool = False
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    diagnostics: dict[str, np.ndarray] = field(default_factory=dict, repr=False)
    inflation: np.ndarray | None = field(default=None, repr=False)
    nuisance: np.ndarray | None = field(default=None, repr=False)
    units: int | None = None

    @classmethod
    def of_influence(
        cls,
        method: str,
        case: "OPEInput",
        value: np.ndarray,
        influence: np.ndarray,
        *,
        ess: np.ndarray | None = None,
        nuisance: np.ndarray | None = None,
        **more: Any,
    ) -> "Estimates":
        """Estimates of (policies,) values with (units, policies) influence functions, and intervals by them and by `nuisance`,
        for each policy separately; they are infinite if the weights of a policy rest on fewer than two episodes.
        """
        low, high = inference.intervals(value, influence, seed=case.seed)
        if nuisance is not None:
            half = inference.beside(high - value, nuisance)
            low, high = value - half, value + half
        more |= {"influence": influence, "ess": ess, "nuisance": nuisance}
        found = cls(method, case.names, value, low, high, case.estimand, **more)
        return found.unbounded(~found.spread)

    @classmethod
    def of_members(cls, method: str, case: "OPEInput", found: np.ndarray, **more: Any) -> "Estimates":
        """The means of the (members, policies) estimates of an ensemble, with intervals by their spread."""
        low, high = ensemble_interval(found)
        return cls(method, case.names, found.mean(0), low, high, case.estimand, bootstrap=found, **more)

    @property
    def discount(self) -> float:
        """Discount of the returns, per step."""
        return self.estimand.discount

    @property
    def spread(self) -> np.ndarray:
        """(policies,) whether the weights rest on enough episodes or clusters to vary; true without weights."""
        if self.ess is None:
            return np.ones(len(self.names), bool)
        return np.minimum(self.ess, self.diagnostics.get("effective clusters", self.ess)) >= LEAST_ESS

    def unbounded(self, where: np.ndarray) -> "Estimates":
        """The same with infinite intervals for the policies for which `where` (policies,) is true."""
        return replace(self, low=np.where(where, -np.inf, self.low), high=np.where(where, np.inf, self.high))

    def corrects(self, which: int) -> bool:
        """Whether logged rewards correct the estimate of one policy: not if its estimand continues beyond the ends of the
        recording, or if the corrections of this policy or of the behaviour policy end early."""
        beyond = self.diagnostics.get("beyond", np.zeros(which + 1))[which]
        return self.corrected and max(beyond, self.left(which)) <= TAIL

    def left(self, which: int) -> float:
        """Share of an error of the critics that remains in the estimate of one policy, or of the behaviour policy if that is
        more."""
        left = self.diagnostics.get("uncorrected")
        if left is None:
            return 0.0
        return float(max(left[which], left[self.names.index(LOGGED)] if LOGGED in self.names else 0.0))

    @property
    def average(self) -> np.ndarray:
        """(policies,) discounted average reward, (1 - discount) times the value."""
        return (1.0 - self.discount) * self.value

    @property
    def best(self) -> int:
        """Index of the policy with the highest estimate."""
        return int(np.argmax(np.where(np.isnan(self.value), -np.inf, self.value)))

    def __str__(self) -> str:
        width = max(map(len, self.names))
        model = "" if self.corrected else ", model-based"
        lines = [f"{self.method}{model}: {self.estimand}; {PERCENT} intervals"]
        d = decimals(*self.value, *self.low, *self.high)
        for i, name in enumerate(self.names):
            weight = "" if self.ess is None else f"   effective sample size {self.ess[i]:,.1f} episodes"
            value, low, high = (fixed(each[i], d) for each in (self.value, self.low, self.high))
            lines.append(f"  {name:<{width}}  {value:>10} [{low}, {high}]{weight}")
        return "\n".join([*lines, *(f"  warning: {line}" for line in self.warnings)])
