"""Rules that choose a policy of a log or none, each an answer about the same policies.

`old_*` decide as the package did at 531dcab: by an estimate of each gain over the log's own policy with an interval of 95 % for
all policies at once (Bonferroni), where weights rest on ten episodes and the log shows half of the actions. Its first estimator
was fitted Q evaluation with three members; here it has that where the log does not tell its probabilities, and importance
sampling per decision with Student's interval, which is what it had to offer for these, where it does; `old_fqe` has the first
everywhere. Weights rest on as many episodes as the products over whole episodes amount to. The rule is kept here because the
package has it no more. `old_level` and `old_fqe` were added after the confirmatory logs had been decided by the others.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.ope import OPEInput
from deadreckon.ope.basis import UNITS
from deadreckon.ope.case import CrossFitted
from deadreckon.ope.decide import decide
from deadreckon.stats.means import student
from decision_study.fqe import fqe
from decision_study.learn import learned
from decision_study.problem import Problem

ALPHA = 0.05
FIRST_LOOK = 0.025  # of it that the package spends when a split is looked at for the first time
FOLDS = 5  # of a cross-fit
CROSS = 50  # episodes of one step, or clusters of them, below which it is better than a fifth that is held out
TENTH = 0.1  # of the held-out standard error, which the truth's may be
FEW, MOSTLY, LEVEL = 10.0, 0.5, 0.99  # episodes that weights rest on; share of actions that are shown; what counts as shown


@dataclass(frozen=True)
class Verdict:
    """What a rule says.

    Attributes:
        choice: the policy to deploy, by its place; None: none of them.
        gain, low, high: (policies,) estimates of the gains, and intervals that hold for all at once; infinite: it has none.
        why: in one line, where it says more.
        told: (policies,) whether it said that the log has no support for what a policy does; None: it does not look.
        true: (policies,) true gains of the policies that it judged, where these are not the task's own.
    """

    choice: int | None
    gain: np.ndarray
    low: np.ndarray
    high: np.ndarray
    why: str = ""
    told: np.ndarray | None = None
    true: np.ndarray | None = None


@dataclass
class Task:
    """What a rule may look at, and for the oracle more.

    Attributes:
        problem: the log and what is asked of it.
        policies: by name.
        learning, held: the log's parts: where the policies were learned, and the rest.
        hidden: what only the world may see of `held`.
        clone: behaviour cloning of the learning part, a model of the log's own policy.
        seed: of everything random.
    """

    problem: Problem
    policies: Mapping[str, Any]
    learning: Dataset
    held: Dataset
    hidden: Mapping[str, np.ndarray]
    clone: Any
    seed: int

    @cached_property
    def on_learning(self) -> np.ndarray:
        """(members, policies + 1) fitted Q evaluation of the learning part."""
        return fqe(self.learning, list(self.policies.values()), self.problem.estimand.discount, self.seed)

    @cached_property
    def on_held(self) -> np.ndarray:
        """The same of the held-out part."""
        return fqe(self.held, list(self.policies.values()), self.problem.estimand.discount, self.seed)

    @cached_property
    def scores(self) -> np.ndarray:
        """(policies, units) what the world knows of the held-out episodes or clusters; the oracle's alone."""
        world = self.problem.world
        return units(self, np.stack([world.scores(policy, self.held, self.hidden) for policy in self.policies.values()]))

    @cached_property
    def truth(self) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """(policies,) true gains and their errors, the value of the log's own policy, and held-out standard errors."""
        each = self.scores
        error = each.std(1, ddof=1) / np.sqrt(each.shape[1]) if each.shape[1] > 1 else np.full(len(each), np.inf)
        plain = self.held.returns(self.problem.estimand.discount).std() / np.sqrt(self.held.episodes)
        policies = list(self.policies.values())
        # What is known for certain of a policy that draws nothing is no measure of what a log tells of it.
        error = np.where([policy.draws for policy in policies], error, plain)
        gains, wrong, own = self.problem.world.gains(policies, TENTH * error)
        if self.problem.null:
            gains, wrong = np.zeros(len(gains)), np.zeros(len(gains))
        return gains, wrong, own, error

    def without_better(self) -> "Task":
        """The same with those candidates alone that are not better than the log's own policy, where there are some."""
        kept = [name for name, gain in zip(self.policies, self.truth[0]) if gain <= 0]
        policies = {name: self.policies[name] for name in kept or self.policies}
        return Task(self.problem, policies, self.learning, self.held, self.hidden, self.clone, self.seed)


# ---- importance sampling ------------------------------------------------------------------------------------------------


