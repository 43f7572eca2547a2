"""What a table of scores says and does not say: means that outliers cannot move, intervals, comparisons, the bold rule.

Aggregates, the stratified bootstrap, the probability of improvement and performance profiles are those of Agarwal et al.
(2021), "Deep RL at the Edge of the Statistical Precipice" (rliable). All of them speak about the runs that a method might have
had on these tasks; none speaks about other tasks.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

from deadreckon.errors import UserError
from deadreckon.stats.interval import ALPHA, LEVEL, Interval

RESAMPLES = 5000  # each limit of a 95 % interval is then right to some 1 % of its width

# A method's scores: task -> (seeds,), or one (seeds,) a task, or a matrix (seeds, tasks). Only a matrix is an ndarray.
Scores = Mapping[str, ArrayLike] | Sequence[ArrayLike] | np.ndarray
# Of one (..., seeds) array a task, a number or a (...) array of them.
Statistic = Callable[[list[np.ndarray]], Any]


@dataclass(frozen=True)
class Difference(Interval):
    """Ours less theirs, with its interval.

    Attributes:
        p: two-sided; of a difference this far from zero if there were none.
        p_better: one-sided; of a difference this great if ours were no better.
        dof: degrees of freedom of Student's t.
    """

    p: float
    p_better: float
    dof: float


@dataclass(frozen=True)
class Profile:
    """The share of runs above each threshold, (thresholds,) each, with limits that hold for one threshold at a time."""

    thresholds: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray


def _by_task(scores: Scores, whose: str = "the scores", *, stacked: bool = False) -> dict[Any, np.ndarray]:
    """Checked: task's name or number -> (seeds,), or (..., seeds) where `stacked`."""
    if isinstance(scores, Mapping):
        items = list(scores.items())
    elif isinstance(scores, np.ndarray) and scores.ndim != 2:
        raise UserError(f"{whose} as a matrix must be (seeds, tasks), got shape {scores.shape}; of one task, give [scores]")
    elif isinstance(scores, (np.ndarray, Sequence)) and not isinstance(scores, (str, bytes)):
        items = list(enumerate(scores.T if isinstance(scores, np.ndarray) else scores))
    else:
        wanted = "a mapping of tasks to runs, one array of runs a task, or a (seeds, tasks) matrix"
        raise UserError(f"{whose} must be {wanted}, got {type(scores).__name__}")
    if not items:
        raise UserError(f"{whose} have no task: give at least one, with at least one run")
    found = {name: _numbers(values, f"{whose} of task {name!r}", stacked) for name, values in items}
    if len({x.shape[:-1] for x in found.values()}) > 1:
        raise UserError(f"{whose} must have the same leading axes in all tasks, got {[x.shape for x in found.values()]}")
    return found


def _numbers(values: ArrayLike, what: str, stacked: bool) -> np.ndarray:
    try:
        runs = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{what} must be numbers, got {str(values)[:40]!r}") from error
    if runs.ndim < 1 or (runs.ndim > 1 and not stacked):
        raise UserError(f"{what} must be a list of numbers, got shape {runs.shape}")
    if not runs.shape[-1]:
        raise UserError(f"{what} are empty: give at least one number")
    if not np.isfinite(runs).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(runs))[0])
        raise UserError(f"{what} must be finite, got {runs[where]} at place {where[-1]}")
    return runs


def _pairs(ours: Scores, theirs: Scores) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """(task, our runs, their runs) of every task, matched by name, or by place where there are no names."""
    x, y = _by_task(ours, "our scores"), _by_task(theirs, "their scores")
    _same_tasks(x, y, "ours", "theirs")
    return [(task, x[task], y[task]) for task in x]


def _same_tasks(x: Mapping[Any, Any], y: Mapping[Any, Any], first: str, second: str) -> None:
    for one, other, has, lacks in ((x, y, first, second), (y, x, second, first)):
        extra = [task for task in one if task not in other]
        if extra:
            raise UserError(f"both must have the same tasks, but {has} has {extra[0]!r} and {lacks} has not")


def _generator(level: float, resamples: int, seed: int) -> np.random.Generator:
    _check_level(level)
    if resamples < 1:
        raise UserError(f"resamples must be >= 1, got {resamples}")
    if seed < 0:
        raise UserError(f"seed must be >= 0, got {seed}")
    return np.random.default_rng(seed)


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise UserError(f"level must lie between 0 and 1, got {level}")


def _limits(values: np.ndarray, level: float) -> tuple[Any, Any]:
    """Percentiles over (resamples, ...)."""
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


def _counts(rng: np.random.Generator, runs: int, resamples: int) -> np.ndarray:
    """(resamples, runs) how often each run is in a redrawn set."""
    return rng.multinomial(runs, np.full(runs, 1 / runs), resamples).astype(np.float64)


