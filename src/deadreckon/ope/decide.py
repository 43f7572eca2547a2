"""From a case to a decision: the choice of estimators, the estimates, the checks, and the rule."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np

from deadreckon.data.told import weights_of
from deadreckon.errors import UserError
from deadreckon.ope.balance import dependent, unbalanced
from deadreckon.ope.basis import MANY, SHARE
from deadreckon.ope.behavior_model import PROPENSITIES, BehaviorModel
from deadreckon.ope.carry_over import carried_over
from deadreckon.ope.case import OPEInput
from deadreckon.ope.confounding import Confounding, one_step, possible
from deadreckon.ope.costs import as_json, costs_of, limits_of
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.groups import Groups, by_group
from deadreckon.ope.guarantee import guaranteed, refuse
from deadreckon.ope.importance import ImportanceSampling, learns, log_ratios
from deadreckon.ope.latest import latest
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.losses import with_rare_rewards, without_losses
from deadreckon.ope.markov import hidden_state, left_out
from deadreckon.ope.over_time import adjusted, change_of
from deadreckon.ope.registry import as_estimators
from deadreckon.ope.row_order import out_of_order
from deadreckon.ope.select import MOVED, Choice, doubted, moved_most, select, unbounded_where_unsupported
from deadreckon.ope.sensitivity import MOST
from deadreckon.ope.settings import DecisionOptions, DecisionSettings
from deadreckon.ope.support import Support, support
from deadreckon.ope.tail import tails
from deadreckon.ope.weights import effective_of_logs
from deadreckon.settings import check_kind
from deadreckon.stats.interval import ALPHA

UNSEEN = "no check can detect confounding: an unrecorded variable that influenced both the logged actions and the rewards"
GROUPS = 50  # most groups with separate gains


class Decision(NamedTuple):
    """The result of `decide`.

    Attributes:
        estimates: one per estimator.
        support: of the policies in the log.
        choice: by the first of the estimates.
        more: for the chosen policy, as JSON values: `confounding`, and, if requested, `guarantee`, `groups` and `tail`; for all
            policies `over_time`, whether the behaviour policy changed along the log or its clusters, and the chosen policy's
            gain in the latest part (`ope.latest`), and `costs`, if the log has some.
    """

    estimates: list[Estimates]
    support: Support
    choice: Choice
    more: dict[str, Any]


def decide(
    case: OPEInput,
    estimators: Sequence[Any] | str = "auto",
    *,
    seen: Sequence[str | None] | None = None,
    alpha: float = ALPHA,
    groups: Groups | None = None,
    **options: Unpack[DecisionOptions],
) -> Decision:
    """Estimates a case's policies and decides which to deploy, if any.

    Args:
        case: log and policies, with the behaviour policy.
        estimators: names, `Estimator` objects or functions, the first of which decides; or "auto", see `automatic`.
        seen: for each policy the reason why its estimate is not of held-out episodes, or None if it is; None: all are.
        alpha: share of logs for which one of the intervals may miss.
        groups: also estimate the gain in each of these groups of episodes.
        **options: `accept_model_based`, `cost_limit` (see `ope.costs`), `stationary` (see `ope.over_time`), `model`,
            `guarantee` (see `ope.guarantee`), `return_range`, `confounding` and `tail`; see `ope.settings.DecisionSettings`.

    Raises:
        UserError: invalid input, or a request that the log cannot answer.
    """
    settings = DecisionSettings.of(options)
    model, accept_model_based = settings.model, settings.accept_model_based
    check(case, settings, groups)
    check_kind("alpha", alpha, float)
    if not 0.0 < alpha < 1.0:
        raise UserError(f"alpha, the share of logs for which an interval may miss, must lie between 0 and 1, got {alpha}")
    case = adjusted(case, settings.stationary)
    auto = isinstance(estimators, str) and estimators == "auto"
    asked = automatic(case, model, accept_model_based) if auto else as_estimators(estimators)
    for each in asked:
        each.check(case)
    checked = support(case, model)
    estimates = [each.on(case) for each in asked]
    first = asked[0]
    costs = costs_of(case, first, checked, limits_of(settings.cost_limit, case.given), alpha, model)
    against = [[told for each in costs if (told := each.objection(i, 1 - alpha))] for i in range(len(case.policies))]
    predicted = first.nuisances(case)[0] if isinstance(first, DoublyRobust) and first.kind == "marginal" else None
    ratios = None if predicted is None else predicted.weights
    for own, lucky in zip(against, without_losses(case, estimates[0], checked, model, alpha, ratios)):
        own += [lucky] if lucky else []
    for doubt in _doubts(case, first, predicted, model):
        for own in against:
            own.append(doubt)
    if (weights := weights_of(case.given)) is not None:
        for own in against:
            own.append(
                f"its estimate is of the log's rows and not of the population, as the weights in column {weights} are not "
                "used: keep each episode with a probability proportional to its weight, and ignore the column"
            )
    choice = select(estimates, checked, seen=seen, against=against, accept_model_based=accept_model_based, alpha=alpha)
    which = case.names.index(choice.name)
    more: dict[str, Any] = {"costs": as_json(costs)} if costs else {}
    change = None if settings.stationary else change_of(case)
    p_value, within = (None, False) if change is None else change
    along: dict[str, Any] = {
        "stationary": settings.stationary, "p_value": p_value, "adjusted": case.positions, "within_clusters": within
    }  # fmt: skip
    more["over_time"] = along
    if (together := dependent(case, model)) is not None:
        choice = replace(choice, warnings=(*choice.warnings, together))
    if case.positions and change is not None and change.found:
        choice = replace(choice, warnings=(*choice.warnings, change.words))
    for each in costs:
        doubts = (f"{each.column}: {line}" for line in each.warnings if line not in choice.warnings)
        choice = replace(
            choice, evidence=(*choice.evidence, each.words(which, 1 - alpha)), warnings=(*choice.warnings, *doubts)
        )
    if settings.guarantee:
        more["guarantee"] = bound = guaranteed(case, which, settings.return_range, alpha)
        choice = _demanded(choice, bound, f"for any number of episodes, not only for many, its gain is at least {bound:+.4g}")
    aged = not settings.stationary and bool(np.isfinite(choice.low))
    products = groups is not None or settings.tail is not None or settings.confounding is not None or one_step(case)
    wider = _wider(case, estimates[0], checked, model, choice) if products or aged else choice.wider
    if aged:
        recent = latest(case, which, model, alpha, wider, None if ratios is None else predicted)
        along["latest"] = recent.as_json()
        if (line := recent.words) is not None:
            choice = _demanded(choice, recent.low, line)
    more["confounding"], choice = _confounded(case, choice, model, alpha, settings.confounding, wider)
    endless = None if np.isfinite(choice.low) else f"the card's own interval is infinite: {'; '.join(choice.objections[which])}"
    if groups is not None:
        try:
            if endless is not None:
                raise UserError(endless)
            more["groups"] = {"column": groups.column, "values": by_group(case, which, groups, model, alpha, wider)}
        except UserError as error:
            more["groups"] = {"column": groups.column, "refused": str(error)}
    if settings.tail is not None:
        more["tail"], line = _tail(case, which, settings.tail, model, alpha, wider, endless)
        choice = replace(choice, evidence=(*choice.evidence, line))
    shown = [unbounded_where_unsupported(with_rare_rewards(case, each, model), checked) for each in estimates]
    return Decision(shown, checked, choice, more)


def check(case: OPEInput, settings: DecisionSettings, groups: Groups | None) -> None:
    """Refuses requests that a case cannot answer, before anything is fitted or a look is counted; arguments as for `decide`.

    Raises:
        UserError: in one line.
    """
    settings.check_values()
    limits_of(settings.cost_limit, case.given)
    if settings.guarantee:
        refuse(case, settings.return_range)
    elif settings.return_range is not None:
        raise UserError("return_range is used only with a guarantee (guarantee=True, --guarantee)")
    if settings.confounding is not None:
        possible(case)
    if groups is not None:
        groups.check(case.log)
        if len(groups.names) > GROUPS:
            raise UserError(f"column {groups.column} has {len(groups.names):,} values; at most {GROUPS} subgroups; merge some")


def _doubts(case: OPEInput, first: Estimator, predicted: OutOfFold | None, model: BehaviorModel) -> Iterator[str]:
    """Objections to the estimates of all policies by the estimator that decides, one phrase each; `predicted` is what critics
    predict if ratios of occupancies are its weights."""
    if (confounder := unbalanced(case, model)) is not None:
        yield confounder.words
    for test in (carried_over, out_of_order):
        if (wrong := test(case, model)) is not None:
            yield wrong
    if not isinstance(first, ImportanceSampling) and (lost := left_out(case)) is not None:
        yield lost
    if predicted is not None and (hidden := hidden_state(case, predicted.errors)) is not None:
        yield hidden


def _demanded(choice: Choice, bound: float, words: str) -> Choice:
    """The choice with a further condition, deployed only if `bound` is above zero; `words` state it as evidence."""
    choice = replace(choice, evidence=(*choice.evidence, words))
    if not choice.deploy or bound > 0:
        return choice
    return replace(choice, deploy=False, reason=f"{choice.name} has {choice.reason}, but {words}")


def _wider(case: OPEInput, first: Estimates, checked: Support, model: BehaviorModel, choice: Choice) -> float:
    """How much is added to intervals by products of weights, because learned propensities may be wrong: as much as to the gains
    or, if the estimator that decides does not use such weights, as to those by `dr-linear`."""
    depends = "normalising" in first.diagnostics
    if depends or not learns(case, "auto") or case.degenerate.all() or case.data.successors is not None:
        return choice.wider
    plain = DoublyRobust(kind="dr", fqe=LinearFQE(), model=model).on(case)
    return MOVED * moved_most(plain, doubted(plain, checked)[1])[1]


def _confounded(
    case: OPEInput, choice: Choice, model: BehaviorModel, alpha: float, gamma: float | None, wider: float
) -> tuple[dict[str, Any], Choice]:
    """Bounds under unmeasured confounding as JSON values, and the choice with them as evidence. If `gamma` is None, only the
    tipping point, and only of one-step episodes, where it is quick to compute."""
    values: dict[str, Any] = {"gamma": gamma, "bounds": None, "tipping": None}
    which, alone = case.names.index(choice.name), replace(choice, evidence=(*choice.evidence, UNSEEN))
    try:
        if gamma is None and not one_step(case):
            return values, alone
        bounds = Confounding(case, model, alpha, wider)
    except UserError:
        if gamma is not None:
            raise
        return values, alone
    if lost := "; ".join(bounds.lost[which]):
        how = "" if case.degenerate[which] else "by whole episodes "
        words = f"its gain with wrong odds of logged actions is not known: {how}{lost}"
        told = replace(choice, evidence=(*choice.evidence, f"{UNSEEN}; {words}"))
        return values, told if gamma is None else _demanded(alone, -np.inf, words)
    tipping = bounds.tipping(which) if np.isfinite(choice.low) else np.nan
    values["tipping"] = None if np.isnan(tipping) else min(tipping, MOST)
    undone = f"its gain is no longer significant if the odds of logged actions are wrong by a factor of {tipping:.3g}"
    if np.isnan(tipping):
        undone = "its gain is not significant even without confounding"
    elif np.isinf(tipping):
        undone = f"its gain remains significant if the odds of logged actions are wrong by a factor of {MOST:g}"
    choice = replace(choice, evidence=(*choice.evidence, f"{UNSEEN}; {undone}"))
    if gamma is None:
        return values, choice
    found = [bounds.gain(i, gamma) for i in range(len(case.policies))]
    values["bounds"] = [[end if np.isfinite(end) else None for end in ends] for ends in found]
    low, high = found[which]
    words = f"if the odds of logged actions are wrong by a factor of up to {gamma:g}, its gain is [{low:+.4g}, {high:+.4g}]"
    return values, _demanded(choice, low, words)


def _tail(
    case: OPEInput, which: int, share: float, model: BehaviorModel, alpha: float, wider: float, endless: str | None
) -> tuple[dict[str, Any], str]:
    """The lower tail as JSON values and in a line, or why it is not known."""
    worst = f"its worst {100 * share:g} % of episodes"
    try:
        if endless is not None:
            raise UserError(endless)
        values = tails(case, which, share, model, alpha, wider)
    except UserError as error:
        return {"share": share, "refused": str(error)}, f"{worst} are not known: {error}"
    gain = f"{values['gain']:+.4g} [{values['low']:+.4g}, {values['high']:+.4g}]"
    against = f"against {values['logged']:.4g} of the behaviour policy's"
    return values, f"{worst} return {values['value']:.4g} on average, {against}: {gain}"


def automatic(case: OPEInput, model: BehaviorModel = PROPENSITIES, accept_model_based: bool = False) -> list[Estimator]:
    """Estimators for a case, of which the first decides; chosen by the case's design alone and never by rewards.

    - All policies are deterministic with continuous actions, or do not give their probabilities: weights are degenerate or not
      known, and a model-based estimate (`fqe`) remains. Not for cross-fitted policies: its critics would be trained on the
      episodes that these were trained on. The same where the log's rows do not follow each other, so that episodes have no
      ratios.
    - One step, cross-fitted policies, or weights of whole episodes whose effective sample size is, for every policy, at least a
      fifth of the episodes or fifty (`basis.SHARE`, `basis.MANY`): doubly robust with linear critics (`dr-linear`).
    - Otherwise, if observations take few values: doubly robust by ratios of occupancies (`drl`), whose variance does not grow
      with the product of the weights, with `dr-linear` as evidence. It then also decides if part of any policy's estimand lies
      beyond the ends of the recording. If observations take many values, `drl` is valid only if its features are adequate, and
      nothing corrects them, so it is only evidence unless model-based estimates are accepted.

    Args:
        case: log and policies.
        model: settings of the behaviour model, if propensities were not logged.
        accept_model_based: whether policies may be deployed by model-based estimates; then these come first where weights of
            any policy are degenerate.
    """
    weighted = DoublyRobust(kind="dr", fqe=LinearFQE(), model=model)
    if case.crossed:
        return [weighted, ImportanceSampling(model=model)]
    degenerate = case.degenerate
    if degenerate.all() or (accept_model_based and degenerate.any()):
        return [FQE()]
    if case.data.successors is not None:
        return [FQE()]
    if case.data.lengths.max() == 1:
        return [weighted, ImportanceSampling(model=model)]
    marginal, table = DoublyRobust(kind="marginal", fqe=LinearFQE()), case.table is not None
    episodes = case.episodes
    ratios = log_ratios(case, "auto", model, None)[: len(case.policies)]
    along = [episodes.cumulate(row) for row in ratios[~degenerate]]
    if table and max(map(case.beyond_of, along)) > TAIL:
        return [marginal, weighted]
    last = np.stack([row[case.data.ends] for row in along])
    if (effective_of_logs(last) >= min(SHARE * case.data.episodes, MANY)).all() or not (table or accept_model_based):
        return [weighted, marginal]
    return [marginal, weighted]
