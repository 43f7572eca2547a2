"""Effects of variables according to a fitted model: partial dependence over the data, and cuts through one design.

Partial dependence (Friedman 2001, 8.2) is the model's prediction with one variable set to a value in all rows and the others
unchanged, averaged over rows. If the variable is in a sum that must equal a number, the other terms of the sum are scaled
accordingly, as in Cox's traces for mixtures (Cornell 2002), because a mixture cannot change in only one component.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.doubts import ROUNDED
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.rules import NO_RULES, at_value, written
from deadreckon.randomness import generator
from deadreckon.stats.interval import ALPHA

ROWS = 100  # largest number of rows that are averaged over
VALUES = 15  # number of values of a numeric variable
LEVELS = 12  # largest number of levels of a variable: the most frequent ones
MOST = 40  # largest number of variables
LIKELY = 1_000  # rows, those with the greatest scores, among which the one with the greatest prediction is searched
SOME = 10  # rows by which variables are selected if there are more
SLACK = 1e-6  # tolerance of bounds and sums for rounding errors


@dataclass(frozen=True, eq=False)
class Effect:
    """Predictions as a function of one variable.

    Attributes:
        column: of the variable in the designs.
        values: (g,) of the variable, as designs hold them.
        mean, std: (g,) predictions and their standard deviations; the latter are None if the model has none, and for averages
            also if it was not tested or is without skill.
        change: the greatest minus the least of the means.
        change_std: standard deviation of this difference; None if it is not known.
        rows: the 10th and 90th percentile of the same difference in single rows; None for cuts.
        rows_std: standard deviations of the difference in the two rows nearest to these percentiles; None if not known.
        allowed: (g,) bool: whether the design satisfies bounds, constraints and forbidden combinations; None: not tested.
        freedom: degrees of freedom of the standard deviations, which are few if these are estimated from the members of an
            ensemble; else infinite.
    """

    column: int
    values: np.ndarray
    mean: np.ndarray
    std: np.ndarray | None
    change: float
    change_std: float | None = None
    rows: tuple[float, float] | None = None
    rows_std: tuple[float, float] | None = None
    allowed: np.ndarray | None = None
    freedom: float = np.inf

    @property
    def half(self) -> float:
        """Half the width of a 95 % interval, in standard deviations (Student's t)."""
        return critical(1, self.freedom)

    def distinct(self, variables: int) -> bool | None:
        """Whether the average change is significant, at 5 % for so many variables together; None: not known."""
        return None if self.change_std is None else self.change > critical(variables, self.freedom) * self.change_std

    def depends(self, variables: int) -> bool:
        """Whether a change that is not significant on average is significant in a single row: it depends on other variables."""
        if self.rows is None or self.rows_std is None or self.distinct(variables) is not False:
            return False
        most = critical(2 * variables, self.freedom)
        return any(abs(change) > most * std for change, std in zip(self.rows, self.rows_std))


def critical(tests: int, freedom: float = np.inf) -> float:
    """Critical value of a difference, in standard deviations: at 5 % for all tests together (Bonferroni), by Student's t
    distribution with `freedom` degrees of freedom."""
    return float(-stdtrit(freedom, ALPHA / 2 / max(tests, 1)))


def averages(data: Designs, fitted: Fitted) -> list[Effect]:
    """Partial dependence on each variable over at most `ROWS` rows, the greatest change first; at most `MOST` variables.

    Variables that are the same in all rows are left out, because their effect is not known.
    """
    columns = np.flatnonzero(np.ptp(data.x, axis=0) > 0)
    if len(columns) > MOST:
        columns = _most_changing(data, fitted, columns)
    x = data.x[drawn(data, ROWS)].astype(np.float64)
    found = [_average(data, fitted, x, int(column)) for column in columns]
    return sorted(found, key=lambda each: -each.change)


def drawn(data: Designs, count: int) -> np.ndarray:
    """At most `count` rows of the data, drawn with a fixed seed."""
    if len(data) <= count:
        return np.arange(len(data))
    return np.sort(generator(0, "rows of effects").choice(len(data), count, replace=False))


def _average(data: Designs, fitted: Fitted, x: np.ndarray, column: int) -> Effect:
    values = grid(data, column)
    groups = np.stack([with_value(data, x, column, value) for value in values])
    each, covariance = fitted.average(groups)
    mean = each.mean(1)
    low, high = int(mean.argmin()), int(mean.argmax())
    change = each[high] - each[low]
    some = np.argsort(change, kind="stable")[np.round(np.array([0.1, 0.9]) * (len(change) - 1)).astype(int)]
    std = spread = rows_std = None
    if covariance is not None:
        std, spread = np.sqrt(np.maximum(np.diag(covariance), 0.0)), _std_of_difference(covariance, low, high)
        single = [fitted.average(groups[[low, high], row : row + 1])[1] for row in some]
        rows_std = _pair(_std_of_difference(of, 0, 1) for of in single if of is not None)
    rows = _pair(map(float, change[some]))
    change = float(mean[high] - mean[low])
    return Effect(column, values, mean, std, change, spread, rows, rows_std, freedom=fitted.freedom)


def _pair(values: Iterable[float]) -> tuple[float, float]:
    first, second = values
    return first, second


def _std_of_difference(covariance: np.ndarray, i: int, j: int) -> float:
    return float(np.sqrt(max(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j], 0.0)))