def iqm(scores: Scores) -> Any:
    """Interquartile mean: of all runs of all tasks pooled, without the lowest and the highest quarter.

    The quarters are rounded down, as in rliable, so three runs or fewer give the plain mean. Every run counts alike, and so a
    task with more runs counts for more. Of (..., seeds) arrays it gives a (...) array, as `median`, `mean` and
    `optimality_gap` do.
    """
    runs = np.concatenate(list(_by_task(scores, stacked=True).values()), axis=-1)
    n = runs.shape[-1]
    cut = n // 4
    return np.partition(runs, (cut, n - cut - 1), axis=-1)[..., cut : n - cut].mean(-1)


def mean(scores: Scores) -> Any:
    """Mean over tasks of each task's mean, so that every task counts alike."""
    return np.mean(_means(scores), axis=0)


def median(scores: Scores) -> Any:
    """Median over tasks of each task's mean."""
    return np.median(_means(scores), axis=0)


def optimality_gap(scores: Scores, target: float) -> Any:
    """How far runs fall short of `target`, those beyond it counting as there: mean over tasks of the mean over runs."""
    if not math.isfinite(target):
        raise UserError(f"target must be a finite score, got {target}")
    return np.mean([np.maximum(target - x, 0.0).mean(-1) for x in _by_task(scores, stacked=True).values()], axis=0)


def _means(scores: Scores) -> np.ndarray:
    """(tasks, ...)."""
    return np.stack([x.mean(-1) for x in _by_task(scores, stacked=True).values()])


