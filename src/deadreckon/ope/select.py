"""From estimates to a decision: which policy to deploy, if any, and on what evidence. There is no other rule in the package.

A policy is deployed if the lower end of its gain over the behaviour policy is above zero, at a level that holds for all
policies that were ever evaluated on these episodes, and if no check raises an objection to the estimate. A log cannot show
whether an unrecorded variable influenced the logged actions (confounding).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.basis import Basis
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.support import Support
from deadreckon.provided import Shown
from deadreckon.stats import inference
from deadreckon.stats.bootstrap import ensemble_interval, percentile_interval
from deadreckon.stats.interval import ALPHA, level_in_words, signed

BOOTSTRAP = 100  # bootstrap samples from which their percentiles are an interval; fewer are members of an ensemble
# If propensities are learned, intervals are widened by this times the largest change of a gain from normalising the weights.
# Weights by correct propensities average one, and normalising changes nothing; wrong ones bias gains by up to about this.
MOVED = 2.0
ROUNDING = 1e-6  # share of the values below which a gain is a rounding error of 32-bit probabilities and models
ALARMING = 0.1  # share of an interval's width above which that change gives a warning


@dataclass(frozen=True)
class Choice(Shown):
    """A decision card.

    Attributes:
        name: the policy that is chosen.
        deploy: whether to deploy it instead of the behaviour policy.
        gain, low, high: its estimated gain over the behaviour policy, with an interval that holds simultaneously for all
            policies.
        reason: the reason, in one line.
        evidence: further estimates, one line each.
        warnings: reasons not to trust it.
        gains: (policies, 3) the same for all policies, without the behaviour policy.
        objections: for each policy the objections to its estimate, one phrase each; a policy with an objection is not deployed.
        level: confidence level of the intervals.
        wider: the widening of both ends for inaccurate learned propensities.
    """

    name: str
    deploy: bool
    gain: float
    low: float
    high: float
    reason: str
    evidence: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    gains: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), repr=False)
    objections: tuple[tuple[str, ...], ...] = ()
    level: float = 1 - ALPHA
    wider: float = 0.0

    def __str__(self) -> str:
        words = f"DEPLOY {self.name}" if self.deploy else "DO NOT DEPLOY"
        lines = [f"{words}: {self.reason}.", *self.evidence, *(f"warning: {line}" for line in self.warnings)]
        return "\n".join(f"  {line}" if i else line for i, line in enumerate(lines))


def gains(found: Estimates, alpha: float = ALPHA, known: np.ndarray | None = None) -> np.ndarray:
    """(policies, 3) gains over the behaviour policy with lower and upper ends that hold simultaneously for all policies.

    Intervals of policies that are not `known` (policies,) are infinite, as are those whose weights rest on fewer than two
    episodes or clusters. With learned propensities they are wider by `MOVED` times the largest change from normalising the
    weights.

    Both values are estimated by the same method from the same episodes, so common errors cancel. With an influence function,
    the interval is by the studentised maximum (`inference.simultaneous`), and wider by the error of fitted models that the
    influence function does not include (`Estimates.nuisance`). Otherwise it is by percentiles of the bootstrap or, for the few
    members of an ensemble, Student's. The last three have Bonferroni's correction for the number of policies. All reach to both
    sides by `ROUNDING` times the values or more.

    Raises:
        UserError: the behaviour policy was not evaluated.
    """
    if LOGGED not in found.names or (found.bootstrap is None and found.influence is None):
        raise UserError(f"{found.method} has no estimate of the behaviour policy; use OPEInput(..., logged=True)")
    logged = found.names.index(LOGGED)
    known = found.spread if known is None else found.spread & known
    each = alpha / max(len(found.names) - 1, 1)
    if found.influence is not None:
        middle, low, high = inference.gains(found.value, found.influence, logged, alpha, known)
        if found.nuisance is not None:
            half = inference.beside(high - middle, found.nuisance - found.nuisance[:, [logged]], each)
            half = np.where(np.isnan(half), np.inf, half)
            low, high = middle - half, middle + half
    else:
        assert found.bootstrap is not None
        middle = found.value - found.value[logged]
        draws = found.bootstrap - found.bootstrap[:, [logged]]
        units = np.inf if found.units is None else found.units
        ends = [
            percentile_interval(own, units if found.ess is None else min(found.ess[i], units), each)
            if len(draws) >= BOOTSTRAP else ensemble_interval(own, each)
            for i, own in enumerate(draws.T)
        ]  # fmt: skip
        low, high = np.array([[float(low), float(high)] for low, high in ends]).T
    if found.inflation is not None:
        low, high = middle - found.inflation * (middle - low), middle + found.inflation * (high - middle)
    # Probabilities and fitted models have 32 bits: a difference of a millionth of the values is none.
    least = ROUNDING * np.maximum(np.abs(found.value), abs(found.value[logged]))
    low, high = np.minimum(low, middle - least), np.maximum(high, middle + least)
    wider = MOVED * moved_most(found, known)[1]
    low, high = np.where(known, low - wider, -np.inf), np.where(known, high + wider, np.inf)
    out = np.stack([middle, low, high], 1)
    out[logged] = 0.0
    return out


def select(
    estimates: Sequence[Estimates],
    support: Support | None = None,
    *,
    seen: Sequence[str | None] | None = None,
    against: Sequence[Sequence[str]] | None = None,
    accept_model_based: bool = False,
    alpha: float = ALPHA,
) -> Choice:
    """Chooses by the first of several estimates of the same policies; the others are evidence.

    Among the policies without objections it selects the one whose gain has the highest lower end.

    Args:
        estimates: of the same policies, with the behaviour policy.
        support: of the policies in the log; None: not known.
        seen: for each policy the reason why its estimate is not of held-out episodes, or None if it is; None: all are.
        against: for each policy further objections, such as its costs, one phrase each; None: none.
        accept_model_based: deploy also by estimates that no logged reward corrects.
        alpha: share of logs for which one of the intervals may miss.

    Raises:
        UserError: no estimates, estimates of different policies, without the behaviour policy, or in which it is not the last.
    """
    if not estimates:
        raise UserError("no estimates to select by")
    first = estimates[0]
    if any(each.names != first.names for each in estimates):
        raise UserError("the estimates are of different policies")
    names = [name for name in first.names if name != LOGGED]
    if support is not None and len(support.missing) != len(names):
        raise UserError(f"support must have a number for each of {len(names)} policies, got {len(support.missing)}")
    if seen is not None and len(seen) != len(names):
        raise UserError(f"seen must have an entry for each of {len(names)} policies, got {len(seen)}")
    unknown, known = doubted(first, support)
    every = gains(first, alpha, known)
    found = [every, *(gains(each, alpha, doubted(each, support)[1]) for each in estimates[1:])]
    objections = []
    for i in range(len(names)):
        own = [] if seen is None or seen[i] is None else [str(seen[i])]
        own += unknown[i] + _model_based(first, i, accept_model_based, support)
        others = zip(estimates[1:], found[1:])
        own += [f"{each.method} finds it worse" for each, told in others if _speaks(each, i) and told[i, 2] < 0]
        own += [] if against is None else against[i]
        objections.append(tuple(own))
    best = max(range(len(names)), key=lambda i: (not objections[i], *_standing(first, every[i])))
    name, (difference, low, high) = names[best], every[best]
    level = level_in_words(1 - alpha)
    unit = f"{signed(*every[best])} ({level}, for all policies at once) against the behaviour policy by {first.method}"
    if objections[best]:
        deploy, reason = False, f"{name} has {unit}, but {'; '.join(objections[best])}"
    elif not np.isfinite(low):
        deploy, reason = False, f"{name} has {unit}: the log is not conclusive about it"
    elif low > 0:
        deploy, reason = True, f"{unit}; the lower end is above zero"
    else:
        among = " of the policies without objections" if any(objections) else ""
        deploy, reason = False, f"{name} has the highest lower end{among}, with {unit}; the lower end is not above zero"
        if held_back := [names[i] for i in range(len(names)) if every[i, 1] > 0]:
            reason += f"; {' or '.join(held_back)} would be deployed without objections"
    evidence = []
    for each, told in zip(estimates[1:], found[1:]):
        chosen = max(range(len(names)), key=lambda i: _standing(each, told[i]))
        agrees = ", ranks it first, too" if chosen == best else f", ranks {names[chosen]} first"
        # Agreement means nothing for a single policy, or if the interval is infinite.
        agrees = agrees if len(names) > 1 and np.isfinite(told[best, 1]) else ""
        evidence.append(f"{each.method}: {signed(*told[best])}{agrees}")
    warnings = list(first.warnings)
    which, moved = moved_most(first, known)
    if moved > ALARMING * max(high - low, 0.0):
        warnings.append(
            f"the learned propensities do not fit the log: normalising the weights, which should change nothing, changes the "
            f"gain of {first.names[which]} by {moved:.2g}; all intervals are widened accordingly"
        )
    if support is not None and np.isnan(support.missing[best]):
        warnings.append(f"the log is too short to tell how many of {name}'s actions have support")
    for i, own in enumerate(objections):
        if i != best and own:
            warnings.append(f"{names[i]}: {'; '.join(own)}")
    for each in estimates[1:]:
        if not (basis := Basis.of(each, best)).overlaps:
            warnings.append(f"the weights of {name} in {each.method} rest on {basis.rest[1]}")
        warnings += [f"{each.method}: {line}" for line in each.warnings if line not in warnings]
    keep = [i for i, each in enumerate(first.names) if each != LOGGED]
    return Choice(
        name, deploy, float(difference), float(low), float(high), reason, tuple(evidence), tuple(warnings), every[keep],
        tuple(objections), 1 - alpha, MOVED * moved,
    )  # fmt: skip


def doubted(found: Estimates, support: Support | None) -> tuple[list[list[str]], np.ndarray]:
    """For each policy the reasons why no interval of its estimate is valid; and (policies,) whether one is.

    The latter includes the behaviour policy, for which one always is.

    Raises:
        UserError: the behaviour policy is not the last.
    """
    if LOGGED in found.names[:-1]:  # policies are numbered without it
        raise UserError(f"the {LOGGED} must be the last policy of an estimate, got {', '.join(found.names)}")
    names = [name for name in found.names if name != LOGGED]
    unknown = [Basis.of(found, i).unreliable + ([] if support is None else support.objections(i)) for i in range(len(names))]
    settled = found.diagnostics.get("settled", np.ones(len(found.names)))
    if found.influence is None and LOGGED in found.names and settled[found.names.index(LOGGED)] < 1:  # nothing corrects it
        unknown = [[*own, "the fit of the behaviour policy's estimate has not converged"] for own in unknown]
    known = np.ones(len(found.names), bool)
    known[[found.names.index(name) for name in names]] = [not own for own in unknown]
    return unknown, known


def supported(found: Estimates, support: Support | None) -> np.ndarray:
    """(policies,) whether the log supports each policy of an estimate, including the behaviour policy."""
    known = np.ones(len(found.names), bool)
    for i, name in enumerate(name for name in found.names if name != LOGGED):
        known[found.names.index(name)] = support is None or not support.objections(i)
    return known


def unbounded_where_unsupported(found: Estimates, support: Support | None) -> Estimates:
    """An estimate with infinite intervals for policies that the log does not support or whose weights miss too much."""
    lost = ~supported(found, support)
    for i, name in enumerate(found.names):
        lost[i] |= name != LOGGED and bool(Basis.of(found, i).lost)
    return found.unbounded(lost)


def moved_most(found: Estimates, known: np.ndarray) -> tuple[int, float]:
    """Index of the policy whose gain changes most if weights are normalised, and the change; 0.0 if propensities are logged.

    All policies share the propensities, so a change of one casts doubt on all estimates.
    """
    shift = np.where(known, np.abs(found.diagnostics.get("normalising", np.zeros(len(known)))), 0.0)
    which = int(np.argmax(shift))
    return which, float(shift[which])


def _model_based(found: Estimates, which: int, accepted: bool, support: Support | None) -> list[str]:
    degenerate = support is not None and bool(support.degenerate[which])
    if accepted or (found.corrects(which) and not degenerate):
        return []
    beyond = found.diagnostics.get("beyond", np.zeros(which + 1))[which]
    why = "no logged reward corrects the model's errors"
    if found.corrected and (left := found.left(which)) > TAIL:
        why = f"{100 * left:.0f} % of an error of its critics remains, or of those of the behaviour policy"
    if beyond > TAIL and not degenerate:
        why = f"{100 * beyond:.0f} % of its discounted time lies beyond the ends of the recording; a shorter horizon needs less"
    return [f"its estimate is model-based only: {why}"]


def _speaks(found: Estimates, which: int) -> bool:
    """Whether an estimate counts as evidence against a policy."""
    return found.corrects(which) and Basis.of(found, which).overlaps


def _standing(found: Estimates, told: np.ndarray) -> tuple[bool, float]:
    """Sort key of a policy: whether the lower end of its gain is finite, and this end; with the few members of an ensemble,
    whose spread is unreliable, the gain itself.
    """
    few = found.influence is None and (found.bootstrap is None or len(found.bootstrap) < BOOTSTRAP)
    sure = told[0] if few or not np.isfinite(told[1]) else told[1]
    return bool(np.isfinite(told[1])), float(sure) if np.isfinite(sure) else -np.inf
