"""From estimates to a decision: which policy to deploy, if any, and on what evidence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.coverage import MOSTLY
from deadreckon.ope.estimate import LOGGED, Estimates
from deadreckon.ope.intervals import ALPHA, percentiles, spread
from deadreckon.ope.weights import FEW

BOOTSTRAP = 100  # redraws from which their percentiles are an interval; fewer are members of an ensemble


@dataclass(frozen=True)
class Choice:
    """A decision card.

    Attributes:
        name: the policy that is chosen.
        deploy: whether its gain over the log's own policy is above zero for sure, and no other estimate speaks against it.
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


def gain(found: Estimates, which: int, *, bonferroni: bool = True) -> tuple[float, float, float]:
    """How much better a policy is than the log's own: the difference, and an interval that holds for all policies at once.

    Both are estimated from the same redraws of the log by the same method, so what they share cancels; the level of each
    interval is Bonferroni's, 1 - 0.05 / policies, because the best of several estimates is chosen for being high. Without
    `bonferroni` it is 95 % for this policy alone.
    """
    if LOGGED not in found.names or found.redraws is None:
        raise UserError(f"{found.method} was not asked about the log's own policy; use Case(..., logged=True)")
    logged = found.names.index(LOGGED)
    draws = found.redraws[:, which] - found.redraws[:, logged]
    alpha = ALPHA / (len(found.names) - 1) if bonferroni else ALPHA
    if found.effective is not None and not found.effective[which] > 0:
        low, high = -np.inf, np.inf
    elif len(draws) >= BOOTSTRAP:
        low, high = percentiles(draws, np.inf if found.effective is None else found.effective[which], alpha)
    else:
        low, high = spread(draws, alpha)
    return float(found.value[which] - found.value[logged]), float(low), float(high)


def select(estimates: Sequence[Estimates], covered: np.ndarray | None = None) -> Choice:
    """Chooses by the first of several estimates of the same policies; the others are evidence.

    Policies whose weights rest on few episodes, or of whose actions the log covers few, come last. Among the others it takes
    the one whose gain has the highest lower end (95 %, each for itself), because what the log says little about is high by
    chance; where the interval comes from a few members, whose spread is itself a matter of chance, the highest gain. Whether to
    deploy it is decided by an interval that holds for all policies at once.

    Args:
        estimates: of the same policies, with the log's own.
        covered: (policies,) share of what each does that lies within what the log shows, from `coverage`; None: not known.

    Raises:
        UserError: no estimates, of different policies, or without the log's own policy.
    """
    if not estimates:
        raise UserError("no estimates to choose by")
    first = estimates[0]
    if any(each.names != first.names for each in estimates):
        raise UserError("the estimates are of different policies")
    shown = np.ones(len(first.names)) if covered is None else np.append(np.where(np.isnan(covered), 1.0, covered), 1.0)
    if len(shown) != len(first.names):
        raise UserError(f"covered must have a number for each of {len(first.names) - 1} policies, got {len(shown) - 1}")
    best = _safest(first, shown)
    name, (difference, low, high) = first.names[best], gain(first, best)
    against = [each for each in estimates[1:] if _overlaps(each, best) and gain(each, best)[2] < 0]
    unit = f"{difference:+.2f} [{low:+.2f}, {high:+.2f}] against the log's own policy by {first.method}"
    if not _overlaps(first, best):
        assert first.effective is not None
        deploy, reason = False, f"{unit}, but its weights rest on {first.effective[best]:.1f} episodes"
    elif shown[best] < MOSTLY:
        deploy, reason = False, f"{unit}, but only {100 * shown[best]:.0f} % of what it does is covered by the log"
    elif not np.isfinite(low):
        deploy, reason = False, f"{unit}, without an interval: an estimator with redraws or members gives one"
    elif against:
        deploy, reason = False, f"{unit}, but {against[0].method} finds it worse"
    elif low > 0:
        deploy, reason = True, f"{unit}, and the lower end is above zero"
    else:
        deploy, reason = False, f"{unit}, which may be chance"
    evidence = []
    for each in estimates[1:]:
        own = gain(each, best)
        chosen = _safest(each, shown)
        agrees = "agrees that it is best" if chosen == best else f"would choose {each.names[chosen]}"
        evidence.append(f"{each.method}: {own[0]:+.2f} [{own[1]:+.2f}, {own[2]:+.2f}], {agrees}")
    warnings = [*_uncovered(first.names, shown), *first.warnings]
    if covered is not None and np.isnan(covered[best]):
        warnings.append(f"the log is too short to tell how much of what {name} does it covers")
    for each in estimates[1:]:
        # What concerns the choice: the overlap of others' weights, where the first knows nothing of it.
        if not _overlaps(each, best):
            assert each.effective is not None
            warnings.append(f"the weights of {name} in {each.method} rest on {each.effective[best]:.1f} episodes")
        warnings += [f"{each.method}: {line}" for line in each.warnings if line not in warnings]
    return Choice(name, deploy, difference, low, high, reason, tuple(evidence), tuple(warnings))


def _overlaps(found: Estimates, which: int) -> bool:
    """Whether nothing is weighted, or the weights rest on enough episodes."""
    return found.effective is None or bool(found.effective[which] >= FEW)


def _uncovered(names: Sequence[str], shown: np.ndarray) -> list[str]:
    """A warning where policies mostly do what the log does not show, else nothing."""
    beyond = [f"{name} ({100 * shown[i]:.0f} %)" for i, name in enumerate(names) if shown[i] < MOSTLY]
    if not beyond:
        return []
    return [f"the log covers less than half of what these do, and estimates of them are guesses: {', '.join(beyond)}"]


def _safest(found: Estimates, shown: np.ndarray) -> int:
    """The policy to choose by these estimates alone; see `select`."""
    bootstrap = found.redraws is not None and len(found.redraws) >= BOOTSTRAP

    def standing(i: int) -> tuple[bool, int, float]:
        difference, low, _ = gain(found, i, bonferroni=False)
        sure = low if bootstrap and np.isfinite(low) else difference
        return bool(np.isfinite(difference)), int(_overlaps(found, i)) + int(shown[i] >= MOSTLY), sure

    return max((i for i, name in enumerate(found.names) if name != LOGGED), key=standing)
