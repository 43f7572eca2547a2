"""Settings of estimates and of decisions, which estimators, `decide` and `runs.offline.judge` share.

Functions take them as keywords; `FitOptions`, `EstimateOptions` and `DecisionOptions` are these keywords for type checkers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypedDict

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.behavior_model import PROPENSITIES, BehaviorModel
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.sensitivity import check_gamma
from deadreckon.progress import Watcher, unwatched
from deadreckon.randomness import check_seed
from deadreckon.settings import Settings


@dataclass(frozen=True, kw_only=True)
class FitSettings(Settings):
    """Settings of the fits of estimators."""

    seed: int = 0  # random seed of the estimates
    out: Path | str | None = None  # folder of checkpoints, from which an interrupted fit continues; None: nothing is written
    watch: Watcher = unwatched  # called with what is being fitted, the updates done and the updates in all

    def check_values(self) -> None:
        """Refuses seeds out of range."""
        super().check_values()
        check_seed(self.seed)


@dataclass(frozen=True, kw_only=True)
class EstimateSettings(FitSettings):
    """Settings of estimates: what is estimated, and how. `Estimand` checks discount and horizon against the log."""

    discount: float = 0.995  # discount factor per step; 1 where episodes end or there is a horizon
    horizon: int | Literal["auto"] | None = None
    """first steps of an episode that count; None: all; auto: those of the longest episode, if timeouts fall there, else all"""
    greedy: bool = False  # whether to evaluate deterministic (greedy) instead of sampled actions

    def estimand(self, log: Dataset) -> Estimand:
        """The estimand for a log; see `Estimand.of`.

        Raises:
            UserError: a discount or a horizon that is out of range, or without a finite value on this log.
        """
        return Estimand.of(log, self.discount, self.horizon, self.greedy)


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings(Settings):
    """Settings of decisions: which estimates may decide, and what must hold beside a gain."""

    accept_model_based: bool = False  # whether to deploy also by estimates that no logged reward corrects
    cost_limit: float | Mapping[str, float] | Sequence[str] | None = None
    """largest total cost of an episode, discounted like the value; a number or COLUMN=NUMBER; the interval must be within"""
    stationary: bool = False
    """whether the order of rows says nothing of time; if not, estimates and gains allow for changes along the log"""


@dataclass(frozen=True, kw_only=True)
class DecisionSettings(EvidenceSettings):
    """All settings of a decision: which estimates may decide, what must hold beside a gain, and what is shown."""

    model: BehaviorModel = PROPENSITIES
    """how the behaviour policy is learned, for checks and by "auto"; estimators that are given have settings of their own"""
    guarantee: bool = False
    """whether to deploy only by a bound of the gain that holds for any number of episodes; needs a return range"""
    return_range: tuple[float, float] | None = None  # smallest and largest return that an episode can have
    confounding: float | None = None
    """factor by which the odds of logged actions may be wrong; deploy only if the gain stays positive"""
    tail: float | None = None  # share of the worst episodes, such as 0.1, whose mean return is shown separately

    def check_values(self) -> None:
        """Refuses ratios of odds and shares of episodes that are out of range."""
        super().check_values()
        if self.confounding is not None:
            check_gamma(self.confounding)
        if self.tail is not None:
            check_share(self.tail)


def check_share(share: float) -> None:
    """Refuses invalid shares of the worst episodes.

    Raises:
        UserError: it is not above 0 and at most 1.
    """
    if not 0.0 < share <= 1.0:
        raise UserError(f"the share of the worst episodes must be above 0 and at most 1, got {share:g}")


class FitOptions(TypedDict, total=False):
    """Keywords of `FitSettings`."""

    seed: int
    out: Path | str | None
    watch: Watcher


class EstimateOptions(FitOptions, total=False):
    """Keywords of `EstimateSettings`."""

    discount: float
    horizon: int | Literal["auto"] | None
    greedy: bool


class DecisionOptions(TypedDict, total=False):
    """Keywords of `DecisionSettings`."""

    accept_model_based: bool
    cost_limit: float | Mapping[str, float] | Sequence[str] | None
    stationary: bool
    model: BehaviorModel
    guarantee: bool
    return_range: tuple[float, float] | None
    confounding: float | None
    tail: float | None
