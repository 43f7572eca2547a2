"""Marginalised importance sampling: ratios of states at each step instead of products along episodes (Xie, Ma and Wang 2019).

For observations that are few and repeat, or states that were binned. The policy's distribution over states is propagated from
step to step by transitions that are weighted with the ratio of that one step alone,

    d_{t+1}(s') = sum_s d_t(s) sum_i rho_t^i 1[s_t^i = s, s_{t+1}^i = s'] / n_t(s),
    value = sum_t discount^t sum_s d_t(s) sum_i rho_t^i 1[s_t^i = s] r_t^i / n_t(s),

where n_t(s) is the number of episodes that are in s at step t or, self-normalised, the sum of their ratios there. The variance
grows with a power of the horizon where that of products grows exponentially. It assumes the Markov property: states that omit
relevant variables bias it, but not products.

Without a horizon, there are as many steps as in the longest episode. An episode that was cut off has no transition from its
last row.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.behavior_model import PROPENSITIES, BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.features import TABLE
from deadreckon.ope.importance import log_ratios, tails_of
from deadreckon.ope.sequences import starts_of
from deadreckon.training.hyperparameters import Count, static


@dataclass(frozen=True)
class Marginal:
    """The estimate for one policy.

    Attributes:
        value: expected discounted return within the horizon, the length of the longest episode.
        scores: (episodes,) the value and each episode's influence on it, to first order; their mean is the value, and their
            variance over n that of the value.
        states: (steps, states) the policy's distribution d_t, which may sum to less than one where episodes end.
        lost: probability that reached, before the last step, states in which all logged episodes were cut off.
        ess: (steps,) effective sample size (sum w)^2 / sum w^2, in episodes, of the weights d_t(s) n rho_t / n_t(s) of each
            step, with the probability of having ended as weights of one.
        going_on: (steps,) probability that no terminal has ended the episode after each step; lost probability is included.
    """

    value: float
    scores: np.ndarray
    states: np.ndarray
    lost: float
    ess: np.ndarray
    going_on: np.ndarray


class StateMarginal(Estimator):
    """Importance sampling by the policy's distribution over states at each step, for logs whose observations are few."""

    revision: ClassVar[int] = 1

    takes_horizon = True

    normalised: bool = static(True)  # whether to divide by the sum of ratios in a state instead of the number of episodes
    behavior: Literal["auto", "logged", "learned"] = static("auto")
    """source of the propensities: the log, or a fitted model; auto: the log where it has them"""
    model: BehaviorModel = static(PROPENSITIES)  # model of the behaviour policy
    folds: Count = static(5)  # folds of cross-fitting for learned propensities; 1: one model of all episodes

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "SMIS"

    def check(self, case: OPEInput) -> None:
        """Refuses cases whose models see positions, too."""
        super().check(case)
        if case.positions:
            told = "smis cannot adjust for a behaviour policy that changed along the log or its clusters"
            raise UserError(f"{told}; use dr-linear, or --stationary if the system never changes")

    def solve(self, case: OPEInput) -> Estimates:
        """Propagates the state distribution of each policy; intervals by the influence functions of episodes."""
        data, episodes = case.data, case.episodes
        if case.table is None:
            raise UserError(
                f"smis needs discrete actions and few different observations, {TABLE // 2} with two actions, which {data.name} "
                "does not have; bin its observations, or use dr-linear or drl"
            )
        states, rewards = case.table.codes(data.observations), np.asarray(data.rewards, np.float64)
        values, influence, ess, tails, lost, share = [], [], [], [], [], []
        for row in log_ratios(case, self.behavior, self.model, None, self.folds):
            found = state_marginal(
                states, row, rewards, data.lengths, episodes.ended, case.discount, normalised=self.normalised
            )
            values.append(found.value)
            influence.append(episodes.means(found.scores)[1])
            ess.append(episodes.quartile(found.ess))
            tails.append(row)  # of single steps, which are averaged
            lost.append(found.lost)
            share.append(case.beyond_if(found.going_on))
        ess = np.asarray(ess)
        warnings = [
            *episodes.warnings(case.names, ess, ahead=case.cut_ahead),
            "SMIS assumes that states are Markov (they hold all that matters), which its interval does not include",
            *(f"{100 * part:.0f} % of the probability of {name} reaches states in which all logged episodes were cut off"
              for name, part in zip(case.names, lost) if part > TAIL),
        ]  # fmt: skip
        return Estimates.of_influence(
            self.label, case, np.asarray(values), np.stack(influence, 1), ess=ess, corrected=case.beyond <= TAIL,
            warnings=tuple(warnings), diagnostics=tails_of(case, tails) | {"lost": np.array(lost), "beyond": np.array(share)},
        )  # fmt: skip


