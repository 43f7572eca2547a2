"""Doubly robust estimates: a value function, and importance sampling of what it does not explain.

    V(s_0) + sum_t discount^t w_t (r_t + discount V(s_{t+1}) - Q(s_t, a_t))

with the weights of importance sampling (`dr`, Jiang and Li 2016, unbiased where they are), self-normalised (`wdr`), or `magic`,
which ends the sum early where that is worth its bias (both Thomas and Brunskill 2016); or with ratios of occupancies (`marginal`:
double reinforcement learning, Kallus and Uehara 2020), whose variance does not grow with the product of the weights. V is zero
after a terminal; the public code that the thesis used forgets that.

All of it rests on Q (and learned propensities and ratios) not having seen the rows that it is corrected by: a critic that has
memorised a reward leaves nothing to correct. So they are cross-fitted (double machine learning: Chernozhukov et al. 2018, Kallus
and Uehara 2020): those of one fold of the judged episodes come from the other folds and from the episodes that are not judged.
"""

from typing import Literal

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope import inference
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.estimate import LOGGED, BehaviorModel, Case, Estimates, Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.importance import log_ratios
from deadreckon.ope.intervals import spread
from deadreckon.ope.linear import Fit, LinearFQE
from deadreckon.ope.pareto import pareto_k
from deadreckon.ope.weights import Episodes, Sums, few
from deadreckon.training.learner import static

NORMAL = 1.96  # half of a normal's 95 % interval, in standard deviations


