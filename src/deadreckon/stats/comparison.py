"""Comparisons of two methods, of two sets of tasks, of groups of runs, or of all methods of a table (the bold cells)."""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri, stdtr, stdtrit

from deadreckon.errors import UserError
from deadreckon.stats.by_task import Scores, by_task, check_level, pairs_of, same_tasks
from deadreckon.stats.interval import ALPHA, LEVEL, Interval, same

_SIDES = "our scores", "their scores"


@dataclass(frozen=True)
class Difference(Interval):
    """Our mean minus theirs, with its interval.

    Attributes:
        p: two-sided p-value, for the hypothesis that there is no difference.
        p_better: one-sided p-value, for the hypothesis that ours is not better.
        dof: degrees of freedom of Student's t.
    """

    p: float
    p_better: float
    dof: float


def paired(ours: Scores, theirs: Scores, level: float = LEVEL) -> Difference:
    """Mean over tasks of the mean difference between runs of the same seed, with Student's t interval and p.

    Run i of ours and run i of theirs share a seed. Each task's mean difference has the variance s^2 / n of its own
    differences, and the mean over T tasks that of their sum / T^2, with degrees of freedom after Welch and Satterthwaite;
    for one task it is the paired t-test. Tasks are fixed and only runs are random, as in `scores.interval`: a t-test over
    all differences together would count it as noise that a method gains more on one task than on another, and one over the
    tasks' means generalises to tasks that were not run. Unlike the bootstrap it is valid for few seeds, if differences are
    roughly normal. Seeds are taken as independent between tasks, whose data and networks differ. A task of one run makes limits
    and p NaN. If differences are equal within every task, the standard error is zero, and p is 0, or 1 if their mean is zero.

    Raises:
        UserError: different tasks or numbers of runs, or what `scores.interval` raises.
    """
    check_level(level)
    return _mean_of(_gaps(ours, theirs), level)


def over_tasks(scores: Scores, level: float = LEVEL) -> Interval:
    """Mean over tasks of the means over runs, with Student's interval: as `paired`, of one method. Runs that are the same on
    every task show no spread, and have no interval.

    Raises:
        UserError: what `scores.interval` raises.
    """
    check_level(level)
    tasks = list(by_task(scores, "scores").values())
    found = _mean_of(tasks, level)
    ends = (math.nan, math.nan) if all(map(same, tasks)) else (found.low, found.high)
    return Interval(found.value, *ends)


def _mean_of(tasks: Sequence[np.ndarray], level: float) -> Difference:
    """The mean of the tasks' means of (runs,) numbers, with what their variances say of it; see `paired`."""
    value = float(np.mean([_moments(runs)[0] for runs in tasks]))
    if min(map(len, tasks)) < 2:
        return Difference(value, *[math.nan] * 5)
    return _student(value, *_pool([(_moments(runs)[1] / len(tasks) ** 2, len(runs) - 1) for runs in tasks]), level)


def _gaps(ours: Scores, theirs: Scores) -> list[np.ndarray]:
    """Differences between runs of the same seed, for each task."""
    pairs = pairs_of(ours, theirs)
    for task, x, y in pairs:
        if len(x) != len(y):
            raise UserError(
                f"paired runs share seeds, but task {task!r} has {len(x)} runs of ours and {len(y)} of theirs: "
                "give as many, or use probability_of_improvement"
            )
    return [gap_of(x, y) for _, x, y in pairs]


