"""Whether the gain of a policy changed along the log, and what it is in the latest part.

The gain is a mean over the evaluated episodes, but a policy is deployed after the last of them. If the effect of an action wore
off or reversed, as when users got used to a new layout, the mean may be positive and the gain at the end negative. The gain in
the latest third of the episodes is less precise than the mean over all, so it counts only if it differs from that before by a
test. The difference hardly depends on which policy was chosen, because its error is nearly uncorrelated with that of the mean.
If the latest third no longer shows what the policy does, as where an action was given up, its gain is not known there.

Gains of parts are those of `ope.groups`, by products of weights. Where these are not reliable, and ratios of occupancies
decide, that estimate is compared: its critics and ratios are those of all episodes, and what the latest third pays beyond them
is in its own rows.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import special

from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import OutOfFold
from deadreckon.ope.doubly_robust import Terms, occupancy_terms
from deadreckon.ope.groups import gains_of_parts
from deadreckon.stats import inference
from deadreckon.stats.interval import decimals, fixed, p_in_words, signed

LEVEL = 0.01  # error probability of the test
SHARE = 3  # the latest part is one of so many
UNORDERED = "use --stationary if the order of rows says nothing of time"


class Latest(NamedTuple):
    """The gain of a policy in the latest third of the evaluated episodes.

    Attributes:
        why: the reason why it is not compared with that before; "" if it is.
        p_value: of no difference; NaN if they are not compared.
        before: the gain in the episodes before.
        gain, low, high: the gain, and the ends of its interval, which is infinite if the log has no support there.
    """

    why: str
    p_value: float = np.nan
    before: float = np.nan
    gain: float = np.nan
    low: float = -np.inf
    high: float = np.inf

    @property
    def words(self) -> str | None:
        """What it means for a decision, which then depends on `low`, as a line; None if it means nothing."""
        if self.why and not np.isnan(self.gain):
            return f"its gain in the latest third of the episodes is not known: {self.why}; {UNORDERED}"
        if not self.p_value < LEVEL:
            return None
        before = fixed(self.before, decimals(self.before, self.gain), "+")
        return (
            f"its gain changed along the log ({p_in_words(self.p_value)}): it is {signed(self.gain, self.low, self.high)} in "
            f"the latest third of the episodes, after {before}; {UNORDERED}"
        )

    def as_json(self) -> dict[str, Any]:
        """Its fields; None for numbers that are not known."""
        return {
            name: value if isinstance(value, str) or np.isfinite(value) else None for name, value in self._asdict().items()
        }


def latest(
    case: OPEInput, which: int, model: BehaviorModel, alpha: float, wider: float = 0.0, decides: OutOfFold | None = None
) -> Latest:
    """The gain of one of a case's policies, chosen among them by any rule, in the latest third of the evaluated episodes.

    Args:
        case: log and policies, with the behaviour policy as the last.
        which: index of the policy.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which the interval of any of the policies may miss.
        wider: added at both ends of the interval; see `select.Choice`.
        decides: what critics predict and ratios of occupancies weight, if an estimate by these decides.
    """
    count = len(case.held)
    if case.degenerate[which]:
        return Latest("it has no importance weights")
    if case.data.successors is not None and case.data.lengths.max() > 1:
        return Latest("rows do not follow each other")
    if count < SHARE:
        return Latest("there are too few episodes")
    place = np.argsort(np.argsort(case.held, kind="stable"), kind="stable")
    late = SHARE * place >= (SHARE - 1) * count
    parts = gains_of_parts(case, which, late.astype(int), 2, model)
    before, gain = map(float, parts.mean)
    if parts.lacking[1] and not parts.lacking[0] and parts.units.min() >= UNITS:
        return Latest(parts.lacking[1], before=before, gain=gain)
    level = alpha / len(case.policies)
    if doubt := next(filter(None, parts.why), ""):
        return Latest(doubt) if decides is None else _by_occupancy(case, which, decides, late, level, wider)
    factor = max(inference.simultaneous(parts.influence[:, 1:], level, case.seed), parts.student(level)[1])
    half = parts.inflation[1] * parts.errors[1] * factor + wider
    change = parts.influence[:, 1:] - parts.influence[:, :1]
    apart = inference.errors(change)[0] * (parts.inflation * parts.correction).max()
    if not np.isfinite(half) or not apart > 0.0:
        return Latest("its error is not known")
    p_value = 2.0 * special.stdtr(parts.units.min() - 1, -abs(gain - before) / apart)
    return Latest("", float(p_value), before, gain, float(gain - half), float(gain + half))


def _by_occupancy(case: OPEInput, which: int, decides: OutOfFold, late: np.ndarray, level: float, wider: float) -> Latest:
    """The same at error probability `level` by the terms of an estimate by ratios of occupancies, of the episodes before the
    latest third and of those in it; `late` (episodes,) is true in this."""
    parts, cluster = (~late, late), case.cluster
    count = min(len(np.unique(cluster[part])) for part in parts)
    if count < UNITS:
        return Latest("there are too few episodes")
    own, logged = (occupancy_terms(case, decides, i) for i in (which, len(case.policies)))
    (was, pulls_was), (gain, pulls) = (
        (one - other, pull - pulled)
        for (one, pull), (other, pulled) in ((_of_part(case, terms, part) for terms in (own, logged)) for part in parts)
    )
    wrong = float(case.inflation[which]) * np.sqrt(count / (count - 1))
    error, apart = (wrong * float(np.linalg.norm(each)) for each in (pulls, pulls - pulls_was))
    if not (np.isfinite(apart) and apart > 0.0):
        return Latest("its error is not known")
    p_value = 2.0 * special.stdtr(count - 1, -abs(gain - was) / apart)
    half = error * special.stdtrit(count - 1, 1 - level / 2) + wider
    return Latest("", float(p_value), was, gain, float(gain - half), float(gain + half))


def _of_part(case: OPEInput, terms: Terms, part: np.ndarray) -> tuple[float, np.ndarray]:
    """The value in some episodes, and what each cluster (clusters,) adds to it beyond its share; the sum of squares is the
    variance."""
    rows, clusters = part[case.data.episode_of] & terms.known, int(case.cluster.max()) + 1
    begins, weighted = terms.begins[part], terms.weighted[rows]
    start, mean = float(begins.mean()), float(weighted.mean()) if len(weighted) else 0.0
    pulls = np.bincount(case.cluster[part], begins - start, clusters) / len(begins)
    pulls += np.bincount(case.cluster[case.data.episode_of[rows]], weighted - mean, clusters) / max(len(weighted), 1)
    return start + mean, pulls
