"""Importance sampling: logged rewards, weighted by the policy's probability of the logged actions (thesis 8.5).

Precup, Sutton and Singh 2000. What is summed, and how ended and cut-off episodes count, is in `ope/weights.py`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import LEAST_ESS, Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.pareto import diagnosed
from deadreckon.ope.weights import Episodes, effective_of_logs
from deadreckon.settings import check_kind
from deadreckon.stats import inference, means
from deadreckon.training.hyperparameters import Count, Positive, static

PUBLIC_RANGE = (-6.0, 2.0)  # of a step's log-ratio in the public implementation that the thesis used
NEARLY = 0.99  # share of the sum of squared weights that rows of `counting` have


class ImportanceSampling(Estimator):
    """Trajectory-wise or per-decision importance sampling, plain (unbiased) or self-normalised."""

    revision: ClassVar[int] = 1

    takes_horizon = True
    takes_crossed = True

    kind: Literal["trajectory", "per_decision"] = static("per_decision")  # weights: one per episode, or one per decision
    normalised: bool = static(True)  # whether to divide by the sum of the weights: biased, but of far less variance
    behavior: Literal["auto", "logged", "learned"] = static("auto")
    """source of the propensities: the log, or a fitted model; auto: the log where it has them"""
    model: BehaviorModel = static(BehaviorModel())  # model of the behaviour policy
    log_ratio_range: tuple[float, float] | None = static(None)
    """range that each step's log-ratio is clipped to; the public code has (-6, 2)"""
    alive_only: bool = static(False)  # whether ended episodes leave the sum of the weights, as in the public code (biased)
    interval: Literal["bootstrap", "t", "hoeffding", "bernstein"] = static("bootstrap")
    """kind of interval; hoeffding and bernstein hold for any number of episodes"""
    folds: Count = static(5)  # folds of cross-fitting for learned propensities; 1: one model of all episodes
    return_range: tuple[float, float] | None = static(None)
    """smallest and largest return of an episode, for hoeffding and bernstein"""
    max_weight: Positive | None = static(None)  # largest weight of an episode or of its steps, for hoeffding and bernstein

    def check_settings(self) -> None:
        """Refuses settings out of range."""
        super().check_settings()
        check_range(self.log_ratio_range)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # products of weights overflow; `Estimator.on` warns
    def solve(self, case: OPEInput) -> Estimates:
        """Weighted sums of the logged rewards."""
        episodes = case.episodes
        log_rhos = [
            episodes.cumulate(row) for row in log_ratios(case, self.behavior, self.model, self.log_ratio_range, self.folds)
        ]
        rewards, whole = np.asarray(case.data.rewards, np.float64), self.kind == "trajectory"
        bounds = self._bounds(case, rewards)
        plain = not self.normalised and learns(case, self.behavior)
        values, lows, highs, ess, bootstrap, influence, shifts = [], [], [], [], [], [], []
        for log_rho in log_rhos:
            if whole:
                summed = partial(episodes.whole, log_rho, rewards)
            else:
                summed = partial(episodes.sums, log_rho, rewards, alive_only=self.alive_only)
            sums = summed(normalised=self.normalised)
            if plain:
                shifts.append(summed(normalised=True).value() - sums.value())
            values.append(sums.value())
            influence.append(sums.influence())
            bootstrap.append(sums.redraw(episodes.counts))
            if self.interval != "bootstrap":
                each = sums.value() + sums.influence()
                if not self.normalised and episodes.even and not case.clustered:
                    each = episodes.contributions(log_rho, rewards, whole=whole)
                known = sums.ess >= LEAST_ESS if bounds is None else sums.ess > 0
                low, high = self._interval(each, bounds) if known else (-np.inf, np.inf)
                lows.append(low)
                highs.append(high)
            ess.append(sums.ess)
        ess, values = np.asarray(ess), np.asarray(values)
        warnings = episodes.warnings(case.names, ess, whole=whole, ahead=case.cut_ahead)
        if not np.isfinite(values).all():
            warnings.append("weights overflow; normalised=True keeps them finite")
        diagnostics = weight_diagnostics(case, log_rhos, ess, whole=whole)
        if shifts:
            diagnostics["normalising"] = np.array(shifts)
        found = Estimates.of_influence(
            self.label, case, values, np.stack(influence, 1), bootstrap=np.stack(bootstrap, 1), ess=ess,
            corrected=case.beyond <= TAIL, warnings=tuple(warnings), diagnostics=diagnostics,
        )  # fmt: skip
        return replace(found, low=np.asarray(lows), high=np.asarray(highs)) if lows else found

    @property
    def label(self) -> str:
        """Its name in tables."""
        short = {"trajectory": "IS", "per_decision": "PDIS"}[self.kind]
        return f"{'W' if self.normalised else ''}{short}"

    def _bounds(self, case: OPEInput, rewards: np.ndarray) -> tuple[float, float] | None:
        if self.interval not in ("hoeffding", "bernstein"):
            return None
        if self.return_range is None or self.max_weight is None or self.normalised:
            raise UserError(
                f"interval={self.interval!r} needs normalised=False, return_range=(least, greatest) and max_weight: "
                "it holds for every number of episodes because these limit what an episode can contribute"
            )
        if case.clustered:
            raise UserError(f"interval={self.interval!r} needs independent episodes, which those of a cluster are not; use 't'")
        if not case.episodes.even or (self.kind == "per_decision" and rewards.min() < 0 < rewards.max()):
            raise UserError(
                f"interval={self.interval!r} needs episodes that end or are cut off at the same step and, per decision, "
                "rewards of one sign: else the range of a return does not bound what an episode adds; use kind='trajectory'"
            )
        low, high = self.return_range
        if not (low < high and self.max_weight > 0):
            asked = f"got {low:g}, {high:g} and {self.max_weight:g}"
            raise UserError(f"return_range must be (least, greatest) and max_weight above 0, {asked}")
        return min(0.0, low * self.max_weight), max(0.0, high * self.max_weight)

    def _interval(self, each: np.ndarray, bounds: tuple[float, float] | None) -> tuple[float, float]:
        if bounds is None:
            return means.student(each)
        low, high = bounds
        if each.min() < low or each.max() > high:
            beyond = float(each.min() if each.min() < low else each.max())
            raise UserError(
                f"an episode adds {beyond:.4g}, outside the {low:.4g} .. {high:.4g} that return_range and max_weight allow; "
                "they must hold for every episode"
            )
        bound = means.hoeffding if self.interval == "hoeffding" else means.empirical_bernstein
        return bound(each, *bounds)


