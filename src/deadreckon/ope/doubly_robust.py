"""Doubly robust estimates: a value function, and importance sampling of its residuals.

    V(s_0) + sum_t discount^t w_t (r_t + discount V(s_{t+1}) - Q(s_t, a_t))

with the weights of importance sampling (`dr`, Jiang and Li 2016, unbiased where they are), self-normalised (`wdr`), or `magic`,
which ends the sum early if that reduces the error (both Thomas and Brunskill 2016); or with ratios of occupancies
(`marginal`: double reinforcement learning, Kallus and Uehara 2020), whose variance does not grow with the product of the
weights. V is zero after a terminal; the public code that the thesis used omits this.

`switch` and `dros` are `dr` with truncated or shrunk weights (`ope/switch.py`, `ope/shrinkage.py`); `mrdr` is `dr`
with critics that minimise its variance (`ope/mrdr.py`).

This requires that Q (and learned propensities and ratios) are not fitted to the rows by which it is corrected: a critic that
has memorised a reward leaves nothing to correct. So they are cross-fitted (double machine learning: Chernozhukov et al. 2018,
Kallus and Uehara 2020): those of one fold of the evaluated episodes are fitted on the other folds and on the episodes that are
not evaluated.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.importance import check_range, effective_clusters, learns, log_ratios, logged_probs, weight_diagnostics
from deadreckon.ope.linear import Fit, LinearFQE
from deadreckon.ope.mrdr import out_of_fold
from deadreckon.ope.shrinkage import shrinkage_scores
from deadreckon.ope.switch import beyond, switch_scores
from deadreckon.ope.tuning import bias_bound, cross_fitted, least_bound
from deadreckon.ope.weights import Sums, effective, few
from deadreckon.randomness import generator
from deadreckon.stats import inference
from deadreckon.stats.bootstrap import jackknife, prediction
from deadreckon.training.hyperparameters import Count, UnitInterval, static

ALONE = {"marginal": "DRL", "switch": "SWITCH", "dros": "DRos", "mrdr": "MRDR"}  # labels that do not depend on the critics
TRUSTED = np.concatenate([[0.0], np.geomspace(0.5, 5000.0, 13), [np.inf]])  # candidate limits of weights, for switch and dros
OVERFIT = 1.5  # a warning is given if the error out of fold is more than this times that on the training rows


class DoublyRobust(Estimator):
    """FQE corrected by importance sampling."""

    revision: ClassVar[int] = 4  # 2-4: MAGIC's intervals, of values and of gains, include the uncertainty of its critics

    takes_horizon = True

    kind: Literal["dr", "wdr", "magic", "marginal", "switch", "dros", "mrdr"] = static("wdr")
    """variant of weights and critics: see the estimator's page"""
    fqe: FQE | LinearFQE = static(FQE())  # estimator of the value function
    folds: Count = static(5)  # folds of cross-fitting for critics and propensities; 1: no cross-fitting
    samples: Count = static(10)  # actions sampled at each row to estimate V
    behavior: Literal["auto", "logged", "learned"] = static("auto")
    """source of the propensities: the log, or a fitted model; auto: the log where it has them"""
    model: BehaviorModel = static(BehaviorModel())  # model of the behaviour policy
    log_ratio_range: tuple[float, float] | None = static(None)
    """range that each step's log-ratio is clipped to; the public code has (-6, 2)"""
    alive_only: bool = static(False)  # whether ended episodes leave the sum of the weights, as in the public code (biased)
    lengths: Count = static(10)  # number of correction lengths that are blended, with kind="magic"
    confidence: UnitInterval = 0.5  # level of the interval that biases are measured from, with kind="magic"

    def check_settings(self) -> None:
        """Refuses settings out of range, and those that the kind does not use."""
        super().check_settings()
        check_range(self.log_ratio_range)
        unused = {
            "alive_only": self.alive_only and self.kind in ("marginal", "switch", "dros"),
            "log_ratio_range": self.log_ratio_range is not None and self.kind == "marginal",
            "behavior": self.behavior != "auto" and self.kind == "marginal",
        }
        for name in (name for name, given in unused.items() if given):
            raise UserError(f"DoublyRobust.{name} is not used with kind={self.kind!r}; leave it out")

    @property
    def takes_crossed(self) -> bool:  # pyrefly: ignore[bad-override] - it is never set
        """Whether cross-fitted policies can be evaluated."""
        return self.kind != "marginal"

    @property
    def label(self) -> str:
        """Its name in tables."""
        if self.kind in ALONE:
            return ALONE[self.kind]
        name = {"dr": "DR", "wdr": "WDR", "magic": "MAGIC"}[self.kind]
        return f"{name}-linear" if isinstance(self.fqe, LinearFQE) else name

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # products of weights overflow; `Estimator.on` warns
    def solve(self, case: OPEInput) -> Estimates:
        """Adds the corrections to the mean value of the initial observations."""
        if self.kind == "marginal":
            return self._marginal(case)
        if self.kind in ("switch", "dros"):
            return self._trusting(case)
        plain, episodes = self.kind in ("dr", "mrdr"), case.episodes
        log_rhos = self._log_rhos(case)
        nuisances, begins = self.nuisances(case)
        begin, errors = nuisances.begins, nuisances.errors
        values, ess, bootstrap, influence, left, shifts = [], [], [], [], [], []
        learned = learns(case, self.behavior)
        for i, log_rho in enumerate(log_rhos):
            sums = episodes.sums(log_rho, errors[i], normalised=not plain, alive_only=self.alive_only)
            start, pulls, drawn = episodes.means(begin[i])
            if self.kind == "magic":
                value, redrawn, pulled, uncorrected = self._blend(case, sums, start, drawn, log_rho)
                left.append(uncorrected)
            else:
                value, redrawn, pulled = start + sums.value(), drawn + sums.redraw(episodes.counts), sums.influence()
            if plain and learned:
                same = episodes.sums(log_rho, errors[i], normalised=True, alive_only=self.alive_only)
                shifts.append(same.value() - sums.value())
            pulls = pulls + pulled
            values.append(value)
            bootstrap.append(redrawn)
            influence.append(pulls)
            ess.append(sums.ess)
        ess, redrawn = np.asarray(ess), np.stack(bootstrap, 1)
        diagnostics, warnings = self._diagnosed(case, nuisances, log_rhos, ess)
        nuisance = None
        early = 0.0  # least share of the critics' error that remains, with that of the behaviour policy
        if left:
            policies, logged = left[: len(case.policies)], left[len(case.policies) :]
            early = max([min(policies), *logged])
            diagnostics["uncorrected"] = uncorrected = np.array(left)
            nuisance = np.where(uncorrected > 0, uncorrected * self._critics_errors(case, nuisances, begins), 0.0)
            # The same draws for all policies, so that errors that their critics share cancel in differences.
            redrawn = redrawn + generator(case.seed, "uncorrected").standard_normal((len(redrawn), len(nuisance))) @ nuisance
            warnings += self._uncorrected_warnings(case, uncorrected, nuisance)
        if shifts:
            diagnostics["normalising"] = np.array(shifts)
        return Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), bootstrap=redrawn, ess=ess, nuisance=nuisance,
            corrected=case.beyond <= TAIL and early <= TAIL, warnings=tuple(warnings),
            inflation=stretched(diagnostics["beyond"]), diagnostics=diagnostics,
        )  # fmt: skip

    def _log_rhos(self, case: OPEInput) -> list[np.ndarray]:
        """For each policy the (rows,) logarithms of the products of its ratios along each episode."""
        ratios = log_ratios(case, self.behavior, self.model, self.log_ratio_range, self.folds)
        return [case.episodes.cumulate(row) for row in ratios]

    def nuisances(self, case: OPEInput) -> tuple[OutOfFold, np.ndarray | None]:
        """Predictions on the evaluated rows; and (members, policies, episodes) initial values of critics that are not
        cross-fitted, else None.

        Raises:
            UserError: `mrdr` without linear critics or with one fold.
        """
        if self.kind == "mrdr":
            return case.once(("out of fold", self), lambda: self._of_least_variance(case)), None
        if isinstance(self.fqe, LinearFQE):
            # For one-step episodes the ratio of occupancies is the weight; for longer ones, `dr` and `marginal` share one fit.
            marginal = self.kind == "marginal" or (case.data.successors is None and int(case.data.lengths.max()) > 1)
            fit = Fit(self.fqe, case)
            key = ("out of fold", self.fqe, self.folds, marginal)
            return case.once(key, lambda: fit.out_of_fold(self.folds, marginal=marginal)), None
        if self.folds > 1:
            return self.fqe.out_of_fold(case, self.folds, self.samples), None
        return case.once(("errors", self.fqe, self.samples), lambda: self._in_sample(case))

    def _in_sample(self, case: OPEInput) -> tuple[OutOfFold, np.ndarray]:
        """Predictions of critics trained on the evaluated rows, as in the public code; means over the ensemble."""
        assert isinstance(self.fqe, FQE)
        data, fitted = case.timed, self.fqe.fitted(case)
        now = fitted.values(data.observations, case.current_actions(self.samples))
        begins, now = now[:, :, data.starts].astype(np.float64), now.mean(0)
        last = fitted.values(data.final_observations, case.final_actions(self.samples)).mean(0)
        chosen = fitted.of_actions(data.observations, data.actions).mean(0)
        out = OutOfFold.of_values(case, begins.mean(0), now, last, chosen)
        return replace(out, fitted=np.square(out.errors).mean(1)), begins

    def _of_least_variance(self, case: OPEInput) -> OutOfFold:
        """Predictions of the critics of `ope/mrdr.py`."""
        if not isinstance(self.fqe, LinearFQE) or self.folds < 2:
            raise UserError("kind='mrdr' needs fqe=LinearFQE(), whose features it takes, and folds of 2 or more")

        def propensities(each: OPEInput) -> tuple[np.ndarray, np.ndarray | None]:
            # Episodes that are not evaluated need no cross-fitting, and must not use models trained on evaluated ones.
            folds = self.folds if each is case else 1
            ratios = log_ratios(each, self.behavior, self.model, self.log_ratio_range, folds)
            return ratios, logged_probs(each, self.behavior, self.model, folds) if each.data.spec.discrete else None

        return out_of_fold(case, Fit(self.fqe, case), self.folds, propensities)

    def _trusting(self, case: OPEInput) -> Estimates:
        """Estimates with weights that are used up to a limit (`switch`) or shrunk (`dros`); other folds choose the limit.

        The behaviour policy keeps its weights, which are one. Diagnostics are those of the original weights: where their tail
        is too heavy, or they are based on few episodes, the bias due to the limit is not known.
        """
        if self.folds < 2:
            raise UserError(f"kind={self.kind!r} needs folds of 2 or more: other folds choose the limit of the weights")
        episodes, fold, data = case.episodes, case.folds(self.folds), case.data
        log_rhos = self._log_rhos(case)
        nuisances, _ = self.nuisances(case)
        uncensored, bound = np.exp(episodes.log_uncensored), self._error_bound(case)
        values, influence, ess, left, shifts = [], [], [], [], []
        for i, log_rho in enumerate(log_rhos):
            grid = TRUSTED[-1:] if case.names[i] == LOGGED else TRUSTED
            given = nuisances.begins[i], log_rho, nuisances.errors[i] / uncensored, data.lengths, case.discount
            over = beyond(log_rho, data.lengths, case.discount, grid)
            scores = switch_scores(*given, grid) if self.kind == "switch" else shrinkage_scores(*given, np.square(grid))

            def choose(some: np.ndarray, scores: np.ndarray = scores, over: np.ndarray = over) -> int:
                part = scores[:, some]
                switch = self.kind == "switch"
                return least_bound(part, bound * over[:, some].mean(1) if switch else bias_bound(part, part[-1]))

            each, chosen = cross_fitted(scores, fold, choose)
            value, pulls, _ = episodes.means(each)
            values.append(value)
            influence.append(pulls)
            whole, same = (episodes.sums(log_rho, nuisances.errors[i], normalised=each) for each in (False, True))
            ess.append(whole.ess)
            shifts.append(same.value() - whole.value())
            left.append(over[chosen].mean() / case.effective_horizon)
        ess = np.asarray(ess)
        diagnostics, warnings = self._diagnosed(case, nuisances, log_rhos, ess)
        diagnostics["untrusted"] = np.array(left)
        if learns(case, self.behavior):
            diagnostics["normalising"] = np.array(shifts)
        warnings.append(f"the interval of {self.label} includes the variance, but not the bias of limited weights")
        return Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), ess=ess, corrected=case.beyond <= TAIL,
            warnings=tuple(warnings), inflation=stretched(diagnostics["beyond"]), diagnostics=diagnostics,
        )  # fmt: skip

    def _diagnosed(
        self, case: OPEInput, nuisances: OutOfFold, log_rhos: Sequence[np.ndarray], ess: np.ndarray
    ) -> tuple[dict[str, np.ndarray], list[str]]:
        """The diagnostics of critics and weights, and the warnings that follow from them."""
        critics, doubts = self._critics_diagnosed(case, nuisances)
        weights = weight_diagnostics(case, log_rhos, ess)
        share = weights["beyond"]
        found, worst = case.episodes.warnings(case.names, ess), int(np.argmax(share))
        if share[worst] > TAIL:
            whose = f"of {case.names[worst]} " if share[worst] > case.beyond else ""
            found.append(
                f"{100 * share[worst]:.0f} % of the discounted time {whose}lies beyond the ends of the recording, where "
                "nothing corrects the critics; a horizon asks for what was recorded"
            )
        return critics | weights, found + doubts

    @staticmethod
    def _error_bound(case: OPEInput) -> float:
        """Bound of a critic's expected error of one step: of one-step episodes the range of a reward, else that of a value."""
        reward = case.data.spec.reward
        if case.data.lengths.max() == 1:
            return float(reward.max - reward.min)
        return float(max(reward.max, 0.0) - min(reward.min, 0.0)) * case.effective_horizon

    def _critics_diagnosed(self, case: OPEInput, nuisances: OutOfFold) -> tuple[dict[str, np.ndarray], list[str]]:
        """The diagnostics of critics, and warnings of those that diverge, overfit or have not converged.

        `residual` and `training residual` are the root mean squared errors of each policy's critics out of fold, and on their
        training rows, both in standard deviations of the reward.
        """
        found = [f"the critics of {name} diverge" for name, settled in zip(case.names, nuisances.settled) if not settled]
        scale = float(case.data.spec.reward.std) or 1.0
        residual, fitted = np.sqrt(np.square(nuisances.errors).mean(1)) / scale, np.sqrt(nuisances.fitted) / scale
        over = np.flatnonzero(residual > OVERFIT * fitted)
        if len(over):
            worst = over[np.argmax(residual[over] / np.maximum(fitted[over], 1e-12))]
            found.append(
                f"the critics of {case.names[worst]} overfit: their error is {residual[worst]:.2g} reward standard deviations "
                f"out of fold and {fitted[worst]:.2g} on the training rows; estimates remain valid, but intervals are wide"
            )
        settled = nuisances.settled
        if isinstance(self.fqe, FQE):
            still, more = case.convergence("fqe by folds" if self.folds > 1 else "fqe", case.names)
            settled, found = settled & still, found + more
        return {"residual": residual, "training residual": fitted, "settled": settled.astype(float)}, found

    def _marginal(self, case: OPEInput) -> Estimates:
        """Estimates by ratios of occupancies; of the behaviour policy, the mean return if a terminal ends every episode."""
        if not isinstance(self.fqe, LinearFQE):
            raise UserError("kind='marginal' needs fqe=LinearFQE(), whose features also give the ratios of occupancies")
        if self.folds < 2:
            raise UserError("kind='marginal' needs folds of 2 or more: its ratios must not be fitted to the rows they weight")
        nuisances, _ = self.nuisances(case)
        assert nuisances.weighted is not None
        assert nuisances.weights is not None
        assert nuisances.mass is not None
        episodes = case.episodes
        of_row = episodes.group[episodes.of]
        values, influence, weights, masses = [], [], [], []

        def mean_of(x: np.ndarray, known: np.ndarray) -> tuple[float, np.ndarray]:
            """Mean over the rows that are `known`, and its (groups,) influence function."""
            rows, total = (np.bincount(of_row[known], each, episodes.groups) for each in (None, x[known]))
            mean = total.sum() / rows.sum()
            return mean, episodes.groups * (total - mean * rows) / rows.sum()

        for i, name in enumerate(case.names):
            # With a horizon all rows count: the last step needs no successor, and rows without one weigh zero at other steps.
            every = np.ones(len(case.data), bool) if case.estimand.horizon is not None else case.followed
            masses.append(mean_of(nuisances.mass[i], every))
            terms = occupancy_terms(case, nuisances, i)
            start, pulls, _ = episodes.means(terms.begins)
            mean, pulled = mean_of(terms.weighted, terms.known)
            if name == LOGGED and _whole(case):
                weight = np.ones(episodes.count)
            else:
                weight = np.maximum(np.bincount(episodes.of, nuisances.weights[i], episodes.count), 0.0)
            values.append(start + mean)
            influence.append(pulls + pulled)
            weights.append(weight)
        ess = effective(np.stack(weights))
        diagnostics, doubts = self._critics_diagnosed(case, nuisances)
        warnings = [*few(case.names, ess, episodes.count), *doubts]
        mass = np.array([mean for mean, _ in masses])
        high = inference.student(mass, np.stack([pulled for _, pulled in masses], 1), 2 * inference.SURE)[1]
        means = {"mass": mass, "mass high": high}
        with np.errstate(divide="ignore"):
            means |= effective_clusters(case, [np.log(weight) for weight in weights])
        exact = case.table is not None
        if exact:
            warnings.append(
                f"{self.label} assumes that observations are Markov (they hold all that matters), which its interval does "
                "not include"
            )
        else:
            warnings.append(
                "its critics and its ratios are linear in the same features, which are not a table here: if both are wrong, "
                "nothing corrects the error, and the interval does not include it"
            )
        return Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), ess=ess, corrected=exact,
            warnings=tuple(warnings), diagnostics=diagnostics | means,
        )  # fmt: skip

    def _critics_errors(self, case: OPEInput, nuisances: OutOfFold, begins: np.ndarray | None) -> np.ndarray:
        """(groups, policies) error of the critics' mean initial values (see `Estimates.nuisance`): by the members of an
        ensemble, or by the critics of the folds (the jackknife).

        Networks of folds also differ by their initialisation, so their error is an upper bound. NaN with a single critic.
        """
        if begins is not None:
            return prediction(begins.mean(-1))
        if nuisances.by_fold is None:
            return np.full((1, case.count), np.nan)
        return jackknife(nuisances.by_fold(), nuisances.left_out)

    def _uncorrected_warnings(self, case: OPEInput, left: np.ndarray, nuisance: np.ndarray) -> list[str]:
        found, worst = [], int(np.argmax(left))
        if left[worst] > TAIL:
            found.append(
                f"{100 * left[worst]:.0f} % of any error of the critics of {case.names[worst]} remains in its estimate by "
                f"{self.label}, whose interval includes the critics' variance, but not their bias"
            )
        if np.isnan(nuisance).any():
            found.append(f"{self.label} with one critic per policy has no interval; folds, or more members, give one")
        return found

    def _blend(
        self, case: OPEInput, sums: Sums, begin: float, drawn: np.ndarray, log_rho: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Corrections of several lengths, weighted so that variance plus squared bias is least.

        Returns:
            The estimate, its bootstrap samples, the influence function of the corrections, and the share of an error of the
            critics that remains in it: after j steps, discount^j times the share of the policy's episodes that last so long.
        """
        from scipy.optimize import nnls  # takes half a second, and only this kind needs it

        episodes = case.episodes
        ends = np.unique(np.geomspace(1, episodes.steps, self.lengths).round().astype(int)) - 1
        partial = np.concatenate([[0.0], sums.partial()[ends]])
        steps = np.cumsum(sums.redraw_steps(episodes.counts), 1)
        redrawn = np.concatenate([np.zeros((len(drawn), 1)), steps[:, ends]], 1)
        whole = drawn + redrawn[:, -1]
        low, high = np.percentile(whole, [50 * (1 - self.confidence), 50 * (1 + self.confidence)])
        bias = begin + partial - np.clip(begin + partial, low, high)
        # x that minimises x' (cov + bias bias') x on the simplex, as non-negative least squares with a heavy row of ones.
        values, vectors = np.linalg.eigh(np.cov((drawn[:, None] + redrawn).T) + np.outer(bias, bias))
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        heavy = 1e4 * max(float(np.abs(root).max()), 1e-12)
        x = nnls(np.vstack([root, np.full(len(partial), heavy)]), np.append(np.zeros(len(partial)), heavy))[0]
        x /= x.sum()
        pulls = np.cumsum(sums.influence_steps(), 1)[:, ends] @ x[1:]
        uncorrected = x[0] + x[1:] @ (case.discount ** (ends + 1) * episodes.going_on(log_rho)[ends])
        return begin + float(x @ partial), drawn + redrawn @ x, pulls, float(uncorrected)


def stretched(share: Sequence[float] | np.ndarray) -> np.ndarray | None:
    """(policies,) factors of the standard errors if the recording ends early; None: one.

    A share b of a policy's discounted time lies beyond it (`OPEInput.beyond_of`), where the critics are not corrected. The
    influence function of the corrections does not include their errors there. These are assumed to be those of the recorded
    part and to add up with them, so the total error is 1 / (1 - b) times that of the recorded part.
    """
    beyond = np.asarray(share)
    if (beyond <= TAIL).all():
        return None
    return np.where(beyond > TAIL, 1.0 / np.maximum(1.0 - beyond, 1e-3), 1.0)


class Terms(NamedTuple):
    """What an estimate by ratios of occupancies is the sum of: a mean over episodes, and one over rows.

    Attributes:
        begins: (episodes,) values of their first observations.
        weighted: (rows,) weighted errors of the critics.
        known: (rows,) which rows count.
    """

    begins: np.ndarray
    weighted: np.ndarray
    known: np.ndarray


def occupancy_terms(case: OPEInput, nuisances: OutOfFold, which: int) -> Terms:
    """The terms of the estimate of one policy; of the behaviour policy returns, if a terminal ends every episode."""
    # With a horizon all rows count: the last step needs no successor, and rows without one weigh zero at other steps.
    every = np.ones(len(case.data), bool) if case.estimand.horizon is not None else case.followed
    logged = case.names[which] == LOGGED
    if logged and _whole(case):
        return Terms(case.data.returns(case.discount), np.zeros(len(case.data)), every)
    assert nuisances.weighted is not None
    # Ratios are of occupancies over the rows whose successor is known, and of the behaviour policy also what it did.
    known = every & case.shown if logged and case.estimand.horizon is None else every
    return Terms(nuisances.begins[which], nuisances.weighted[which], known)


def _whole(case: OPEInput) -> bool:
    """Whether a terminal, or the horizon, ends every episode."""
    return bool(np.asarray(case.data.terminals)[case.data.ends].all())
