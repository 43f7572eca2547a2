"""The gain of one policy in each group of episodes.

Groups are defined by a column that is known before an episode's first action, such as a site or a kind of customer: groups that
depend on actions would introduce selection bias. The score of an episode is that of the plain doubly robust estimate
with critics out of fold (`dr-linear`), minus the same of the behaviour policy. Its mean over a group is the gain there, because
weights average one and critics are corrected given the first observation. Intervals hold simultaneously for all groups, and for
all policies among which this one may have been chosen on the same episodes (Bonferroni).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import special

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import groups as groups_of
from deadreckon.errors import UserError
from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import WEIGHTLESS, OPEInput
from deadreckon.ope.doubly_robust import DoublyRobust, stretched
from deadreckon.ope.importance import learns, log_ratios
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.support import MISSING, Support, mean_weights, missing_by_row
from deadreckon.stats import inference
from deadreckon.stats.interval import ALPHA


class Groups(NamedTuple):
    """Groups of a log's episodes.

    Attributes:
        column: that defines them.
        names: one each.
        codes: (episodes of the log,) number of each episode's group.
    """

    column: str
    names: tuple[str, ...]
    codes: np.ndarray

    @classmethod
    def of(cls, data: Dataset, column: str) -> "Groups":
        """The groups defined by a column of a log.

        Raises:
            UserError: an unknown column, or one that changes within an episode.
        """
        values, codes = groups_of(data, column)
        return cls(column, tuple(map(str, values)), codes)

    def check(self, data: Dataset) -> None:
        """Refuses groups of another log.

        Raises:
            UserError: there are not as many numbers as episodes.
        """
        if np.shape(self.codes) != (data.episodes,):
            raise UserError(
                f"subgroups by {self.column} must be a number for each of {data.episodes:,} episodes of {data.name}, got shape "
                f"{np.shape(self.codes)}"
            )


def by_group(
    case: OPEInput, which: int, groups: Groups, model: BehaviorModel, alpha: float = ALPHA, wider: float = 0.0
) -> list[dict[str, Any]]:
    """The gain of one of a case's policies, chosen among them by any rule, in each group, as JSON values: an unknown end is
    None, and `why` has the reason.

    The requirements of `select` for all episodes apply to each group: there must be enough episodes, the weights must be based
    on enough of them, and the log must support the policy's actions there.

    Args:
        case: log and policies, with the behaviour policy as the last.
        which: index of the policy.
        groups: of the log's episodes.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which one of the intervals of any of the policies may miss.
        wider: added at both ends; see `select.Choice`.

    Raises:
        UserError: degenerate weights.
    """
    groups.check(case.log)
    parts = gains_of_parts(case, which, groups.codes[case.held], len(groups.names), model)
    known = np.array([line == "" for line in parts.why])
    level = alpha / len(case.policies)
    factor = inference.simultaneous(parts.influence[:, known], level, case.seed)
    student = parts.student(level / max(int(known.sum()), 1))
    half = parts.inflation * parts.errors * np.maximum(factor, student) + wider
    known &= np.isfinite(half)
    return [
        {"name": name, "episodes": int(size), "gain": float(mean) if size else None,
         "low": float(mean - half[g]) if known[g] else None, "high": float(mean + half[g]) if known[g] else None,
         "why": parts.why[g] or None}
        for g, (name, size, mean) in enumerate(zip(groups.names, parts.size, parts.mean))
    ]  # fmt: skip


class Parts(NamedTuple):
    """The gain of one policy in each part of a case's evaluated episodes.

    Attributes:
        mean: (parts,) the gain.
        influence: (units, parts) influence function of it at each unit; see `Estimates.influence`.
        inflation: (parts,) factors of the errors beyond the influence function; infinite if no interval is valid.
        size: (parts,) number of episodes.
        units: (parts,) number of units with episodes in the part.
        weak: for each part the reasons why its weights are not reliable, "" if they are.
        lacking: for each part that the log has no support for the policy's actions there; "" if it has, or is continuous.
    """

    mean: np.ndarray
    influence: np.ndarray
    inflation: np.ndarray
    size: np.ndarray
    units: np.ndarray
    weak: list[str]
    lacking: list[str]

    @property
    def why(self) -> list[str | None]:
        """For each part the reasons why its gain is not known, "" if it is; None if it has no episodes."""
        each = zip(self.size, self.weak, self.lacking)
        return ["; ".join(filter(None, (weak, lacking))) if size else None for size, weak, lacking in each]

    @property
    def errors(self) -> np.ndarray:
        """(parts,) standard errors without `inflation`; units without episodes in a part do not contribute to its variance."""
        return inference.errors(self.influence) * self.correction

    @property
    def correction(self) -> np.ndarray:
        """(parts,) factors of errors for the degrees of freedom of the units of each part instead of those of all units."""
        return (self.units / np.maximum(self.units - 1, 1)) ** 0.5

    def student(self, level: float) -> np.ndarray:
        """(parts,) two-sided quantiles of Student's t at error probability `level`, by the units of each part."""
        return special.stdtrit(np.maximum(self.units - 1, 1), 1 - level / 2)