def check_range(log_ratios: tuple[float, float] | None) -> None:
    """Refuses invalid ranges of log-ratios.

    Raises:
        UserError: not two numbers, the least before the greatest.
    """
    check_kind("log_ratio_range", log_ratios, tuple[float, float] | None)
    if log_ratios is not None and not log_ratios[0] < log_ratios[1]:
        raise UserError(f"log_ratio_range must be (least, greatest), got {log_ratios[0]:g}, {log_ratios[1]:g}")


def weight_diagnostics(
    case: OPEInput, log_rhos: Sequence[np.ndarray], ess: np.ndarray, *, whole: bool = False
) -> dict[str, np.ndarray]:
    """Diagnostics of weights that are multiplied along episodes: `tails_of`, `multiplied`, and `beyond`, the share of each
    policy's discounted time that lies beyond the ends of the recording (`OPEInput.beyond_of`).

    Args:
        case: log and policies.
        log_rhos: for each policy the (rows,) logarithms of the products of its ratios; see `Episodes.cumulate`.
        ess: (policies,) effective sample size of the weights, in episodes.
        whole: each episode has one weight, its last; otherwise one at each step.
    """
    episodes = case.episodes
    tails = tails_of(case, [episodes.typical(log_rho, whole=whole) for log_rho in log_rhos])
    means = multiplied(episodes, ess, [episodes.average(log_rho) for log_rho in log_rhos])
    return tails | means | {"beyond": np.array([case.beyond_of(log_rho) for log_rho in log_rhos])}