def interval(
    scores: Scores, statistic: Statistic = iqm, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """A statistic with its percentile bootstrap interval, stratified: runs are redrawn within each task.

    Few seeds make it too narrow, because redrawn means of n runs spread by only sqrt((n - 1) / n) of what they should. With
    3 seeds per task, the 95 % interval of a mean covers the true value in no more than 89 % of cases however many tasks there
    are (5 seeds: 92 %, 10: 94 %), and of one task alone it runs from the worst run to the best, which hold a symmetric
    distribution's middle in 75 %. So 3 seeds cannot show that two methods whose intervals just part are different; use
    `paired`, whose t limits are wider for that reason. A task of a single run would add no width although it varies, so one
    such task makes the limits NaN.

    Args:
        scores: of one method.
        statistic: of one (..., seeds) array a task, reducing the last axis, such as `partial(optimality_gap, target=100)`.
        level: share of cases in which the interval is meant to cover the true value.
        resamples: redrawn tables.
        seed: of the bootstrap.

    Raises:
        UserError: no task, no run, numbers that are not finite, or a statistic that does not reduce the last axis.
    """
    rng, tasks = _generator(level, resamples, seed), list(_by_task(scores).values())
    value = float(statistic(tasks))
    if min(map(len, tasks)) < 2:
        return Interval(value, math.nan, math.nan)
    redrawn = np.asarray(statistic([x[rng.integers(0, len(x), (resamples, len(x)))] for x in tasks]))
    if redrawn.shape != (resamples,):
        raise UserError(f"statistic must reduce the last axis only: of (resamples, seeds) arrays it gave shape {redrawn.shape}")
    low, high = _limits(redrawn, level)
    return Interval(value, float(low), float(high))


def probability_of_improvement(
    ours: Scores, theirs: Scores, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """Mean over tasks of P(X > Y) + P(X = Y) / 2 for a run X of ours and a run Y of theirs, with its bootstrap interval.

    By task it is the Mann-Whitney statistic over the number of pairs of runs. Runs of both methods are redrawn within tasks,
    apart from one another. Where every run of ours beats every run of theirs, so does every redraw: [1, 1] then means that
    no overlap was seen, not that there is none. Limits are NaN where a task has a single run of either, as in `interval`.

    Raises:
        UserError: tasks that are not the same, or what `interval` raises.
    """
    rng, pairs = _generator(level, resamples, seed), _pairs(ours, theirs)
    total, redrawn = 0.0, np.zeros(resamples)
    for _, x, y in pairs:
        wins = (x[:, None] > y) + (x[:, None] == y) / 2
        total += float(wins.mean())
        redrawn += ((_counts(rng, len(x), resamples) @ wins) * _counts(rng, len(y), resamples)).sum(-1) / wins.size
    value = total / len(pairs)
    if min(min(len(x), len(y)) for _, x, y in pairs) < 2:
        return Interval(value, math.nan, math.nan)
    low, high = _limits(redrawn / len(pairs), level)
    return Interval(value, float(low), float(high))


def paired(ours: Scores, theirs: Scores, level: float = LEVEL) -> Difference:
    """Mean over tasks of the mean difference between runs of the same seed, with Student's t interval and p.

    Run i of ours and run i of theirs share a seed. Each task's mean difference has the variance s^2 / n of its own
    differences, and the mean over T tasks that of their sum / T^2, with degrees of freedom after Welch and Satterthwaite;
    for one task it is the paired t-test. Tasks are fixed and only runs are due to chance, as in `interval`: a t-test over
    all differences together would count it as noise that a method gains more on one task than on another, and one over the
    tasks' means asks about tasks that nobody ran. Unlike the bootstrap it allows for few seeds, if differences are roughly
    normal. Seeds are taken as independent between tasks, whose data and networks differ. A task of one run makes limits and
    p NaN. Differences that are all the same within every task leave no doubt (p = 0), or, of no size, no finding (p = 1).

    Raises:
        UserError: tasks that are not the same, other numbers of runs, or what `interval` raises.
    """
    _check_level(level)
    pairs = _pairs(ours, theirs)
    for task, x, y in pairs:
        if len(x) != len(y):
            raise UserError(
                f"paired runs share seeds, but task {task!r} has {len(x)} runs of ours and {len(y)} of theirs: "
                "give as many, or use probability_of_improvement"
            )
    gaps = [_moments(x - y) for _, x, y in pairs]
    value = float(np.mean([gap[0] for gap in gaps]))
    if min(len(x) for _, x, _ in pairs) < 2:
        return Difference(value, *[math.nan] * 5)
    error, dof = _pool([(gap[1] / len(pairs) ** 2, len(x) - 1) for gap, (_, x, _) in zip(gaps, pairs)])
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


def performance_profile(
    scores: Scores, thresholds: ArrayLike, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Profile:
    """The share of runs that score above each threshold, every task counting alike, with a bootstrap band.

    The band is stratified and too narrow for few seeds, as `interval` says, and holds for each threshold by itself, not for
    the whole curve. Where no run or every run is above, it has no width. It is NaN where a task has a single run.

    Args:
        scores: of one method.
        thresholds: (thresholds,) on the scale of the scores.
        level: of the band.
        resamples: redrawn tables.
        seed: of the bootstrap.

    Raises:
        UserError: thresholds that are not a list of finite numbers, or what `interval` raises.
    """
    rng, tasks = _generator(level, resamples, seed), list(_by_task(scores).values())
    cuts = _numbers(thresholds, "thresholds", False)
    share, redrawn = np.zeros(cuts.size), np.zeros((resamples, cuts.size))
    for x in tasks:
        above = (x[:, None] > cuts).astype(np.float64)
        share += above.mean(0)
        redrawn += _counts(rng, len(x), resamples) @ above / len(x)
    share, redrawn = share / len(tasks), redrawn / len(tasks)
    if min(map(len, tasks)) < 2:
        return Profile(cuts, share, np.full(cuts.size, np.nan), np.full(cuts.size, np.nan))
    return Profile(cuts, share, *_limits(redrawn, level))


def bold(columns: Mapping[str, Scores], level: float = ALPHA) -> dict[str, np.ndarray]:
    """Which cells of a table are bold: in each row the best mean, and all that Welch's t-test cannot tell from it (p > level).

    The test is two-sided, and nothing is corrected for how many methods there are. Bold does not say that methods are
    equal: the fewer the seeds, the more is bold. Where a cell or the best has one run there is no test, so only the best is
    bold. Where neither varies, means decide. Cells of the same mean as the best are bold in any case.

    Args:
        columns: method -> its scores, higher being better; all methods must have the same tasks.
        level: of significance.

    Returns:
        Method -> (tasks,) bool, tasks in the order of the first method.

    Raises:
        UserError: no method, tasks that are not the same, or numbers that are not finite.
    """
    _check_level(level)
    if not columns:
        raise UserError("columns have no method: give at least one")
    table = {method: _by_task(scores, f"the scores of {method!r}") for method, scores in columns.items()}
    first = next(iter(table))
    for method in table:
        _same_tasks(table[first], table[method], repr(first), repr(method))
    rows = [[_Cell.of(column[task]) for column in table.values()] for task in table[first]]
    chosen = np.array([_bold_row(row, level) for row in rows])
    return dict(zip(table, chosen.T))


@dataclass(frozen=True)
class _Cell:
    """Mean of some runs, its variance, and how many they are."""

    mean: float
    variance: float
    runs: int

    @classmethod
    def of(cls, runs: np.ndarray) -> "_Cell":
        return cls(*_moments(runs), len(runs))


def _bold_row(row: list[_Cell], level: float) -> list[bool]:
    top = max(cell.mean for cell in row)
    leaders = [cell for cell in row if cell.mean == top]  # more than one: whichever is nearest decides, not the first
    return [any(_alike(cell, best, level) for best in leaders) for cell in row]


def _alike(cell: _Cell, best: _Cell, level: float) -> bool:
    if cell.mean == best.mean:
        return True
    if min(cell.runs, best.runs) < 2:
        return False
    error, dof = _pool([(cell.variance, cell.runs - 1), (best.variance, best.runs - 1)])
    return error > 0.0 and _two_sided((best.mean - cell.mean) / error, dof) > level