def state_marginal(
    states: np.ndarray,
    log_ratios: np.ndarray,
    rewards: np.ndarray,
    lengths: np.ndarray,
    ended: np.ndarray,
    discount: float,
    *,
    normalised: bool = True,
) -> Marginal:
    """The value of a policy by its distribution over states at each step.

    Args:
        states: (rows,) numbers of the states, from zero.
        log_ratios: (rows,) log pi(a|s) / beta(a|s) of the logged actions.
        rewards: (rows,).
        lengths: (episodes,) rows of each episode.
        ended: (episodes,) whether it ended at its last row, or was cut off.
        discount: per step.
        normalised: divide by sums of ratios, so that transitions sum to one and rewards stay within theirs; otherwise by
            numbers of episodes, without bias but for states that no episode reached.

    Raises:
        UserError: states that are not whole numbers from zero, or columns of different lengths.
    """
    states, lengths = np.asarray(states), np.asarray(lengths)
    if not np.issubdtype(states.dtype, np.integer) or states.min(initial=0) < 0:
        raise UserError("marginal ratios need states as whole numbers from zero; bin what is continuous")
    if not len(states) == len(log_ratios) == len(rewards) == lengths.sum() or len(ended) != len(lengths):
        raise UserError(
            f"{len(states):,} states, {len(log_ratios):,} ratios and {len(rewards):,} rewards in episodes of "
            f"{lengths.sum():,} rows do not belong together"
        )
    size, steps, first = int(states.max()) + 1, int(lengths.max()), starts_of(lengths)
    rho, n = np.exp(log_ratios), len(lengths)

    def at(t: int):
        """Episodes, states, ratios, what is summed to normalise them, and rewards at a step; whether what follows is known,
        whether a row does, and its state."""
        there = np.flatnonzero(lengths > t)
        row = first[there] + t
        on = lengths[there] > t + 1
        after = np.where(on, states[np.minimum(row + 1, len(states) - 1)], 0)
        base = rho[row] if normalised else np.ones(len(row))
        return there, states[row], rho[row], base, rewards[row], on | ended[there], on, after

    def per_state(s: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.bincount(s, x, size)

    def shares(s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """(rows,) one over the sum of weights in each row's state; zero where there is none."""
        total = per_state(s, weight)
        return np.divide(1.0, total, out=np.zeros(size), where=total > 0)[s]

    reached = np.zeros((steps, size))
    reached[0] = per_state(states[first], np.ones(n)) / n
    lost, scores, ess, going_on = 0.0, np.zeros(n), np.zeros(steps), np.ones(steps)
    over = 0.0  # probability of having ended
    for t in range(steps):
        there, s, ratio, base, _, known, on, after = at(t)
        weight = n * ratio * shares(s, base) * reached[t][s]
        # Ended episodes have no rows at this step; the probability of having ended counts as that share of the episodes, each
        # with a weight of one.
        sure = weight.sum() + n * over
        ess[t] = sure**2 / max(np.square(weight).sum() + n * over, 1e-300)
        if t == steps - 1:
            going_on[t] = 1.0 - over - weight[ended[there]].sum() / n
            break
        flow = ratio * shares(s, base * known) * reached[t][s]
        reached[t + 1] = per_state(after, flow * on)
        over += float(flow[known & ~on].sum())
        going_on[t] = 1.0 - over
        gone = per_state(s, base * known) <= 0
        lost += float(reached[t][gone].sum())
    ahead = np.zeros(size)  # value of each state at the next step
    for t in reversed(range(steps)):
        there, s, ratio, base, reward, known, on, after = at(t)
        share, known_share = shares(s, base), shares(s, base * known)
        beyond = discount * on * ahead[after]
        now = per_state(s, ratio * reward * share)
        then = per_state(s, known * ratio * beyond * known_share)
        pull = share * (ratio * reward - base * now[s]) + known_share * known * (ratio * beyond - base * then[s])
        scores[there] += n * discount**t * reached[t][s] * pull
        ahead = now + then
    value = float(reached[0] @ ahead)
    return Marginal(value, scores + ahead[states[first]], reached, lost, ess, going_on)
