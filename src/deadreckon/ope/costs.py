"""Costs of policies: totals of columns other than the reward, with intervals, and limits of these totals.

The total of a cost is a value with the cost in place of the reward: sum_t discount^t c_t by the same estimand and estimator, on
the same episodes. Models that do not depend on rewards, such as propensities, are fitted once for both.

Intervals hold for all policies and all costs at once (Bonferroni over costs), at the level of the decision. A policy whose
upper end is above a limit is not deployed. So the probability of deploying one that costs more than its limit is at most
alpha / 2, beside the probability alpha / 2 of deploying one that is no gain. A total that is the same in every episode has no
upper end: if a cost never occurred, the log shows neither how rare nor how large it is. In logs of single steps, large costs of
the log that are missing from a policy's rows by chance are added to its upper end; costs that the whole log lacks are not, so
that the probability holds only if costs of every size that occurs are in the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.ope.basis import Basis
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.importance import counting, log_ratios
from deadreckon.ope.losses import lacking
from deadreckon.ope.select import doubted, gains
from deadreckon.ope.support import Support
from deadreckon.stats.interval import level_in_words

NAMES = ("cost", "costs")  # extra columns that are costs by their name alone, as in DSRL
ROUNDING = 1e-9  # relative size of rounding errors in an influence function that is zero
ALIKE = "in every evaluated episode with a weight for it the total is {:.4g}; how rare other totals are is not known"
_SHARED = (
    "propensities", "behavior", "behavior policy", "coverage", "table", "features", "next", "initial", "current", "final",
)  # fmt: skip


class Cost(NamedTuple):
    """The total of one cost.

    Attributes:
        column: of the log.
        limit: that the total must not exceed; None: no limit.
        ends: (policies, 3) totals with lower and upper ends, of the behaviour policy last.
        warnings: of the estimate, one line each.
        discount: per step, the same as for the value; 1 where episodes have one step.
        unknown: for each policy the reason why its total is not known, a phrase, or an empty text; may be left out.
    """

    column: str
    limit: float | None
    ends: np.ndarray
    warnings: tuple[str, ...]
    discount: float = 1.0
    unknown: tuple[str, ...] = ()

    @property
    def told(self) -> str:
        """The column, and its discount if it has one."""
        return self.column if self.discount == 1 else f"{self.column}, discounted by {self.discount:g} per step,"

    def words(self, which: int, level: float) -> str:
        """The total of a policy, beside that of the behaviour policy, in a line."""
        (value, low, high), logged = self.ends[which], self.ends[-1][0]
        within = "" if self.limit is None else f", limit {self.limit:g}"
        between = f"{value:.4g} [{low:.4g}, {high:.4g}] ({level_in_words(level)}, for all policies at once{within})"
        return f"its {self.told} is {between}; that of the behaviour policy is {logged:.4g}"

    def objection(self, which: int, level: float) -> str | None:
        """Why a policy may cost too much; None where it does not, or there is no limit."""
        value, low, high = self.ends[which]
        if self.limit is None or high <= self.limit:
            return None
        if not np.isfinite(high):
            why = f": {self.unknown[which]}" if self.unknown and self.unknown[which] else ""
            return f"it is not known whether its {self.told} stays within {self.limit:g}{why}"
        between = f"{value:.4g} [{low:.4g}, {high:.4g}] ({level_in_words(level)})"
        return f"its {self.told} is {between}, which may be above its limit of {self.limit:g}"


def cost_columns(log: Dataset) -> tuple[str, ...]:
    """The further columns of a log that are costs: by its schema, or called cost or costs."""
    schema = log.provenance.extra.get("schema", {}).get("columns", {})
    named = [name for name, told in schema.items() if told.get("role") == "cost"]
    return tuple(name for name in log.extras if name in named or name in NAMES)


def limits_of(given: float | Mapping[str, float] | Sequence[str] | None, log: Dataset) -> dict[str, float | None]:
    """{column: limit, or None} of all costs of a log.

    Args:
        given: one limit, where there is one cost; {column: limit}; or one or several texts such as energy=25, or 25 alone.
        log: whose costs are meant.

    Raises:
        UserError: a column that is no cost, or a limit that is no number.
    """
    columns = cost_columns(log)
    given = [given] if isinstance(given, str) else given
    found: dict[str, float | None] = dict.fromkeys(columns)
    pairs: list[tuple[str, Any]] = []
    if isinstance(given, Mapping):
        pairs = list(given.items())
    elif isinstance(given, int | float | Real):  # NumPy's numbers are Real
        pairs = [("", given)]
    elif given is not None:
        pairs = [(column, limit) for column, _, limit in (str(each).rpartition("=") for each in given)]
    for column, limit in pairs:
        if not columns:
            text = "a cost limit needs a column of costs, which the log does not have; name it when it is read (--cost COLUMN)"
            raise UserError(f"{log.name}: {text}")
        if not column and limit in columns:
            raise UserError(f"--cost-limit {limit}: a cost needs a limit, such as {limit}=25")
        if not column and len(columns) > 1:
            raise UserError(f"--cost-limit {limit}: the log has several costs; say which, such as {columns[0]}={limit}")
        column = column or next(iter(columns))
        if column not in found:
            raise UserError(f"{log.name}: {unknown('cost', column, columns)}")
        if found[column] is not None:
            raise UserError(f"--cost-limit {column}={limit}: {column} has the limit {found[column]:g} already; give one")
        try:
            number = float(limit)
        except (TypeError, ValueError):
            number = np.nan
        if isinstance(limit, bool) or not np.isfinite(number):
            raise UserError(f"--cost-limit {column}: a limit is a finite number, got {limit!r}")
        found[column] = number
    return found


def costs_of(
    case: OPEInput, estimator: Estimator, support: Support, limits: Mapping[str, float | None], alpha: float,
    model: BehaviorModel,
) -> list[Cost]:  # fmt: skip
    """The totals of costs of a case's policies.

    Args:
        case: log and policies, with the behaviour policy.
        estimator: the one that also decides about the value.
        support: of the policies in the log.
        limits: {column: limit, or None}.
        alpha: share of logs for which one of the intervals may miss.
        model: settings of the behaviour model, if propensities were not logged.

    Raises:
        UserError: a cost with several numbers per row.
    """
    found = []
    for column, limit in limits.items():
        own = _with_cost(case, column)
        told = estimator.on(own)
        share = alpha / len(limits)
        reliable = doubted(told, support)[1]
        unknown = _unknown(told, own)
        rare = _rare(told, own, model, share, [known and not why for known, why in zip(reliable, unknown)])
        unknown = tuple(why or other for why, (other, _) in zip(unknown, rare))
        ends = totals(told, share, reliable & [not why for why in unknown])
        ends[:, 2] += [shift for _, shift in rare]
        discount = case.estimand.discount if case.given.lengths.max() > 1 and case.estimand.horizon != 1 else 1.0
        found.append(Cost(column, limit, ends, told.warnings, discount, unknown))
    return found


def _unknown(found: Estimates, case: OPEInput) -> tuple[str, ...]:
    """For each policy the reason why its total has no interval, a phrase; empty if it has one."""
    returns = case.data.returns(case.discount)
    same = np.full(len(found.names), np.ptp(returns) == 0.0)
    if found.influence is not None:  # a policy's weighted episodes may all be without the cost
        with np.errstate(over="ignore", invalid="ignore"):  # products of weights may overflow; then nothing is known
            same |= found.influence.std(0) <= ROUNDING * np.maximum(np.abs(found.value), np.abs(returns).max())
    if found.ess is not None:  # a policy without any weight has that as its reason
        same &= found.ess > 0
    settled = found.diagnostics.get("settled", np.ones(len(found.names)))
    return tuple(
        ALIKE.format(value) if alone else "" if known >= 1 else "the fit of its estimate has not converged"
        for value, alone, known in zip(found.value, same, settled)
    )


def _rare(
    found: Estimates, case: OPEInput, model: BehaviorModel, alpha: float, known: Sequence[bool]
) -> list[tuple[str, float]]:
    """For each policy the effect of costs that are missing from its rows by chance, in logs of single steps; see `losses`.

    If all of its rows have the same cost, the reason why its total is not known. Otherwise what is added to the upper end: an
    upper limit of the mean excess of the log's costs over the largest cost of the policy's rows.

    Args:
        found: the estimates.
        case: log and policies, with the cost as reward.
        model: settings of the behaviour model, if propensities were not logged.
        alpha: share of logs for which one of the intervals may miss.
        known: for each policy whether it has an interval otherwise.
    """
    out = [("", 0.0)] * len(found.names)
    if case.data.lengths.max() > 1 or found.ess is None:
        return out
    costs = np.asarray(case.data.rewards, np.float64)
    rows = counting(log_ratios(case, "auto", model, None)[: len(case.policies)])
    places = [i for i, name in enumerate(found.names) if name != LOGGED]
    for own, i, degenerate in zip(rows, places, case.degenerate):
        if degenerate or not known[i] or not own.any():
            continue
        most, alike = costs[own].max(), np.ptp(costs[own]) == 0.0
        lacks = lacking(case, np.maximum(costs - most, 0.0), Basis.of(found, i).rest[0], alpha / len(rows))
        if lacks.chance > alpha / 2 / len(rows):
            out[i] = (ALIKE.format(most), 0.0) if alike else ("", lacks.most)
    return out


def totals(found: Estimates, alpha: float, known: np.ndarray) -> np.ndarray:
    """(policies, 3) values and ends of their simultaneous intervals, computed as gains over a policy with the exact value 0."""
    zero = lambda part: None if part is None else np.concatenate([part, np.zeros_like(part[..., :1])], -1)  # noqa: E731
    one = lambda part, last: None if part is None else np.append(part, last)  # noqa: E731
    value = zero(found.value)
    assert value is not None
    beside = replace(
        found, names=(*map(str, range(len(found.names))), LOGGED), value=value, influence=zero(found.influence),
        bootstrap=zero(found.bootstrap), nuisance=zero(found.nuisance), ess=one(found.ess, np.inf),
        inflation=one(found.inflation, 1.0), diagnostics={name: np.append(own, 0.0) for name, own in found.diagnostics.items()},
    )  # fmt: skip
    return gains(beside, alpha, np.append(known, True))[:-1]


def _with_cost(case: OPEInput, column: str) -> OPEInput:
    """The case with a cost in place of the reward."""
    costs = np.asarray(case.given.extras[column], np.float64).reshape(len(case.given), -1)
    if costs.shape[1] != 1:
        raise UserError(f"{case.given.name}: cost {column} has {costs.shape[1]} numbers per row, one is needed")
    return case.of_rewards(costs[:, 0].astype(np.float32), _SHARED)


def as_json(costs: Sequence[Cost]) -> list[dict[str, Any]]:
    """The attributes of each `Cost` as JSON values."""
    return [each._asdict() | {"ends": each.ends.tolist(), "warnings": list(each.warnings)} for each in costs]
