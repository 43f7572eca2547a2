"""The whole way from a case to a decision: which estimators, what they say, what can be checked, and the rule."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimate import BehaviorModel, Case, Estimates, Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.importance import ImportanceSampling, log_ratios
from deadreckon.ope.intervals import ALPHA
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.registry import PROPENSITIES, as_estimator
from deadreckon.ope.select import Choice, select
from deadreckon.ope.support import Support, support

ENOUGH = 0.1  # of the judged episodes, which weights of whole episodes must amount to for every policy


class Decision(NamedTuple):
    """What `decide` finds.

    Attributes:
        estimates: one an estimator.
        support: of the policies in the log.
        choice: by the first of the estimates.
    """

    estimates: list[Estimates]
    support: Support
    choice: Choice


def decide(
    case: Case,
    estimators: Sequence[Any] | str = "auto",
    *,
    seen: Sequence[str | None] | None = None,
    accept_model_based: bool = False,
    alpha: float = ALPHA,
    model: BehaviorModel = PROPENSITIES,
) -> Decision:
    """Estimates a case's policies and decides which to deploy, if any.

    Args:
        case: log and policies, with the behaviour policy.
        estimators: names, `Estimator` objects or functions, the first of which decides; or "auto", see `automatic`.
        seen: for each policy why its estimate is not of fresh episodes, or None where it is; None: all are fresh.
        accept_model_based: deploy also by estimates that no logged reward corrects.
        alpha: share of logs for which one of the intervals may miss.
        model: how the behaviour policy is learned, for the checks and, where propensities were not logged, by "auto".
    """
    found = automatic(case, model, accept_model_based) if isinstance(estimators, str) and estimators == "auto" else estimators
    found = [found] if isinstance(found, str) else found
    checked = support(case, model)
    results = [as_estimator(each).on(case) for each in found]
    return Decision(results, checked, select(results, checked, seen=seen, accept_model_based=accept_model_based, alpha=alpha))


def automatic(case: Case, model: BehaviorModel = PROPENSITIES, accept_model_based: bool = False) -> list[Estimator]:
    """Estimators for a case, the first to decide by; chosen by its design alone and never by a reward.

    - All policies are deterministic with continuous actions, or do not tell their probabilities: weights are degenerate or not
      known, and what is left is model-based (`fqe`).
    - One step, or weights of whole episodes that for every policy amount to a tenth of the episodes or more: doubly robust with
      linear critics (`dr-linear`).
    - Else, where the rows of the log follow each other: doubly robust by ratios of occupancies (`drl`), whose variance does not
      grow with the product of the weights, with `dr-linear` as evidence.

    Args:
        case: log and policies.
        model: how the behaviour policy is learned where propensities were not logged.
        accept_model_based: whether policies may be deployed by model-based estimates; then these come first where weights of any
            policy are degenerate.
    """
    degenerate = case.degenerate
    if degenerate.all() or (accept_model_based and degenerate.any()):
        return [FQE()]
    weighted = DoublyRobust(kind="dr", fqe=LinearFQE(), model=model)
    if case.data.successors is not None:
        return [DoublyRobust(kind="marginal", fqe=LinearFQE())]
    if case.data.lengths.max() == 1:
        return [weighted, ImportanceSampling(model=model)]
    episodes = case.episodes
    ratios = log_ratios(case, "auto", model, None)[: len(case.policies)]
    last = np.stack([episodes.cumulate(row)[case.data.ends] for row in ratios[~degenerate]])
    weights = np.exp(last - last.max(1, keepdims=True).clip(min=-1e300))
    effective = np.square(weights.sum(1)) / np.maximum(np.square(weights).sum(1), 1e-300)
    marginal = DoublyRobust(kind="marginal", fqe=LinearFQE())
    if (effective >= ENOUGH * case.data.episodes).all():
        return [weighted, marginal]
    return [marginal, weighted]