def tails_of(case: OPEInput, log_weights: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Diagnostics of weights: `pareto.diagnosed` of each policy's (episodes,) or (rows,) weights, given as logarithms, and
    `effective_clusters`. If episodes come in clusters, both use the sums of weights over clusters, which are independent."""
    if not case.clustered:
        return diagnosed(log_weights)
    sums = _by_cluster(case, log_weights)
    return diagnosed([*sums]) | _effective(sums)


def effective_clusters(case: OPEInput, log_weights: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """The diagnostic `effective clusters`: effective sample size of the sums of weights over each cluster; {} if each episode
    is one."""
    return _effective(_by_cluster(case, log_weights)) if case.clustered else {}


def _effective(sums: np.ndarray) -> dict[str, np.ndarray]:
    return {"effective clusters": effective_of_logs(sums)}


def _by_cluster(case: OPEInput, log_weights: Sequence[np.ndarray]) -> np.ndarray:
    """(policies, clusters) logarithms of sums of (episodes,) or (rows,) weights."""
    found = np.full((len(log_weights), int(case.cluster.max()) + 1), -np.inf)
    for total, each in zip(found, log_weights):
        np.logaddexp.at(total, case.cluster if len(each) == len(case.cluster) else case.cluster[case.data.episode_of], each)
    return found


def multiplied(episodes: Episodes, ess: np.ndarray, average: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Diagnostics of weights that are multiplied along episodes.

    Args:
        episodes: of the log.
        ess: (policies,) their effective sample size, in episodes.
        average: for each policy the (episodes,) means of their weights (`Episodes.average`).

    Returns:
        The effective sample size as a share of the episodes; the mean weight, which should be one; and the upper end of its
        one-sided 99 % interval. {} for episodes of one step.
    """
    if episodes.steps == 1:
        return {}
    found = [episodes.means(each)[:2] for each in average]
    mean, influence = np.array([value for value, _ in found]), np.stack([pulls for _, pulls in found], 1)
    high = inference.student(mean, influence, 2 * inference.SURE)[1]
    return {"effective share": ess / episodes.count, "mean weight": mean, "mean weight high": high}


def learns(case: OPEInput, behavior: Literal["auto", "logged", "learned"]) -> bool:
    """Whether propensities are those of a fitted model."""
    return behavior == "learned" or (behavior == "auto" and "behavior_log_probs" not in case.data.extras)


def counting(log_ratios: np.ndarray) -> np.ndarray:
    """(policies, rows) bool, which rows count for each policy: the fewest with nearly all of the sum of squared weights."""
    out = np.zeros(log_ratios.shape, bool)
    for own, rows in zip(log_ratios, out):
        if np.isfinite(most := own.max()):
            square = np.exp(2.0 * (own - most))
            ordered = np.sort(square)[::-1]
            rows[:] = square >= ordered[int((np.cumsum(ordered) >= NEARLY * square.sum()).argmax())]
    return out


def log_ratios(
    case: OPEInput,
    behavior: Literal["auto", "logged", "learned"],
    model: BehaviorModel,
    within: tuple[float, float] | None,
    folds: int = 5,
) -> np.ndarray:
    """(policies, rows) log of pi(a|s) / beta(a|s) of each logged action; learned propensities are those of `folds` folds."""
    own = case.log_probs  # first: policies without probabilities are refused before anything is fitted
    if not learns(case, behavior):
        own = case.log_densities
    elif folds > 1:
        own = case.learned_log_probs
    ratios = np.zeros((case.count, own.shape[1]))  # that of the behaviour policy stays zero
    for clipped in np.unique(case.clips).tolist():
        which = np.flatnonzero(case.clips == clipped)
        ratios[which] = own[which] - logged_probs(case, behavior, model, folds, clipped=clipped)
    return ratios if within is None else np.clip(ratios, *within)


def logged_probs(
    case: OPEInput, behavior: Literal["auto", "logged", "learned"], model: BehaviorModel, folds: int = 5, *,
    clipped: bool = False,
) -> np.ndarray:  # fmt: skip
    """(rows,) log beta(a|s) of the logged actions; learned ones are those of `folds` folds.

    For continuous actions the learned model must be `clipped` if the policies are: at a bound of the actions, a clipped
    Gaussian has a probability, and a tanh-Gaussian a density.
    """
    if folds > 1 and learns(case, behavior):
        return out_of_fold(case, model, folds, clipped=clipped).log_probs
    return case.behavior_log_probs(behavior, model, clipped=clipped)
