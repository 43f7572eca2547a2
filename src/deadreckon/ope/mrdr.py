"""Weights with which a critic minimises the doubly robust estimate's variance (Farajtabar, Chow and Ghavamzadeh 2018).

A doubly robust estimate is unbiased for any critic; the critic's errors e = Q - Q_hat determine its variance. With Q the value
of the policy, Jiang and Li 2016, theorem 1, unrolled, say that of one episode it contains

    sum_t E[discount^{2t} rho_{0:t-1}^2 Var(rho_t e(s_t, a_t) | s_t)]

and nothing else that depends on Q_hat. Given the state, the inner variance over the log's actions is the quadratic form
d' (diag(1 / beta) - 1 1') d in d_a = pi(a|s) e(s, a), which is Omega of Farajtabar et al. A log has the propensity of the
logged action, and seldom those of all other actions, which the form needs. So `log_weights` are weights of rows that keep the
form's diagonal, sum_a pi^2 (1 - beta) / beta e^2, which is the mean of rho^2 (1 - beta) e^2, and the whole of it where the
policy is deterministic: there they are (1 - beta) / beta^2. Where it is not, errors that all actions share get more weight than
they should. Without the behaviour policy's probabilities (`log_behavior` of None, as for densities) they are rho^2, for the
second moment of rho e, an upper bound of its variance.

Critics are fitted to `mrdr_targets`, the importance-weighted return from each row on, whose mean given history and action is Q.
Both weights and targets are products along episodes, so these critics are for short ones.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor

from deadreckon.errors import UserError
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.linear import PILOT, RIDGES, Fit, solved
from deadreckon.ope.linear_sums import Critic, blocks
from deadreckon.ope.sequences import cumulate, starts_of, times


def log_weights(
    log_ratios: np.ndarray, lengths: np.ndarray, discount: float, log_behavior: np.ndarray | None = None
) -> np.ndarray:
    """(rows,) logarithms of the weights discount^{2t} rho_{0:t}^2 (1 - beta(a_t|s_t)) of squared errors.

    Args:
        log_ratios: (rows,) log pi(a|s) / beta(a|s) of the logged actions.
        lengths: (episodes,) rows of each episode.
        discount: per step; with 0 only first steps have a weight.
        log_behavior: (rows,) log beta(a|s) for discrete actions; None leaves the factor 1 - beta out.
    """
    fade = discount ** times(lengths).astype(float)
    # Logarithms of zero are minus infinity, without a warning.
    with np.errstate(divide="ignore"):
        logs = 2 * cumulate(log_ratios, lengths) + 2 * np.log(fade)
        if log_behavior is not None:
            logs = logs + np.log1p(-np.minimum(np.exp(log_behavior), 1.0))
    return logs


def mrdr_targets(log_ratios: np.ndarray, rewards: np.ndarray, lengths: np.ndarray, discount: float) -> np.ndarray:
    """(rows,) returns from each row on, r_t + discount rho_{t+1} (r_{t+1} + discount rho_{t+2} (...)), in units of the reward.

    Farajtabar et al. 2018, section 3.2. The row's own ratio is not in it. Nothing follows an episode's last row.

    Args:
        log_ratios: (rows,) log pi(a|s) / beta(a|s) of the logged actions.
        rewards: (rows,).
        lengths: (episodes,) rows of each episode.
        discount: per step.
    """
    first, rho = starts_of(lengths), np.exp(log_ratios)
    ahead = np.zeros(len(lengths))  # from the next row on, with its ratio
    targets = np.empty(len(rewards))
    for back in range(1, int(lengths.max()) + 1):
        there = np.flatnonzero(lengths >= back)
        row = first[there] + lengths[there] - back
        targets[row] = rewards[row] + discount * ahead[there]
        ahead[there] = np.where(rho[row] == 0.0, 0.0, rho[row] * targets[row])
    return targets


def out_of_fold(
    case: OPEInput, fit: Fit, folds: int, propensities: Callable[[OPEInput], tuple[np.ndarray, np.ndarray | None]]
) -> OutOfFold:
    """Predictions of critics of least variance, linear in the features of `fit`, for episodes they were not trained on.

    With a horizon there is one critic for each step, as a value then depends on the steps to go. Each has the ridge that is
    best in cross-validation over its training groups.

    Args:
        case: log and policies.
        fit: features, and the computation of the critics' errors.
        folds: number of parts of the evaluated episodes; the critics of one are trained on the others and on all episodes that
            are not evaluated.
        propensities: returns the (policies, rows) log-ratios of a case and, for discrete actions, (rows,) log beta.

    Raises:
        UserError: episodes are cut off with much discounted time remaining, so their returns are not known.
    """
    teach, fold = case.teaching(), case.folds(folds)
    sources = [case] if teach is None else [case, teach]
    folds = int(fold.max()) + 1
    for each in sources:
        if each.cut_ahead > TAIL:
            cut = (~each.episodes.ended).sum()
            raise UserError(
                f"{case.data.name}: mrdr is fitted to returns, and {cut:,} episodes are cut off before theirs is known; "
                "give a horizon, or use dr-linear or drl"
            )
    join = lambda of: np.concatenate([np.asarray(of(each)) for each in sources])  # noqa: E731
    told = [propensities(each) for each in sources]
    lengths, rewards = join(lambda c: c.data.lengths), join(lambda c: c.data.rewards).astype(float)
    known = [logged for _, logged in told if logged is not None]
    behavior = np.concatenate(known) if known else None
    group = np.concatenate([fold[case.data.episode_of], *(np.full(len(each.data), folds) for each in sources[1:])])
    step = times(lengths) if fit.horizon is not None else np.zeros(len(group), int)
    steps, begin = fit.horizon or 1, np.cumsum([0, *(len(each.data) for each in sources)])

    weights, targets = np.zeros((2, case.count, len(group)))
    out = OutOfFold.empty(case.count, case.data.episodes, len(case.data), marginal=False)
    for i in range(case.count):
        ratios = np.concatenate([own[i] for own, _ in told])
        with np.errstate(over="ignore", invalid="ignore"):
            target = mrdr_targets(ratios, rewards / fit.std, lengths, case.discount)
        out.settled[i] = np.isfinite(target).all()
        if not out.settled[i]:
            continue
        logs = log_weights(ratios, lengths, case.discount, behavior)
        top = np.full(steps, -np.inf)
        np.maximum.at(top, step, logs)
        # Relative to their mean at each step, so that the ridge is in rows. Steps without any weight keep weights of zero.
        own = np.exp(logs - np.where(np.isfinite(top), top, 0.0)[step])
        mean = np.bincount(step, own, steps) / np.maximum(np.bincount(step, minlength=steps), 1)
        weights[i] = own / np.maximum(mean, 1e-300)[step]
        targets[i] = np.where(own > 0, target, 0.0)

    d, groups = fit.features.size, int(group.max()) + 1
    theta = np.zeros((folds, case.count, steps, d))
    for t in range(steps):
        gram, moment = np.zeros((case.count, groups, d, d)), np.zeros((case.count, groups, d))
        for each, first in zip(sources, begin):
            own = slice(first, first + len(each.data))
            for g in range(groups):
                for part in blocks(np.flatnonzero((step[own] == t) & (group[own] == g))):
                    phi = fit.features.taken(each.data.observations[part], each.data.actions[part]).astype(float)
                    for i in range(case.count):
                        weighted = phi * weights[i, own][part][:, None]
                        gram[i, g] += weighted.T @ phi
                        moment[i, g] += weighted.T @ targets[i, own][part]
        for k in range(folds):
            others = np.delete(np.arange(groups), k)
            theta[k, :, t] = [_solve(gram[i, others], moment[i, others], fit) for i in range(case.count)]
    for k in range(folds):
        # The first weights of a `Critic` are those with one step to go.
        critics = [Critic(own[::-1], own[::-1], 0.0, bool(ok)) for own, ok in zip(theta[k], out.settled)]
        fit.tell(out, fold, k, critics)
    return out


def _solve(gram: np.ndarray, moment: np.ndarray, fit: Fit) -> np.ndarray:
    """(d,) least squares by sums over (groups, d, d) and (groups, d), with the ridge that predicts left-out groups best."""
    whole, right, errors = gram.sum(0), moment.sum(0), np.zeros(len(RIDGES))
    if fit.given is None and len(gram) > 1:
        for own, target in zip(gram, moment):
            for j, ridge in enumerate(RIDGES):
                found = solved(cho_factor(fit.penalised(whole - own, ridge)), right - target)
                errors[j] += found @ own @ found - 2 * found @ target
    ridge = fit.given if fit.given is not None else RIDGES[int(np.argmin(errors))] if len(gram) > 1 else PILOT
    return solved(cho_factor(fit.penalised(whole, ridge)), right)