def gap_of(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(runs,) differences x - y, which are exactly equal where they are but for rounding."""
    gap = x - y
    return np.full(len(gap), gap[0]) if same(gap, max(np.abs(x).max(), np.abs(y).max())) else gap


def paired_within(ours: Scores, theirs: Scores, extent: float, level: float = LEVEL) -> Interval:
    """As `paired`, for scores within a range: tasks whose differences are all the same are not taken as certain.

    Student's interval has no width where a metric such as the regret is the same in every run, though other runs may differ. Of
    n differences that are all c, another value has a probability of at most q = 1 - a^(1/n), at level 1 - a (Clopper and
    Pearson 1934); as differences lie between -extent and extent, the task's mean lies between c - q (extent + c) and
    c + q (extent - c). The level is shared in equal parts (Bonferroni) by Student's interval of the other tasks and by each of
    these.

    Args:
        ours, theirs: as in `paired`.
        extent: greatest minus least value that a score can have.
        level: of the interval.

    Raises:
        UserError: differences beyond the extent, or what `paired` raises.
    """
    check_level(level)
    gaps = _gaps(ours, theirs)
    if (most := max(float(np.abs(gap).max()) for gap in gaps)) > extent:
        raise UserError(f"a difference of {most:g} is beyond the range of the scores, which is {extent:g} wide")
    same = [gap for gap in gaps if np.ptp(gap) == 0.0]
    miss = (1.0 - level) / (1 + len(same))
    found = paired(ours, theirs, 1.0 - miss)
    low, high = found.low, found.high
    for gap in same:
        other = 1.0 - miss ** (1.0 / len(gap))
        low -= other * (extent + float(gap[0])) / len(gaps)
        high += other * (extent - float(gap[0])) / len(gaps)
    return Interval(found.value, low, high)


def more_runs(found: Difference, runs: int, bound: float, level: float = LEVEL, wanted: float | None = None) -> int | None:
    """Number of further runs of each task with which the interval of `paired` excludes a bound, if mean and variances stay.

    Args:
        found: result of `paired`.
        runs: number of runs of each task.
        bound: such as 0.
        level: of `found`.
        wanted: level of the interval that is to exclude the bound; None: the same.

    Returns:
        0 where the bound lies outside already; None where it is the mean itself, to a millionth of the interval, or where
        there is no interval.
    """
    check_level(level)
    check_level(wanted := level if wanted is None else wanted)
    distance = abs(found.value - bound)
    if not distance > 1e-6 * (found.high - found.value):
        return None

    def half(count: int) -> float:
        """Half-width of the interval for a number of runs, to which degrees of freedom are proportional."""
        first, now = (float(stdtrit(found.dof * (each - 1) / (runs - 1), (1 + at) / 2))
                      for each, at in ((runs, level), (count, wanted)))  # fmt: skip
        return (found.high - found.value) * now / first * math.sqrt(runs / count)

    counts = range(runs, 2 + math.ceil(runs * (half(runs) / distance) ** 2))
    return bisect_left(counts, True, key=lambda count: half(count) < distance)


def between(ours: Scores, theirs: Scores, level: float = LEVEL) -> Difference:
    """Mean over our tasks less the mean over theirs, which are other tasks, with Welch's t interval and p.

    Here tasks are random, and the runs of each are averaged first: it tests whether tasks like ours have greater scores than
    tasks like theirs. One task on a side makes limits and p NaN. For two sets of runs, with each run given as a separate task,
    it is Welch's test.

    Raises:
        UserError: what `scores.interval` raises.
    """
    check_level(level)
    sides = [np.array([runs.mean() for runs in by_task(scores, name).values()]) for scores, name in zip((ours, theirs), _SIDES)]
    value = float(sides[0].mean() - sides[1].mean())
    if min(map(len, sides)) < 2:
        return Difference(value, *[math.nan] * 5)
    return _student(value, *_pool([(_moments(side)[1], len(side) - 1) for side in sides]), level)


def variance_ratio(blocks: Sequence[np.ndarray], level: float = LEVEL) -> Interval:
    """Variance between groups over the variance between runs of one group, with its exact interval if runs are normal.

    Groups are compared within their block alone, such as logs within their task. It is the ratio of the components of
    variance of a one-way analysis of variance, (F - 1) / n for n runs a group, which is 0 where groups do not differ (Searle,
    Casella and McCulloch 1992, section 3.6). The lower limit is above 0 where the F test is significant at (1 - level) / 2.
    Runs that are the same within every group make all NaN.

    Args:
        blocks: each (groups, n), of two or more groups and of two or more runs, with the same n.
        level: of the interval.

    Raises:
        UserError: no block, or one of another shape.
    """
    check_level(level)
    runs = blocks[0].shape[-1] if blocks else 0
    if runs < 2 or any(block.ndim != 2 or len(block) < 2 or block.shape[1] != runs for block in blocks):
        shapes = ", ".join(str(block.shape) for block in blocks) or "none"
        raise UserError(f"blocks must have two or more groups, and two or more runs a group, as many in all; got {shapes}")
    freedoms = sum(len(block) - 1 for block in blocks), sum(len(block) * (runs - 1) for block in blocks)
    among = runs * sum(len(block) * float(block.mean(1).var()) for block in blocks) / freedoms[0]
    within = sum(float(block.var(1).sum()) * runs for block in blocks) / freedoms[1]
    if all(np.ptp(block, 1).max() == 0.0 for block in blocks):  # means of equal numbers may differ by rounding
        return Interval(math.nan, math.nan, math.nan)
    limits = (float(fdtri(*freedoms, p)) for p in ((1 + level) / 2, (1 - level) / 2))
    low, high = ((among / within / limit - 1.0) / runs for limit in limits)
    return Interval((among / within - 1.0) / runs, low, high)


def _student(value: float, error: float, dof: float, level: float) -> Difference:
    """A difference with this standard error and these degrees of freedom; its interval has no width if the error is 0."""
    if error == 0.0:
        return Difference(value, value, value, float(value == 0.0), float(1.0 - np.sign(value)) / 2, dof)
    half, t = error * float(stdtrit(dof, (1 + level) / 2)), value / error
    return Difference(value, value - half, value + half, _two_sided(t, dof), float(stdtr(dof, -t)), dof)


def _moments(runs: np.ndarray) -> tuple[float, float]:
    """The mean, whatever the order of runs, and its variance, which is exactly 0 where all runs are the same."""
    if np.ptp(runs) == 0.0:
        return float(runs[0]), 0.0
    return math.fsum(runs) / len(runs), float(np.sort(runs).var(ddof=1)) / len(runs)


def _pool(parts: Sequence[tuple[float, int]]) -> tuple[float, float]:
    """Standard error and degrees of freedom (Welch 1947, Satterthwaite 1946) of a sum, of (variance, dof) of its parts."""
    variances, freedoms = np.array(parts, np.float64).T
    total = float(variances.sum())
    if total == 0.0:
        return 0.0, float(freedoms.sum())
    return math.sqrt(total), float(1.0 / (np.square(variances / total) / freedoms).sum())


def _two_sided(t: float, dof: float) -> float:
    return float(2.0 * stdtr(dof, -abs(t)))


def bold(columns: Mapping[str, Scores], alpha: float = ALPHA) -> dict[str, np.ndarray]:
    """Which cells of a table are bold: in each row the best mean, and all that do not differ from it by Welch's t-test.

    The test is two-sided (p > alpha is bold), and not corrected for the number of methods. Bold does not mean that methods are
    equal: the fewer the seeds, the more cells are bold. Where a cell or the best has one run there is no test, so only the best
    is bold. Where neither varies, means decide. Cells of the same mean as the best are bold in any case.

    Args:
        columns: method -> its scores, higher being better; all methods must have the same tasks.
        alpha: level of significance.

    Returns:
        Method -> (tasks,) bool, tasks in the order of the first method.

    Raises:
        UserError: no method, tasks that are not the same, or numbers that are not finite.
    """
    check_level(alpha, "alpha")
    if not columns:
        raise UserError("columns have no method: give at least one")
    table = {method: by_task(scores, f"the scores of {method!r}") for method, scores in columns.items()}
    first = next(iter(table))
    for method in table:
        same_tasks(table[first], table[method], repr(first), repr(method))
    rows = [[_Cell.of(column[task]) for column in table.values()] for task in table[first]]
    chosen = np.array([_bold_row(row, alpha) for row in rows])
    return dict(zip(table, chosen.T))


@dataclass(frozen=True)
class _Cell:
    """Mean of some runs, the variance of this mean, and the number of runs."""

    mean: float
    variance: float
    runs: int

    @classmethod
    def of(cls, runs: np.ndarray) -> "_Cell":
        return cls(*_moments(runs), len(runs))


def _bold_row(row: list[_Cell], alpha: float) -> list[bool]:
    top = max(cell.mean for cell in row)
    leaders = [cell for cell in row if cell.mean == top]  # more than one: whichever is nearest decides, not the first
    return [any(_alike(cell, best, alpha) for best in leaders) for cell in row]


def _alike(cell: _Cell, best: _Cell, alpha: float) -> bool:
    if cell.mean == best.mean:
        return True
    if min(cell.runs, best.runs) < 2:
        return False
    error, dof = _pool([(cell.variance, cell.runs - 1), (best.variance, best.runs - 1)])
    return error > 0.0 and _two_sided((best.mean - cell.mean) / error, dof) > alpha