class DoublyRobust(Estimator):
    """FQE corrected by importance sampling."""

    takes_horizon = True

    kind: Literal["dr", "wdr", "magic", "marginal"] = static("wdr")  # plain or normalised weights, a blend, occupancy ratios
    fqe: FQE | LinearFQE = static(FQE())  # the value function
    folds: int = static(5)  # each fold's critics and propensities learn from the others; 1: from the judged rows themselves
    samples: int = static(10)  # actions sampled at each row for V
    behavior: Literal["auto", "logged", "learned"] = static("auto")  # the log's own probabilities, or a model's
    model: BehaviorModel = static(BehaviorModel())  # how the behaviour policy is learned
    log_ratio_range: tuple[float, float] | None = static(None)  # cuts each step's log-ratio; the public code has (-6, 2)
    alive_only: bool = static(False)  # forget ended episodes in the weights' sum, as the public code does (biased)
    lengths: int = static(10)  # magic: how many lengths of correction are blended
    confidence: float = 0.5  # magic: level of the interval of the full correction that biases are measured from

    @property
    def label(self) -> str:
        """What tables call it."""
        name = {"dr": "DR", "wdr": "WDR", "magic": "MAGIC", "marginal": "DRL"}[self.kind]
        return f"{name}-linear" if self.kind != "marginal" and isinstance(self.fqe, LinearFQE) else name

    def solve(self, case: Case) -> Estimates:
        """Adds the corrections to the mean value of the initial observations."""
        if self.kind == "marginal":
            return self._marginal(case)
        episodes = case.episodes
        ratios = log_ratios(case, self.behavior, self.model, self.log_ratio_range, self.folds)
        nuisances, begins = self._nuisances(case)
        begin, errors = nuisances.begins, nuisances.errors
        values, effective, redraws, influence, tails, doubts = [], [], [], [], [], []
        for i, row in enumerate(ratios):
            log_rho = episodes.cumulate(row)
            sums = episodes.sums(log_rho, errors[i], normalised=self.kind != "dr", alive_only=self.alive_only)
            start, pulls, drawn = episodes.means(begin[i])
            if self.kind == "magic":
                value, redrawn, pulled, uncorrected = self._blend(episodes, sums, start, drawn)
                if uncorrected > 0 and begins is not None:
                    # What is not corrected is as uncertain as the critics are among themselves, on the bootstrap's scale. Of
                    # one critic that is not known, and there is no interval.
                    low, high = spread(begins[:, i].mean(-1))
                    noise = np.random.default_rng([case.seed, 4, i]).standard_normal(len(redrawn))
                    redrawn = redrawn + uncorrected * (high - low) / (2 * NORMAL) * noise
                    doubts.append(i)
            else:
                value, redrawn, pulled = start + sums.value(), drawn + sums.redraw(episodes.counts), sums.influence()
            pulls = pulls + pulled
            values.append(value)
            redraws.append(redrawn)
            influence.append(pulls)
            effective.append(sums.effective)
            tails.append(pareto_k(episodes.typical(log_rho, whole=False)))
        effective = np.asarray(effective)
        warnings = [*episodes.warnings(case.names, effective, beyond=True), *self._unsettled(case, nuisances)]
        if self.kind == "magic" and begins is None:
            warnings.append("its interval knows the variance of the corrections that are blended and not the bias of their lack")
        found = Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), redraws=np.stack(redraws, 1), effective=effective,
            corrected=True, warnings=tuple(warnings),
            diagnostics=self._diagnostics(case, nuisances) | {"pareto k": np.array(tails)},
        )  # fmt: skip
        for i in doubts:  # the critics' share of doubt is in the redraws alone
            found.low[i], found.high[i] = episodes.percentiles(found.redraws[:, i], effective[i])
        return found

    def _nuisances(self, case: Case) -> tuple[OutOfFold, np.ndarray | None]:
        """Critics on the judged rows, and where there are members (members, policies, episodes) of their initial values."""
        if isinstance(self.fqe, LinearFQE):
            key = ("out of fold", self.fqe, self.folds, self.kind == "marginal")
            fit = Fit(self.fqe, case)
            return case.once(key, lambda: fit.out_of_fold(self.folds, marginal=self.kind == "marginal")), None
        if self.folds > 1:
            return self.fqe.out_of_fold(case, self.folds, self.samples), None
        return case.once(("errors", self.fqe, self.samples), lambda: self._in_sample(case))

    def _in_sample(self, case: Case) -> tuple[OutOfFold, np.ndarray]:
        """By critics that learned from the judged rows, as the public code has it; an ensemble's mean."""
        assert isinstance(self.fqe, FQE)
        data, fitted = case.timed, self.fqe.fitted(case)
        now = fitted.values(data.observations, case.current_actions(self.samples))
        begins, now = now[:, :, data.starts].astype(np.float64), now.mean(0)
        last = fitted.values(data.final_observations, case.final_actions(self.samples)).mean(0)
        chosen = fitted.of_actions(data.observations, data.actions).mean(0)
        out = OutOfFold.of_values(case, begins.mean(0), now, last, chosen)
        return out, begins

    def _unsettled(self, case: Case, nuisances: OutOfFold) -> list[str]:
        found = [f"the critics of {name} diverge" for name, settled in zip(case.names, nuisances.settled) if not settled]
        return found + self._network_unsettled(case)

    def _diagnostics(self, case: Case, nuisances: OutOfFold) -> dict[str, np.ndarray]:
        """Root mean square of what the critics leave unexplained, out of fold, in standard deviations of the reward."""
        scale = float(case.data.spec.reward.std) or 1.0
        settled = nuisances.settled & (not self._network_unsettled(case))
        return {"residual": np.sqrt(np.square(nuisances.errors).mean(1)) / scale, "settled": settled.astype(float)}

    def _network_unsettled(self, case: Case) -> list[str]:
        return self.fqe.unsettled(case, "fqe by folds" if self.folds > 1 else "fqe") if isinstance(self.fqe, FQE) else []

    def _marginal(self, case: Case) -> Estimates:
        """By ratios of occupancies. Where all episodes are whole the log's own policy has its mean return, exactly."""
        if not isinstance(self.fqe, LinearFQE):
            raise UserError("kind='marginal' needs fqe=LinearFQE(), whose features also give the ratios of occupancies")
        if self.folds < 2:
            raise UserError("kind='marginal' needs folds of 2 or more: its ratios must not have seen the rows they weigh")
        nuisances, _ = self._nuisances(case)
        assert nuisances.weighted is not None
        assert nuisances.weights is not None
        episodes = case.episodes
        of_row = episodes.group[episodes.of]
        # Ratios are of occupancies over the rows whose successor is known.
        rows = np.bincount(of_row[case.followed], minlength=episodes.groups)
        values, influence, effective = [], [], []
        for i, name in enumerate(case.names):
            if name == LOGGED and episodes.even:
                returns = case.data.returns(case.discount)
                value, pulls, _ = episodes.means(returns)
                weight = np.ones(episodes.count)
            else:
                start, pulls, _ = episodes.means(nuisances.begins[i])
                total = np.bincount(of_row, nuisances.weighted[i], episodes.groups)
                mean = total.sum() / rows.sum()
                value = start + mean
                pulls = pulls + episodes.groups * (total - mean * rows) / rows.sum()
                weight = np.maximum(np.bincount(episodes.of, nuisances.weights[i], episodes.count), 0.0)
            values.append(value)
            influence.append(pulls)
            effective.append(weight.sum() ** 2 / max(float(np.square(weight).sum()), 1e-300))
        effective = np.asarray(effective)
        warnings = [*few(case.names, effective, episodes.count), *self._unsettled(case, nuisances)]
        means = {"mean ratio": nuisances.weights[:, case.followed].mean(1)}
        return Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), effective=effective, corrected=True,
            warnings=tuple(warnings), diagnostics=self._diagnostics(case, nuisances) | means,
        )  # fmt: skip

    def _blend(
        self, episodes: Episodes, sums: Sums, begin: float, drawn: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Corrections of several lengths, weighted so that variance plus squared bias is least.

        Returns:
            The estimate, its redraws, the influence of the corrections, and the weight of no correction at all.
        """
        from scipy.optimize import nnls  # half a second, for this kind alone

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
        return begin + float(x @ partial), drawn + redrawn @ x, pulls, float(x[0])
