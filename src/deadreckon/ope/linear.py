"""Linear fitted Q evaluation: a critic that is linear in fixed features, solved exactly instead of by gradient descent.

    theta = (Phi' Phi + ridge)^-1 Phi' (r + discount Phi_next theta)

is its fixed point (LSTD-Q: Lagoudakis and Parr 2003; as fitted Q evaluation: Duan, Jia and Wang 2020). With a horizon it is
iterated from zero as often as steps are left, so that there is a critic for each number of steps to go. The same sums of
features solve it for every fold and every resample of the log, so that critics out of fold, many bootstrap samples (Hao et al.
2021) and ratios of occupancies, which are linear in the same features, cost little more than one fit.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.features import Features
from deadreckon.ope.linear_sums import BLOCK, SUMMED, Critic, Sums, blocks
from deadreckon.randomness import generator
from deadreckon.stats.bootstrap import percentile_interval, resample_counts
from deadreckon.training.hyperparameters import Count, Positive, static

RIDGES = 10.0 ** np.arange(-1, 6)  # candidate strengths of the penalty, in rows
PILOT = 10.0
DOUBLINGS = 22  # 2^22 steps approximate an infinite sum
GROWN = 1e6  # largest entry of the powers of the backup above which it diverges
PARTS = 5  # folds of the training episodes in the cross-validation of the ridge
N_BOOTSTRAP = 200
GROUPS = 100  # most groups of units that the bootstrap resamples
ROOM = 1e9  # bytes of sums above which there are fewer groups
# Most rows of not evaluated episodes on which critics out of fold are also trained: a few hundred weights need far fewer, and
# every row costs as many feature vectors as there are policies and samples. Evaluated rows are all used.
TAUGHT = 40_000


class LinearFQE(Estimator):
    """Fitted Q evaluation that is linear in features of observation and action."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"cosines": "fourier_features", "redraws": "n_bootstrap"}

    fourier_features: Count = static(256)  # random Fourier features, where the log has more than a few distinct observations
    samples: Count = static(10)  # actions sampled at each observation, for continuous actions
    n_bootstrap: Count = static(N_BOOTSTRAP)  # bootstrap resamples of the log for the interval
    ridge: Positive | None = static(None)  # strength of the ridge penalty, in transitions; None: by cross-validation

    takes_horizon = True

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "FQE-linear"

    def solve(self, case: OPEInput) -> Estimates:
        """Mean value of the initial observations; intervals by resampling the log and solving again."""
        fit = Fit(self, case)
        rng = generator(case.seed, "linear critics")
        units = case.units
        count = int(units.max()) + 1
        most = max(20, min(GROUPS, int(ROOM / (8 * case.count * fit.features.size**2))))
        group = rng.permutation(np.arange(count) % min(count, most))[units]
        groups = int(group.max()) + 1
        sums = fit.sums(case, group, groups)
        once = np.ones(groups)
        ridges = [fit.ridge(sums, i, None) for i in range(case.count)]
        counts = resample_counts(rng, groups, self.n_bootstrap)
        values, bootstrap, warnings = np.empty(case.count), np.empty((self.n_bootstrap, case.count)), []
        settled = np.ones(case.count)
        for i in range(case.count):
            critic = fit.critic(sums, once, i, ridges[i])
            if not critic.settled:
                settled[i] = 0.0
                warnings.append(f"{self.label}: the backup of {case.names[i]} diverges on this log's features")
            values[i] = sums.start[:, i].sum(0) @ critic.weights[-1] / sums.episodes.sum() * fit.std
            for b, weight in enumerate(counts):
                bootstrap[b, i] = fit.value(sums, weight, i, critic.ridge)
        low, high = np.array([percentile_interval(each, groups) for each in bootstrap.T]).T
        return Estimates(
            self.label, case.names, values, low, high, case.estimand, bootstrap=bootstrap, units=groups,
            diagnostics={"settled": settled},
            warnings=(*warnings, "its interval includes the variance of the log, but not the bias of the features"),
        )  # fmt: skip


class Last(NamedTuple):
    """The solution with one step to go, where only the immediate reward counts.

    Attributes:
        base: (size,) weights of the value.
        solve: function from (size,) mean features of an occupancy to (size,) weights of its ratio over the rows.
        rows: number of rows.
    """

    base: np.ndarray
    solve: Callable[..., Any]
    rows: float


