"""Doubly robust estimates: a value function, and importance sampling of what it does not explain.

    V(s_0) + sum_t discount^t w_t (r_t + discount V(s_{t+1}) - Q(s_t, a_t))

with the weights of importance sampling (`dr`, Jiang and Li 2016, unbiased where they are), self-normalised (`wdr`), or `magic`,
which ends the sum early where that is worth its bias (both Thomas and Brunskill 2016). Q comes from FQE. V is zero after a
terminal; the public code that the thesis used forgets that.
"""

from typing import Literal

import numpy as np

from deadreckon.ope.estimate import BehaviorModel, Case, Estimates, Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.importance import log_ratios
from deadreckon.ope.intervals import spread, student
from deadreckon.ope.weights import Episodes, Sums
from deadreckon.training.learner import static

NORMAL = 1.96  # half of a normal's 95 % interval, in standard deviations


class DoublyRobust(Estimator):
    """FQE corrected by importance sampling."""

    kind: Literal["dr", "wdr", "magic"] = static("wdr")  # plain weights, self-normalised ones, or a blend of lengths
    fqe: FQE = static(FQE())  # the value function
    samples: int = static(10)  # actions drawn at each row for V
    behavior: Literal["auto", "logged", "learned"] = static("auto")  # the log's own probabilities, or a model's
    model: BehaviorModel = static(BehaviorModel())  # how the behaviour policy is learned
    log_ratio_range: tuple[float, float] | None = static(None)  # cuts each step's log-ratio; the public code has (-6, 2)
    alive_only: bool = static(False)  # forget ended episodes in the weights' sum, as the public code does (biased)
    lengths: int = static(10)  # magic: how many lengths of correction are blended
    confidence: float = 0.5  # magic: level of the interval of the full correction that biases are measured from

    @property
    def label(self) -> str:
        """What tables call it."""
        return {"dr": "DR", "wdr": "WDR", "magic": "MAGIC"}[self.kind]

    def solve(self, case: Case) -> Estimates:
        """Adds the corrections to the mean value of the initial observations."""
        episodes = case.once("episodes", lambda: Episodes(case.data, case.discount, case.seed))
        ratios = log_ratios(case, self.behavior, self.model, self.log_ratio_range)
        errors, begins = case.once(("errors", self.fqe, self.samples), lambda: self._errors(case))
        begin = begins.mean(0)
        values, lows, highs, effective, redraws = [], [], [], [], []
        for i, row in enumerate(ratios):
            log_rho = episodes.cumulate(row)
            sums = episodes.sums(log_rho, errors[i], normalised=self.kind != "dr", alive_only=self.alive_only)
            total, count = (np.bincount(episodes.group, weights, episodes.groups) for weights in (begin[i], None))
            drawn = (episodes.counts @ total) / (episodes.counts @ count)
            if self.kind == "magic":
                value, redrawn, uncorrected = self._blend(episodes, sums, begin[i].mean(), drawn)
                # What is not corrected is as uncertain as the critics are among themselves, on the bootstrap's scale. Of one
                # critic that is not known, and there is no interval.
                low, high = spread(begins[:, i].mean(-1))
                noise = np.random.default_rng([case.seed, 4, i]).standard_normal(len(redrawn))
                if uncorrected > 0:
                    redrawn = redrawn + uncorrected * (high - low) / (2 * NORMAL) * noise
            else:
                value, redrawn = begin[i].mean() + sums.value(), drawn + sums.redraw(episodes.counts)
            if self.kind == "dr" and episodes.even:  # a mean over episodes, whose deviation is known
                low, high = student(begin[i] + episodes.contributions(log_rho, errors[i], whole=False))
            else:
                low, high = episodes.percentiles(redrawn, sums.effective)
            values.append(value)
            redraws.append(redrawn)
            lows.append(low)
            highs.append(high)
            effective.append(sums.effective)
        effective = np.asarray(effective)
        warnings = [*episodes.warnings(case.names, effective, beyond=True), *self.fqe.unsettled(case)]
        return Estimates(
            self.label, case.names, np.asarray(values), np.asarray(lows), np.asarray(highs), case.discount,
            redraws=np.stack(redraws, 1), effective=effective, warnings=tuple(warnings),
        )  # fmt: skip

    def _errors(self, case: Case) -> tuple[np.ndarray, np.ndarray]:
        """(policies, rows) r + discount V(s') - Q(s, a), and (members, policies, episodes) V at the initial observations."""
        data, fitted = case.data, self.fqe.fitted(case)
        now = fitted.values(data.observations, case.current_actions(self.samples))
        begins, now = now[:, :, data.starts].astype(np.float64), now.mean(0)
        following = np.empty_like(now)
        following[:, :-1] = now[:, 1:]
        ends = data.ends
        last = fitted.values(data.final_observations, case.final_actions(self.samples)).mean(0)
        unknown = ~data.usable[ends]
        following[:, ends] = np.where(np.asarray(data.terminals)[ends] | unknown, 0.0, last)
        chosen = fitted.of_actions(data.observations, data.actions).mean(0)
        errors = np.asarray(data.rewards, np.float64) + case.discount * following - chosen
        # Where nobody knows what came next, nothing is corrected.
        errors[:, ends[unknown]] = 0.0
        return errors, begins

    def _blend(self, episodes: Episodes, sums: Sums, begin: float, drawn: np.ndarray) -> tuple[float, np.ndarray, float]:
        """Corrections of several lengths, weighted so that variance plus squared bias is least.

        Returns:
            The estimate, its redraws, and the weight of no correction at all.
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
        return begin + float(x @ partial), drawn + redrawn @ x, float(x[0])