def log_ratios(task: Task, log: Dataset) -> np.ndarray:
    """(policies, rows) of the logged actions, by the log's own probabilities or those of the clone."""
    if task.problem.known:
        own = log.extras["behavior_log_probs"]
    else:
        own = task.clone.log_prob(log.observations, log.actions)
    never = np.full(len(log), -np.inf)  # a policy that draws nothing never does what the log did
    each = [policy.log_prob(log.observations, log.actions) if policy.draws else never for policy in task.policies.values()]
    with np.errstate(invalid="ignore"):
        return np.stack([one - own for one in each])


def cumulated(log: Dataset, ratios: np.ndarray) -> np.ndarray:
    """(policies, rows) products over each episode so far."""
    finite = np.where(np.isneginf(ratios), -1e6, ratios)
    total = np.cumsum(finite, 1)
    before = np.where(log.starts > 0, total[:, log.starts - 1], 0.0)
    return np.exp(np.minimum(total - np.repeat(before, log.lengths, 1), 300.0))


def per_decision(task: Task, log: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """(policies, episodes) differences to the log's own return, and (policies,) episodes that the weights amount to."""
    rho = cumulated(log, log_ratios(task, log))
    worth = task.problem.estimand.discount ** (np.arange(len(log)) - log.starts[log.episode_of]) * log.rewards
    sums = [np.bincount(log.episode_of, (one - 1.0) * worth, log.episodes) for one in rho]
    last = rho[:, log.ends]
    effective = np.square(last.sum(1)) / np.maximum(np.square(last).sum(1), 1e-300)
    return np.stack(sums), effective


def weighted(task: Task) -> np.ndarray:
    """(policies,) gains by weighted importance sampling per decision on the learning part."""
    log = task.learning
    rho = cumulated(log, log_ratios(task, log))
    time = np.arange(len(log)) - log.starts[log.episode_of]
    steps, discount = int(log.lengths.max()), task.problem.estimand.discount
    found = []
    for one in (*rho, np.ones(len(log))):
        # An ended episode keeps its last weight.
        final = np.bincount(log.lengths, one[log.ends], steps + 1)[:steps]
        total = np.bincount(time, one, steps) + np.cumsum(final)
        gained = np.bincount(time, one * log.rewards, steps) * discount ** np.arange(steps)
        found.append(np.divide(gained, total, out=np.zeros(steps), where=total > 0).sum())
    return np.array(found[:-1]) - found[-1]


# ---- rules --------------------------------------------------------------------------------------------------------------


def shown(task: Task, log: Dataset) -> np.ndarray:
    """(policies,) share of what each does that the clone of the log finds as likely as it finds 99 % of what was logged."""
    clone, rng = task.clone, np.random.default_rng([task.seed, 7])
    told = clone.log_prob(log.observations, log.actions)
    rank = int(np.ceil(LEVEL * (len(told) + 1)))
    if rank > len(told):
        return np.ones(len(task.policies))
    bound = np.sort(told)[len(told) - rank]
    if isinstance(log.action_space, Discrete):
        likely = np.log(clone.probs(log.observations) + 1e-300) >= bound
        return np.array([(policy.probs(log.observations) * likely).sum(1).mean() for policy in task.policies.values()])
    drawn = [policy.fn(log.observations, rng) for policy in task.policies.values()]
    return np.array([(clone.log_prob(log.observations, each) >= bound).mean() for each in drawn])


def _old(
    task: Task, log: Dataset, members: Callable[[], np.ndarray], alpha: float = ALPHA, weights: bool | None = None
) -> Verdict:
    """By `weights`, where propensities are logged (None), or by the `members` of an ensemble."""
    count = len(task.policies)
    if task.problem.known if weights is None else weights:
        each, effective = per_decision(task, log)
        gain = each.mean(1)
        alone = np.array([student(one, alpha) for one in each])
        together = np.array([student(one, alpha / count) for one in each])
        sure = alone[:, 0]
    else:
        found = members()
        draws, effective = found[:, :-1] - found[:, -1:], np.full(count, np.inf)
        gain, spread = draws.mean(0), draws.std(0, ddof=1) * np.sqrt(1.0 + 1.0 / len(draws))
        half = special.stdtrit(len(draws) - 1, 1 - alpha / count / 2) * spread
        together = np.stack([gain - half, gain + half], 1)
        sure = gain
    rests, covered = effective >= FEW, shown(task, log) >= MOSTLY
    together = np.where((effective > 1e-9)[:, None], together, [[-np.inf, np.inf]])
    best = max(range(count), key=lambda i: (bool(np.isfinite(gain[i])), int(rests[i]) + int(covered[i]), sure[i]))
    deploys = rests[best] and covered[best] and np.isfinite(together[best, 0]) and together[best, 0] > 0
    return Verdict(best if deploys else None, gain, *together.T)


def old_train(task: Task) -> Verdict:
    """531dcab's rule on the rows that the policies were learned from, as it was used."""
    return _old(task, task.learning, lambda: task.on_learning)


def old_held(task: Task) -> Verdict:
    """The same on rows that they were not learned from."""
    return _old(task, task.held, lambda: task.on_held)


def old_level(task: Task) -> Verdict:
    """The same at the level of the package's first look."""
    return _old(task, task.held, lambda: task.on_held, FIRST_LOOK)


def old_fqe(task: Task) -> Verdict:
    """531dcab's rule as its command line had it, fitted Q evaluation first, on rows that policies were not learned from."""
    return _old(task, task.held, lambda: task.on_held, weights=False)


def units(task: Task, scores: np.ndarray) -> np.ndarray:
    """(policies, units) scores of episodes as those of clusters, on the same scale: their mean is that of the episodes."""
    if task.problem.cluster is None:
        return scores
    of = np.unique(task.held.extras[task.problem.cluster][task.held.starts], return_inverse=True)[1]
    count = int(of.max()) + 1
    mean = scores.mean(1, keepdims=True)
    # The influence of each cluster on the ratio of sums.
    return mean + np.stack([np.bincount(of, one, count) for one in scores - mean]) * count / scores.shape[1]


def oracle(task: Task) -> Verdict:
    """Doubly robust scores by the true values and probabilities, Student's intervals for all at once: the most to hope for."""
    each = task.scores
    low, high = np.array([student(one, ALPHA / len(each)) for one in each]).T
    best = int(np.argmax(low))
    return Verdict(best if low[best] > 0 else None, each.mean(1), low, high)


def highest(gain: np.ndarray) -> Verdict:
    """Whoever is estimated best is deployed, with no interval."""
    nothing = np.full(len(gain), np.inf)
    return Verdict(int(np.argmax(np.where(np.isfinite(gain), gain, -np.inf))), gain, -nothing, nothing)


def argmax_fqe(task: Task) -> Verdict:
    """The highest of fitted Q evaluation on the learning part."""
    found = task.on_learning.mean(0)
    return highest(found[:-1] - found[-1])


def argmax_wis(task: Task) -> Verdict:
    """The highest of weighted importance sampling on the learning part."""
    return highest(weighted(task))


def new(task: Task, stationary: bool = False) -> Verdict:
    """The package's decision card, on the held-out part, or cross-fitted where that has few episodes or clusters."""
    problem = task.problem
    units, held = problem.units, problem.parts(task.seed)[1]
    if len(np.unique(units[held])) < (CROSS if problem.log.lengths.max() == 1 else UNITS):
        return _crossed(task, stationary)
    return _card(task, task.policies, held, stationary)


def _crossed(task: Task, stationary: bool) -> Verdict:
    """Learned `FOLDS` times, and each fold judged by the policy that has not seen it: of mixtures that draw one of these."""
    problem = task.problem
    which = problem.folds(task.seed, FOLDS)
    parts = [problem.part(np.flatnonzero(which != k))[0] for k in range(FOLDS)]
    each = [learned(part, problem.estimand.discount, task.seed) for part in parts]
    share = np.bincount(which, minlength=FOLDS) / len(which)
    error = TENTH * float(np.median(task.truth[3]))
    policies, true = {}, []
    for name, policy in task.policies.items():
        own = [policy] if name in problem.candidates else [found[name] for found in each if name in found]
        if len(own) not in (1, FOLDS):
            continue  # its numbers went bad in a fold
        policies[name] = policy if len(own) == 1 else CrossFitted(tuple(own), which)
        gains = np.zeros(len(own)) if problem.null else problem.world.gains(own, np.full(len(own), error))[0]
        true.append(float(gains @ share) if len(own) > 1 else float(gains[0]))
    return replace(_card(task, policies, np.arange(problem.log.episodes), stationary), true=np.array(true))


def _card(task: Task, policies: Mapping[str, Any], held: np.ndarray, stationary: bool) -> Verdict:
    problem, estimand = task.problem, task.problem.estimand
    case = OPEInput(
        problem.log, list(policies.values()), discount=estimand.discount, horizon=estimand.horizon, greedy=estimand.greedy,
        names=list(policies), logged=True, held=held, clusters=problem.units, seed=task.seed % 2**32, noise=None,
    )  # fmt: skip
    found = decide(case, alpha=FIRST_LOOK, stationary=stationary)
    choice = found.choice
    index = list(policies).index(choice.name) if choice.deploy else None
    told = np.array([bool(found.support.objections(i)) for i in range(len(policies))])
    return Verdict(index, *choice.gains.T, why=choice.reason, told=told)


RULES: dict[str, Callable[[Task], Verdict]] = {
    "new": new, "old-train": old_train, "old-held": old_held, "old-level": old_level, "old-fqe": old_fqe, "oracle": oracle,
    "argmax-fqe": argmax_fqe, "argmax-wis": argmax_wis, "stationary": lambda task: new(task, stationary=True),
}  # fmt: skip