def _most_changing(data: Designs, fitted: Fitted, columns: np.ndarray) -> np.ndarray:
    """The `MOST` columns for which the average over `SOME` rows changes most between least, middle and greatest value."""
    x = data.x[drawn(data, SOME)].astype(np.float64)
    change = np.empty(len(columns))
    for i, column in enumerate(columns):
        values = grid(data, int(column))
        values = values[np.unique([0, len(values) // 2, len(values) - 1])]
        mean = fitted.predict(np.concatenate([with_value(data, x, int(column), value) for value in values]))[0]
        change[i] = np.ptp(mean.reshape(len(values), -1).mean(1))
    return columns[np.argsort(-change, kind="stable")[:MOST]]


def cuts(data: Designs, fitted: Fitted, design: np.ndarray, columns: list[int]) -> list[Effect]:
    """Cuts through a design (variables,): one variable changes within its bounds, also beyond the data; the others are held.

    Only other terms of a sum change, if they are not fixed, so that the sum is kept.
    """
    found, fixed = [], {column for column, _ in data.rules.fixed}
    for column in columns:
        values = np.unique(np.append(grid(data, column, bounds=True), design[column]))
        x = with_value(data, np.repeat(design[None].astype(np.float64), len(values), 0), column, values, fixed)
        mean, std = fitted.predict(x)
        found.append(Effect(column, values, mean, std, float(np.ptp(mean)), allowed=allowed(data, x)))
    return found


def grid(data: Designs, column: int, bounds: bool = False) -> np.ndarray:
    """(g,) ascending values of a variable: evenly spaced in the range of the data (or bounds), whole numbers, or levels."""
    v, seen = data.variables[column], data.x[:, column].astype(np.float64)
    if v.leveled:
        count = np.bincount(seen.astype(int), minlength=len(v.levels))
        return np.sort(np.argsort(-count, kind="stable")[:LEVELS]).astype(np.float64)
    low, high = seen.min(), seen.max()
    if bounds:
        low, high = (b if np.isfinite(b) else s for b, s in ((min(v.low, low), low), (max(v.high, high), high)))
    values = np.geomspace(low, high, VALUES) if v.log else np.linspace(low, high, VALUES)
    return np.unique(np.round(values)) if v.kind == "integer" else values


def with_value(data: Designs, x: np.ndarray, column: int, value: float | np.ndarray, held: Collection[int] = ()) -> np.ndarray:
    """(rows, variables) designs with a value of a variable, and the other terms of equalities scaled to keep the sums.

    Terms that reach a bound are held there, as long as others can compensate. Steps are not kept: the designs are for
    predictions, and `allowed` returns which of them satisfy the rules.

    Args:
        data: scored designs, with the rules.
        x: (rows, variables) designs.
        column: of the variable.
        value: of the variable, the same in all rows or (rows,).
        held: columns that are not changed, as those with fixed values in proposals. In rows of the data these may have any
            value, and change like others.
    """
    x = np.array(x, np.float64)
    x[:, column] = value
    for each in data.rules.linear:
        weights = {c: float(w) for c, w in each.weights}
        if not each.equal or column not in weights:
            continue
        others = [c for c in weights if c != column and c not in held and data.variables[c].kind == "continuous"]
        if not others:
            continue
        rest = np.array([0.0 if c in others else weights.get(c, 0.0) for c in range(x.shape[1])])
        left = float(each.bound) - data.repair.measured(x) @ rest
        low, high = (np.array([getattr(data.variables[c], end) for c in others]) for end in ("low", "high"))
        x[:, others] = _scaled(x[:, others], np.array([weights[c] for c in others]), left, low, high)
    return x


def _scaled(part: np.ndarray, weight: np.ndarray, total: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(rows, n) numbers scaled so that their weighted sums are (rows,) totals, within bounds where that is possible.

    Those that are all 0 share the total equally.
    """
    plain, held = _to_sum(part, weight, total, np.zeros(part.shape, bool)), np.zeros(part.shape, bool)
    found = plain
    for _ in range(part.shape[1]):
        clipped = np.clip(found, low, high)
        held |= clipped != found
        found = np.where(held, clipped, part)
        found = _to_sum(found, weight, total, held)
    whole = (np.abs(found @ weight - total) < SLACK) & (found >= low - SLACK).all(1) & (found <= high + SLACK).all(1)
    return np.where(whole[:, None], found, plain)


def _to_sum(part: np.ndarray, weight: np.ndarray, total: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The numbers that are not held, scaled so that the weighted sums of all are the totals."""
    left = total - (part * held) @ weight
    sums, count = (part * ~held) @ weight, np.maximum((~held).sum(1), 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(np.abs(sums)[:, None] > 1e-9, part * (left / sums)[:, None], (left / count)[:, None] / weight)
    return np.where(held, part, scaled)


def keeping(data: Designs) -> np.ndarray:
    """(rows,) bool: which designs of the data satisfy all rules of proposals but steps, sums up to the rounding of terms."""
    return allowed(data, data.x.astype(np.float64), rounded=True)


def on_steps(data: Designs) -> np.ndarray:
    """(rows,) bool: which designs of the data have multiples of the steps of all variables that have one."""
    return np.array([NO_RULES.broken(data.variables, row) is None for row in written(data.variables, data.x)], bool)


def permitted(data: Designs) -> np.ndarray:
    """(rows,) bool: which designs of the data satisfy all rules of proposals but steps; all if none does.

    The scores of other designs are no reference for the gain by proposals.
    """
    good = keeping(data)
    return good if good.any() else np.ones(len(data), bool)


def best_permitted(data: Designs) -> int:
    """The row of the greatest score among those that satisfy the rules."""
    return int(np.where(permitted(data), data.y, -np.inf).argmax())


def most_expected(data: Designs, fitted: Fitted) -> tuple[int, float]:
    """The measured row with the greatest prediction among those that satisfy the rules, and that prediction.

    The greatest of many measurements is partly due to noise, and a prediction is not: the predicted gain of a proposal over the
    data is therefore a difference of two predictions. Only the `LIKELY` rows with the greatest scores are considered.
    """
    good = permitted(data)
    rows = np.flatnonzero(good)[np.argsort(-data.y[good], kind="stable")[:LIKELY]]
    mean = fitted.predict(data.x[rows])[0]
    return int(rows[mean.argmax()]), float(mean.max())


def allowed(data: Designs, x: np.ndarray, rounded: bool = False) -> np.ndarray:
    """(rows,) bool: which designs satisfy bounds, fixed values, linear constraints and forbidden combinations, up to rounding
    errors.

    Args:
        data: scored designs, with the rules.
        x: (rows, variables) designs.
        rounded: whether they are from a table, whose decimals are rounded: 0.33, 0.33 and 0.33 count as a mixture.
    """
    good = data.repair.allowed(x)
    for column, fixed in data.rules.fixed:
        good &= at_value(x[:, column], fixed)
    for i, v in enumerate(data.variables):
        if not v.leveled:
            slack = SLACK * np.maximum(np.abs(data.x[:, i]).max(), np.abs(x[:, i]))
            good &= (x[:, i] >= v.low - slack) & (x[:, i] <= v.high + slack)
    measured = data.repair.measured(x)
    for each in data.rules.linear:
        terms, bound = np.stack([float(w) * measured[:, c] for c, w in each.weights]), float(each.bound)
        total, size = terms.sum(0), np.maximum(np.abs(terms).sum(0), abs(bound))  # terms may be of any unit
        slack = 100 * SLACK * size
        if each.equal and rounded:
            slack = ROUNDED * size
        good &= (np.abs(total - bound) <= slack) if each.equal else (total <= bound + slack)
    return good