def gains_of_parts(case: OPEInput, which: int, code: np.ndarray, parts: int, model: BehaviorModel) -> Parts:
    """The gain of one of a case's policies in each part of the evaluated episodes.

    Args:
        case: log and policies, with the behaviour policy as the last.
        which: index of the policy.
        code: (evaluated episodes,) number of each one's part, which does not depend on actions or rewards.
        parts: number of parts.
        model: settings of the behaviour model, if propensities were not logged.

    Raises:
        UserError: degenerate weights.
    """
    if case.degenerate[which]:
        raise UserError(f"gains by subgroup {WEIGHTLESS}")
    unit, units = case.episodes.group, case.episodes.groups
    size = np.bincount(code, minlength=parts)
    found, _ = DoublyRobust(kind="dr", fqe=LinearFQE(), model=model).nuisances(case)
    row, logged = log_ratios(case, "auto", model, None)[which], len(case.policies)
    score, beyond = found.begins[which] - found.begins[logged], np.ones(len(size))
    # Recordings of different parts may have different lengths, so each part has its own probability of a cut-off.
    for g in np.flatnonzero(size):
        part = code == g
        rows, episodes = part[case.data.episode_of], case.episodes_of(part)
        along = episodes.cumulate(row[rows])
        with np.errstate(over="ignore", invalid="ignore"):  # products of weights may overflow
            score[part] += episodes.contributions(along, found.errors[which, rows])
            score[part] -= episodes.contributions(np.zeros_like(along), found.errors[logged, rows])
        stretch = stretched([case.beyond_of(along, episodes)])
        beyond[g] = 1.0 if stretch is None else stretch[0]
    mean = np.bincount(code, score, parts) / np.maximum(size, 1)
    # A unit influences the mean of a part by those of its episodes that are in the part.
    influence = np.zeros((units, parts))
    np.add.at(influence, (unit, code), units * (score - mean[code]) / size[code])
    missing = missing_by_row(case, model)[:, which] if case.data.spec.discrete else None
    doubts = [_doubts(case, row, missing, code == g) if size[g] else ("", "") for g in range(len(size))]
    weak, lacking = (list(each) for each in zip(*doubts))
    own = np.array([len(np.unique(unit[code == g])) for g in range(len(size))])
    return Parts(mean, influence, case.inflation[which] * beyond, size, own, weak, lacking)


def _doubts(case: OPEInput, log_ratios: np.ndarray, missing: np.ndarray | None, some: np.ndarray) -> tuple[str, str]:
    """Reasons why a policy's gain in a part is not known: that weights are not reliable, and that actions have no support; each
    "" if there is no reason. For continuous actions support is checked by weights alone.

    Args:
        case: log and policies.
        log_ratios: (rows,) log of pi(a|s) / beta(a|s) of each logged action.
        missing: (rows,) share of the policy's actions there that have no support; None where actions are continuous.
        some: (episodes,) bool, the part.
    """
    rows = some[case.data.episode_of]
    unit = np.unique(case.units[case.data.episode_of[rows]], return_inverse=True)[1]
    ratio, low, high = mean_weights(log_ratios[None, rows], unit)
    share = np.array([np.nan if missing is None else missing[rows].mean()])
    shown = Support(share, ratio, high, np.zeros(1, bool), None if learns(case, "auto") else low)
    told = shown.objections(0)
    lacking = told[:1] if share[0] > MISSING else []
    weak = [*Basis.of_weights(case, log_ratios, some, whole=False).unreliable, *told[len(lacking) :]]
    return "; ".join(weak), "; ".join(lacking)
