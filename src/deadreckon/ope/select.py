"""From estimates to a decision: which policy to deploy, if any, and on what evidence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.estimate import LOGGED, Estimates
from deadreckon.ope.intervals import ALPHA, percentiles, spread
from deadreckon.ope.weights import FEW

BOOTSTRAP = 100  # redraws from which their percentiles are an interval; fewer are members of an ensemble


@dataclass(frozen=True)
class Choice:
    """A decision card.

    Attributes:
        name: the policy whose estimated gain over the log's own policy has the highest lower end.
        deploy: whether that is above zero.
        gain, low, high: estimated difference, paired, with an interval that holds for all policies at once (95 %).
        reason: why, in one line.
        evidence: what else was estimated, a line each.
        warnings: why not to trust it.
    """

    name: str
    deploy: bool
    gain: float
    low: float
    high: float
    reason: str
    evidence: tuple[str, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        words = f"DEPLOY {self.name}" if self.deploy else f"DO NOT DEPLOY {self.name}"
        lines = [f"{words}: {self.reason}.", *self.evidence, *(f"warning: {line}" for line in self.warnings)]
        return "\n".join(f"  {line}" if i else line for i, line in enumerate(lines))


def gain(found: Estimates, which: int) -> tuple[float, float, float]:
    """How much better a policy is than the log's own: the difference, and an interval that holds for all policies at once.

    Both are estimated from the same redraws of the log by the same method, so what they share cancels; the level of each
    interval is Bonferroni's, 1 - 0.05 / policies, because the best of several estimates is chosen for being high.
    """
    if LOGGED not in found.names or found.redraws is None:
        raise UserError(f"{found.method} was not asked about the log's own policy; use Case(..., logged=True)")
    logged = found.names.index(LOGGED)
    draws = found.redraws[:, which] - found.redraws[:, logged]
    alpha = ALPHA / (len(found.names) - 1)
    if len(draws) >= BOOTSTRAP:
        low, high = percentiles(draws, np.inf if found.effective is None else found.effective[which], alpha)
    else:
        low, high = spread(draws, alpha)
    return float(found.value[which] - found.value[logged]), float(low), float(high)


def select(estimates: Sequence[Estimates]) -> Choice:
    """Chooses by the first of several estimates of the same policies; the others are evidence.

    It takes the policy whose gain has the highest lower end: what is best for sure, not what may be best. An estimate that the
    log says little about is uncertain, and then high only by chance.

    Raises:
        UserError: no estimates, of different policies, or without the log's own policy.
    """
    if not estimates:
        raise UserError("no estimates to choose by")
    first = estimates[0]
    if any(each.names != first.names for each in estimates):
        raise UserError("the estimates are of different policies")
    best = _safest(first)
    name, (difference, low, high) = first.names[best], gain(first, best)
    few = first.effective is not None and first.effective[best] < FEW
    unit = f"{difference:+.2f} [{low:+.2f}, {high:+.2f}] against the log's own policy by {first.method}"
    if not np.isfinite(low):
        deploy, reason = False, f"{unit}, without an interval: ask for two members or more"
    elif few:
        assert first.effective is not None
        deploy, reason = False, f"{unit}, but its weights rest on {first.effective[best]:.1f} episodes"
    elif low > 0:
        deploy, reason = True, f"{unit}, and the lower end is above zero"
    else:
        deploy, reason = False, f"{unit}, which may be chance"
    evidence = []
    for each in estimates[1:]:
        own = gain(each, best)
        chosen = _safest(each)
        agrees = "agrees that it is best" if chosen == best else f"would choose {each.names[chosen]}"
        evidence.append(f"{each.method}: {own[0]:+.2f} [{own[1]:+.2f}, {own[2]:+.2f}], {agrees}")
    return Choice(name, deploy, difference, low, high, reason, tuple(evidence), first.warnings)


def _safest(found: Estimates) -> int:
    """The policy whose gain has the highest lower end, or where there are no intervals, the highest estimate."""

    def standing(i: int) -> tuple[bool, float, float]:
        difference, low, _ = gain(found, i)
        return bool(np.isfinite(difference)), low if np.isfinite(low) else -np.inf, difference

    return max((i for i, name in enumerate(found.names) if name != LOGGED), key=standing)