def solved(factor: Any, right: np.ndarray) -> np.ndarray:
    """The solution of a penalised system by its Cholesky factor, as an array for type checkers."""
    return np.asarray(cho_solve(factor, right))


def _inverse_counts(gram: np.ndarray) -> np.ndarray:
    """(size,) one over the number of rows of each cell of a table, and zero where there are none."""
    count = np.diag(gram)
    return np.divide(1.0, count, out=np.zeros_like(count), where=count > 0)


class Fit:
    """Critics of a case's policies by folds, shared by the estimator and doubly robust ones.

    Args:
        estimator: settings.
        case: log and policies.
    """

    def __init__(self, estimator: LinearFQE, case: OPEInput):
        self.case = case
        self.given = estimator.ridge
        self.samples = estimator.samples
        count = estimator.fourier_features
        self.features = case.once(("features", count), lambda: Features(case.log, count, case.seed, case.table))
        self.std = float(case.log.spec.reward.std) or 1.0
        self.horizon = case.estimand.horizon
        self.counts_next = case.discount > 0 and self.horizon != 1 and not np.asarray(case.log.terminals).all()
        self._factors: dict[tuple[bytes, float, int], Any] = {}  # shared by policies

    def next_actions(self, case: OPEInput) -> np.ndarray | None:
        """Table of the policies' actions after each row; None if only immediate rewards count."""
        return case.next_actions(self.samples) if self.counts_next else None

    # ---- sums ---------------------------------------------------------------------------------------------------------

    def sums(self, case: OPEInput, group: np.ndarray, groups: int, *, start: bool = True) -> Sums:
        """Sums over the episodes of `case.data` by their (episodes,) group; without `start`, none of initial observations."""
        data, d, count = case.data, self.features.size, case.count
        out = Sums(
            np.zeros((groups, d, d)), np.zeros((groups, count, d, d)), np.zeros((groups, d)), np.zeros((groups, count, d)),
            np.zeros(groups), np.bincount(group, minlength=groups).astype(float),
            np.zeros((groups, 2, d, d)), np.zeros((groups, 2, d)), np.zeros((groups, 2)), count - 1 if case.logged else -1,
        )  # fmt: skip
        after, first = self.next_actions(case), case.initial_actions(self.samples) if start else None
        of_row = group[data.episode_of]
        for g in range(groups):
            rows = np.flatnonzero(of_row == g)
            out.rows[g] = len(rows)
            for part in blocks(rows):
                phi = self.features.taken(data.observations[part], data.actions[part])
                out.gram[g] += phi.T @ phi
                reward = np.asarray(data.rewards[part], np.float32) / np.float32(self.std)
                out.reward[g] += phi.T @ reward
                unknown = ~case.followed[part]
                for kind, lost in enumerate((unknown, unknown | ~case.shown[part])):
                    if lost.any():
                        out.lost_gram[g, kind] += phi[lost].T @ phi[lost]
                        out.lost_reward[g, kind] += phi[lost].T @ reward[lost]
                        out.lost_rows[g, kind] += lost.sum()
                goes_on = ~case.ended[part] & ~unknown
                if goes_on.any() and after is not None:
                    own = part[goes_on]
                    follows = self.features.expected(data.next_observations_at(own), after[own])
                    for i in range(count):
                        shown = case.shown[own] if i == out.logged else np.ones(len(own), bool)
                        out.next[g, i] += phi[goes_on][shown].T @ follows[shown, i]
            if first is None:
                continue
            for part in blocks(np.flatnonzero(group == g)):
                seen = data.observations[data.starts[part]]
                out.start[g] += self.features.expected(seen, first[part]).sum(0, dtype=np.float64)
        return out

    # ---- solving ------------------------------------------------------------------------------------------------------

    def ridge(self, sums: Sums, policy: int, groups: Sequence[int] | None) -> float:
        """The ridge that predicts one backup of a preliminary critic's values best, by cross-validation over groups."""
        if self.given is not None:
            return self.given
        groups = range(len(sums.rows)) if groups is None else groups
        parts = [part for part in np.array_split(np.asarray(groups), min(PARTS, len(groups))) if len(part)]
        if len(parts) < 2:
            return PILOT
        weight = np.zeros(len(sums.rows))
        weight[list(groups)] = 1.0
        pilot = self.critic(sums, weight, policy, PILOT).weights[-1]
        every_gram, every_reward, _ = sums.whole(policy)
        gram, following, reward = (np.tensordot(weight, x, 1) for x in (every_gram, sums.next[:, policy], every_reward))
        target = reward + self.case.discount * following @ pilot
        errors, kind = np.zeros(len(RIDGES)), sums.kind(policy)
        for part in parts:
            own_gram = every_gram[part].sum(0)
            own = every_reward[part].sum(0) + self.case.discount * sums.next[part, policy].sum(0) @ pilot
            for j, ridge in enumerate(RIDGES):
                rows = weight.tobytes() + np.asarray(part).tobytes()
                factor = self._factor(gram - own_gram, ridge, rows, kind)
                theta = solved(factor, target - own)
                errors[j] += theta @ own_gram @ theta - 2 * theta @ own
        return float(RIDGES[int(np.argmin(errors))])

    def critic(self, sums: Sums, weight: np.ndarray, policy: int, ridge: float) -> Critic:
        """Solves for one policy, with (groups,) `weight` of each group; a ridge with which it diverges is increased."""
        gram, following, reward, start, rows = sums.of(weight, policy)
        while True:
            factor = self._factor(gram, ridge, weight.tobytes(), sums.kind(policy))
            base, backup = solved(factor, reward), self.case.discount * solved(factor, following)
            solve, onward = partial(solved, factor), backup
            if self.features.table is not None:
                # Ratios in a table are not penalised: the penalty would reduce the mass at every step, and would give ratios to
                # cells without rows.
                once = _inverse_counts(gram)
                solve, onward = partial(np.multiply, once), self.case.discount * once[:, None] * following
            if self.horizon is not None:
                last = Last(base, solve, rows)
                if sums.lacks_rows(policy):
                    last = self._last(sums, weight, ridge)
                found = self._steps(solve, following, base, backup, start, last, ridge)
            else:
                found = self._endless(solve, base, backup, onward, start, rows, ridge)
            if found.settled or ridge > RIDGES[-1] or self.given is not None:
                return found
            ridge *= 10.0

    def value(self, sums: Sums, weight: np.ndarray, policy: int, ridge: float) -> float:
        """The value alone, for bootstrap samples: one solution of the linear system."""
        gram, following, reward, start, _ = sums.of(weight, policy)
        penalised = self.penalised(gram, ridge)
        if self.horizon is None:
            theta = np.linalg.solve(penalised - self.case.discount * following, reward)
        else:
            factor = cho_factor(penalised)
            base, backup = solved(factor, reward), self.case.discount * solved(factor, following)
            theta = base
            if sums.lacks_rows(policy):
                every, paid, _ = sums.of_all(weight)
                theta = solved(cho_factor(self.penalised(every, ridge)), paid)
            for _ in range(self.horizon - 1):
                theta = base + backup @ theta
        return float(start @ theta) * self.std

    def _last(self, sums: Sums, weight: np.ndarray, ridge: float) -> Last:
        """The solution with one step to go, by all rows."""
        gram, reward, rows = sums.of_all(weight)
        factor = self._factor(gram, ridge, b"all" + weight.tobytes(), 0)
        solve = partial(solved, factor) if self.features.table is None else partial(np.multiply, _inverse_counts(gram))
        return Last(solved(factor, reward), solve, rows)

    def _steps(self, solve, following, base, backup, start, last, ridge) -> Critic:
        assert self.horizon is not None
        theta, weights = last.base, [last.base]
        occupancy, ratios, fade = start, [], 1.0
        for _ in range(self.horizon - 1):
            theta = base + backup @ theta
            weights.append(theta)
        for left in range(self.horizon, 0, -1):
            projected = (solve if left > 1 else last.solve)(occupancy)
            ratios.append(last.rows * fade * projected)
            occupancy = following.T @ projected
            fade *= self.case.discount
        found = np.stack(weights), np.stack(ratios)
        bound = 10.0 * self.horizon * max(1.0, float(np.abs(base).max()))
        return Critic(*found, ridge, bool(np.isfinite(found[0]).all() and np.abs(found[0]).max() < GROWN * bound))

    def _endless(self, solve, base, backup, onward, start, rows, ridge) -> Critic:
        theta, occupancy, power, other = base, start, backup, onward
        size = np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(DOUBLINGS):
                theta = theta + power @ theta
                occupancy = occupancy + other.T @ occupancy
                alike, power = other is power, power @ power
                other = power if alike else other @ other
                size = np.abs(power).max()
                if not size < GROWN or size < 1e-12:
                    break
        settled = bool(size < 1e-3) if self.case.discount < 1.0 else bool(size < GROWN)
        ratios = rows * solve(occupancy)
        return Critic(theta[None], ratios[None], ridge, settled and bool(np.isfinite(theta).all()))

    # ---- out of fold --------------------------------------------------------------------------------------------------

    def out_of_fold(self, folds: int, *, marginal: bool) -> OutOfFold:
        """Predictions of critics for episodes that they were not trained on.

        Args:
            folds: number of parts of the evaluated episodes; the critics of one are trained on the others and on all episodes
                that are not evaluated. 1: on all episodes, including those that they evaluate, as in the public code.
            marginal: also the ratios of occupancies, by the same folds.
        """
        case, in_sample = self.case, folds == 1
        fold = case.folds(PARTS if in_sample else folds)  # without cross-fitting, folds only choose the ridge
        folds = int(fold.max()) + 1
        # The same for all doubly robust estimators of a case; computing it takes most of their time.
        key = ("sums", self.features.cosines, self.samples, folds, marginal)
        judged: Sums = case.once(key, lambda: self._judged_and_taught(fold, folds, marginal))
        taught = range(folds, len(judged.rows))  # groups that are not evaluated, if any
        count = case.count
        out = OutOfFold.empty(count, case.data.episodes, len(case.data), marginal)
        ridges: dict[tuple[int, int], float] = {}
        every = []
        own = np.zeros_like(fold) if in_sample else fold
        for k in range(int(own.max()) + 1):
            weight = np.ones(len(judged.rows))
            weight[k] = float(in_sample)
            others = [g for g in range(folds) if weight[g]]
            critics = []
            for i in range(count):
                key = (i, -1 if taught else k)
                if key not in ridges:
                    ridges[key] = self.ridge(judged, i, taught or others)
                critics.append(self.critic(judged, weight, i, ridges[key]))
            every.append(np.stack([critic.weights[-1] for critic in critics]))
            self.tell(out, own, k, critics)
        if in_sample:
            return out
        left_out = case.data.episodes / folds / float(judged.episodes.sum())
        return replace(out, by_fold=lambda: self._begins(np.stack(every)), left_out=left_out)

    def _begins(self, weights: np.ndarray) -> np.ndarray:
        """(folds, policies) mean values of all initial observations by critics (folds, policies, features)."""
        data, first = self.case.data, self.case.initial_actions(self.samples)
        total = np.zeros(weights.shape[1:])
        for part in blocks(np.arange(data.episodes)):
            total += self.features.expected(data.observations[data.starts[part]], first[part]).sum(0, dtype=np.float64)
        return self.std * np.einsum("kid,id->ki", weights, total / data.episodes)

    def _judged_and_taught(self, fold: np.ndarray, folds: int, start: bool) -> Sums:
        """Sums over the evaluated episodes by fold, followed by those over the others, if any, in `PARTS` groups."""
        judged, teach = self.sums(self.case, fold, folds, start=start), self.case.teaching(TAUGHT)
        if teach is None:
            return judged
        part = generator(self.case.seed, "teaching parts").permutation(np.arange(teach.data.episodes) % PARTS)
        more = self.sums(teach, part, PARTS, start=start)
        both: dict[str, Any] = {name: np.concatenate([getattr(judged, name), getattr(more, name)]) for name in SUMMED}
        return replace(judged, **both)

    def tell(self, out: OutOfFold, fold: np.ndarray, k: int, critics: Sequence[Critic]) -> None:
        """Stores the predictions of one fold's critics for its episodes, and their errors on some of their training rows.

        Args:
            out: the result that is filled in.
            fold: (episodes,) fold of each.
            k: the fold that the critics were not trained on.
            critics: one per policy.
        """
        case, data, marginal = self.case, self.case.data, out.weighted is not None
        after, first = self.next_actions(case), case.initial_actions(self.samples)
        out.settled &= [critic.settled for critic in critics]
        for part in blocks(np.flatnonzero(fold == k)):
            phi = self.features.expected(data.observations[data.starts[part]], first[part])
            for i, critic in enumerate(critics):
                out.begins[i, part] = self.std * (phi[:, i] @ critic.weights[-1])

        def errors(part: np.ndarray, marginal: bool) -> Iterator[dict[str, np.ndarray]]:
            phi = self.features.taken(data.observations[part], data.actions[part])
            if after is None:
                return (self._errors(part, phi, None, critic, marginal) for critic in critics)
            follows = self.features.expected(data.next_observations_at(part), after[part])
            return (
                self._errors(part, phi, follows[:, i], critic, marginal, case.names[i] == LOGGED)
                for i, critic in enumerate(critics)
            )

        of_row = fold[data.episode_of]
        for part in blocks(np.flatnonzero(of_row == k)):
            for i, found in enumerate(errors(part, marginal)):
                for name, values in found.items():
                    getattr(out, name)[i, part] = values
        seen = np.flatnonzero(of_row == (k + 1) % (int(fold.max()) + 1))  # a block of these is enough
        seen = np.sort(generator(case.seed, "fitted rows", k).choice(seen, min(len(seen), BLOCK), replace=False))
        for i, found in enumerate(errors(seen, False)):
            out.fitted[i] += np.square(found["errors"]).mean() / (int(fold.max()) + 1)

    def _errors(
        self,
        part: np.ndarray,
        phi: np.ndarray,
        follows: np.ndarray | None,
        critic: Critic,
        marginal: bool,
        logged: bool = False,
    ) -> dict[str, np.ndarray]:
        """r + discount V(s') - Q(s, a) of rows and, if `marginal`, its sum weighted by the ratio of occupancies.

        It is zero where the next observation or, for the behaviour policy (`logged`), its next action is not known.

        Values are not clipped to the range of returns: V has to be the mean of Q over the policy's actions, or the estimate is
        biased.

        `follows`, the features at next observations, is None if only immediate rewards count.
        """
        case, discount = self.case, self.case.discount
        rewards = np.asarray(case.data.rewards[part], np.float64)
        known, goes_on = case.followed[part], ~case.ended[part]
        if logged:
            known = known & case.shown[part]
        q = phi @ critic.weights.T  # (rows, steps)
        following = np.zeros_like(q) if follows is None else follows @ critic.weights.T
        if self.horizon is None:
            error = np.where(known, rewards + self.std * (discount * following[:, 0] * goes_on - q[:, 0]), 0.0)
            found = {"errors": error}
            if marginal:
                weight = phi @ critic.ratios.T
                found |= {"weighted": weight[:, 0] * error, "weights": weight[:, 0] / case.effective_horizon}
                found["mass"] = weight[:, 0] * (1.0 - discount * goes_on)
            return found
        time, rows, last = case.time[part], np.arange(len(part)), self.horizon - 1
        every_q = self.std * q  # with 1, 2, ... steps to go
        every_v = self.std * np.concatenate([np.zeros((len(part), 1)), following[:, :-1]], 1)
        every_v *= goes_on[:, None]
        # Where the horizon ends an episode, the next observation does not count, whether it is known or not.
        left = last - time
        error = rewards + discount * every_v[rows, left] - every_q[rows, left]
        found = {"errors": np.where(known | (left == 0), error, 0.0)}
        if marginal:
            weight = phi @ critic.ratios.T  # the last step by all rows, others by those with a known successor
            weight[:, :-1] *= known[:, None]
            every = np.where(known[:, None], rewards[:, None] + discount * every_v - every_q, 0.0)  # by steps to go
            every[:, 0] = rewards - every_q[:, 0]
            found |= {"weighted": (weight * every[:, ::-1]).sum(1), "weights": weight.sum(1) / case.effective_horizon}
            found["mass"] = weight[:, :-1].sum(1) * (1.0 - discount * goes_on) + weight[:, -1]
        return found

    def _factor(self, gram: np.ndarray, ridge: float, rows: bytes, kind: int) -> Any:
        """The Cholesky factor of a penalised Gram matrix, computed once for each choice of rows, which `rows` identifies, and
        for each kind of `Sums.kind`."""
        key = (rows, ridge, kind)
        if key not in self._factors:
            self._factors[key] = cho_factor(self.penalised(gram, ridge))
        return self._factors[key]

    def penalised(self, gram: np.ndarray, ridge: float) -> np.ndarray:
        """A Gram matrix with the ridge, in rows.

        The constant is not penalised, so that fitted values have the mean of their targets. Otherwise each backup would lose a
        share of the value, and a long sum of rewards most of it.
        """
        size = len(gram)
        out = gram + ridge * np.eye(size)
        if self.features.table is None:
            out[0, 0] += 1e-6 - ridge
        else:  # the constant is the sum of all features
            out += (1e-6 - ridge / size) * np.ones((size, size))
        return out
