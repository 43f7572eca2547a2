"""Claims, and what the results say of each; how they are written is in `claims_file.py`.

A test compares the method with each of its rivals: the gain is the mean over logs of the mean difference between runs of the
same seed, with Student's interval (`stats.comparison.paired`). It *holds* where the whole interval lies above the margin, is
*contradicted* where it lies below, and is *open* else, or where cells are missing or have no finite number, or where all
differences on one of the logs are equal: that says that there are too few runs, not that there is no doubt. Where a test has
the `range` of its metric, such logs widen the interval instead (`stats.comparison.paired_within`). A claim holds where all its
comparisons hold. It is contradicted where one of its k comparisons is, of level 1 - alpha / k then (Bonferroni).

Where a test has `again`, a second suite with fresh seeds, and is open with all its cells, all of them finite, the comparison
is made there, of those cells alone, with intervals of 1 - alpha / 2 and 1 - alpha / 2k, and what it says counts. It may have an
`again` of its own, a third stage with alpha / 4, and so on. As stages share no run, at most a share of alpha + alpha / 2 +
alpha / 4 + ... of the comparisons whose true gain is the margin, in each stage on its own scale, is decided: less than 2 alpha,
however many stages there are, and also if later ones are declared when earlier ones are known. This is so of means of runs that
are about normal: where a method fails in one of ten runs, most suites of three seeds lack the failure (`docs/benchmarks.md`).

Where a test has `beside`, another suite, the same methods are compared on its logs: the gain is the difference of means over
tasks, which are taken as samples, with Welch's interval (`stats.comparison.between`). Logs of one task are averaged first.

Where a test has `among`, logs of a task are claimed to differ, in either direction: the gain is the variance between logs of a
task over that between seeds (`stats.comparison.variance_ratio`). Tasks with one log do not count.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deadreckon.bench.checked import names_of, number
from deadreckon.bench.jobs import Job, curve_end
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import read
from deadreckon.errors import UserError, unknown
from deadreckon.stats.comparison import between, gap_of, paired, paired_within, variance_ratio
from deadreckon.stats.interval import ALPHA, Interval
from deadreckon.tasks.registry import of_log

State = Literal["holds", "contradicted", "open"]
AVERAGE = "average score"  # of a run: the mean of its learning curve, but for the evaluation before it has learned


@dataclass(frozen=True)
class Test:
    """What is compared.

    Attributes:
        suite: its file.
        method: of the suite; of several the mean is taken, run by run.
        than: methods of the suite, or a number; nothing where there is `beside` or `among`.
        on: logs, tasks, problems or cases of the suite.
        metric: a column of results, a name in their `more`, or `AVERAGE`.
        less: whether less is better.
        margin: the gain that is claimed.
        each: whether it is claimed of each of `on`, not of their mean.
        beside: another suite with the same methods, on whose tasks they are claimed to do worse.
        beside_on: its logs.
        among: whether it is claimed that logs of a task differ.
        log: whether a number x counts as sign(x) log10(1 + |x|), for numbers of very different sizes; `than`, too, but not the
            margin, which is a difference of such logarithms.
        range: least and greatest number that the metric can have, so that logs on which all seeds differ by the same widen the
            interval; with None such a log leaves the test open.
        again: the same with fresh seeds, for where this one is open with all its cells; never where these are of the full size.
    """

    suite: Path
    method: tuple[str, ...]
    than: tuple[str, ...] | float
    on: tuple[str, ...]
    metric: str = "score"
    less: bool = False
    margin: float = 0.0
    each: bool = False
    beside: Path | None = None
    beside_on: tuple[str, ...] = ()
    among: bool = False
    log: bool = False
    range: tuple[float, float] | None = None
    again: "Test | None" = None

    @property
    def compared(self) -> tuple[Path, ...]:
        """Suites whose cells it compares."""
        return (self.suite,) if self.beside is None else (self.suite, self.beside)

    @property
    def suites(self) -> tuple[Path, ...]:
        """Whose cells it needs, those of later stages included."""
        return self.compared if self.again is None else (*self.compared, *self.again.suites)


@dataclass(frozen=True)
class Claim:
    """A sentence that results can decide.

    Attributes:
        id: short name.
        says: the claim.
        place: where it is made.
        tests: that decide it; none where nothing can yet.
        note: what a reader must know, such as why it cannot be decided.
    """

    id: str
    says: str
    place: str
    tests: tuple[Test, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """A method beside a rival, or beside a number.

    Attributes:
        test: what is compared.
        rival: method of the suite, or None where it is a number or there is another suite.
        on: what it rests on.
        gain: mean difference, more being better, with its interval; NaN where there is nothing.
        strict: the same at the level at which one of many comparisons contradicts the claim.
        cells: names of the cells that it needs.
        missing: of these, those that are not there.
        undefined: of these, those that are there and have no finite number for the metric, such as a correlation of equal
            estimates.
        level: of the interval of the gain.
        constant: logs on which all seeds differ by the same: how they vary there is not known, and the interval too narrow
            unless the test has a range.
        again: the same with fresh seeds, where this one leaves it open with all cells and they are declared.
        collections: logs of which its cells have learned from several collections: how these differ is in the gain, and, as it
            is the same for every seed, not in the interval.
        diverged: of the cells, those whose runs diverged: their last good policies count.
    """

    test: Test
    rival: str | None
    on: tuple[str, ...]
    gain: Interval
    strict: Interval
    cells: frozenset[str]
    missing: frozenset[str]
    undefined: frozenset[str]
    level: float
    constant: tuple[str, ...] = ()
    again: "Comparison | None" = None
    collections: tuple[str, ...] = ()
    diverged: frozenset[str] = frozenset()

    @property
    def state(self) -> State:
        """What it says, its later stages included."""
        return self.alone if self.again is None else self.again.state

    @property
    def stages(self) -> "tuple[Comparison, ...]":
        """Itself, and its later stages where there are some."""
        return (self,) if self.again is None else (self, *self.again.stages)

    @property
    def alone(self) -> State:
        """What it says by itself, without later stages."""
        doubtful = bool(self.constant) and self.test.range is None
        if self.missing or self.undefined or doubtful or not self.gain.low < self.gain.high:  # also where they are NaN
            return "open"
        if self.gain.low > self.test.margin:
            return "holds"
        # No variance is below 0: an interval that is shows seeds that vary more on one log than on another.
        return "contradicted" if self.strict.high < self.test.margin and not self.test.among else "open"


@dataclass(frozen=True)
class Verdict:
    """What the results say of a claim at one size."""

    claim: Claim
    comparisons: tuple[Comparison, ...]

    @property
    def state(self) -> State:
        """Of the claim."""
        states = [each.state for each in self.comparisons]
        if "contradicted" in states:
            return "contradicted"
        return "holds" if states and all(state == "holds" for state in states) else "open"

    def __str__(self) -> str:
        """The state, and why it is open."""
        if not self.comparisons:
            return "open: it has no tests"
        if self.state == "open" and self.missing:
            return f"open: {self.cells - self.missing:,} of {self.cells:,} scores"
        if self.state == "open":
            undefined = f"{self.undefined:,} of them not finite" if self.undefined else "and do not decide"
            return f"open: all scores are there, {undefined}"
        return self.state  # also where scores are missing: one comparison contradicts a claim

    @property
    def cells(self) -> int:
        """How many it needs; what several comparisons need counts once."""
        return len(frozenset[str]().union(*(each.cells for each in self._stages)))

    @property
    def absent(self) -> frozenset[str]:
        """Names of those that are not there."""
        return frozenset[str]().union(*(each.missing for each in self._stages))

    @property
    def missing(self) -> int:
        """How many are not there."""
        return len(self.absent)

    @property
    def undefined(self) -> int:
        """How many are there without a finite number."""
        return len(frozenset[str]().union(*(each.undefined for each in self._stages)))

    @property
    def _stages(self) -> list[Comparison]:
        return [each for one in self.comparisons for each in one.stages]


def verdict(claim: Claim, store: Store, full: bool = False) -> Verdict:
    """What results say of a claim.

    Args:
        claim: the claim.
        store: the results.
        full: at the full size of those of its suites that have one, else at their own; without later stages.

    Raises:
        UserError: as `plan` does, or there are results and none has the metric of a test.
    """
    pairs = [
        (test, rival, on)
        for test in claim.tests
        for rival in (test.than if isinstance(test.than, tuple) and test.than else (None,))
        for on in ([(each,) for each in test.on] if test.each else [test.on])
    ]
    paths = dict.fromkeys(path for test in claim.tests for path in test.suites)
    plans = {path: plan(read(path, full and read(path).full)) for path in paths}
    rows = {row["cell"]: row for row in store.of([job for jobs in plans.values() for job in jobs]).to_pylist()}
    if any(test.metric == AVERAGE for test in claim.tests):
        trained = [job for jobs in plans.values() for job in jobs if job.kind in ("learn", "online")]
        ends = {cell: curve_end(job) for job in trained for cell in job.cells}
        for cell, average in _averages(store, rows, ends).items():
            rows[cell][AVERAGE] = average

    def staged(test: Test, rival: str | None, on: tuple[str, ...], alpha: float) -> Comparison:
        found = _compared(test, rival, on, plans, rows, alpha, len(pairs))
        whole = not found.missing and not found.undefined
        if test.again is None or not whole or found.state != "open" or (full and read(test.suite).full):
            return found
        return replace(found, again=staged(test.again, rival, on, alpha / 2))

    return Verdict(claim, tuple(staged(*pair, ALPHA) for pair in pairs))


def _averages(store: Store, rows: Mapping[str, Mapping[str, Any]], ends: Mapping[str, int]) -> dict[str, float]:
    """The mean of each cell's learning curve, of cells that were evaluated since it began to learn: each evaluation counts as
    long as the time since the one before it, as the last comes when the run ends. A run that diverged keeps the score of its
    last good policy to the end of its curve, which is after as many updates as `ends` has of the cell."""
    points: dict[str, dict[int, float]] = {}
    curves = store.curves()
    for point in curves.filter(np.isin(curves["cell"].to_numpy(), list(rows))).to_pylist():
        if point["step"] > 0:
            points.setdefault(point["cell"], {})[point["step"]] = math.nan if point["score"] is None else point["score"]
    found = {}
    for cell, scores in points.items():
        if rows[cell]["failure"]:
            scores.setdefault(ends[cell], scores[max(scores)])
        steps = sorted(scores)
        found[cell] = float(np.average([scores[step] for step in steps], weights=np.diff(steps, prepend=0)))
    return found


def _check_metric(test: Test, suite: Path, jobs: Sequence[Job], rows: Mapping[str, dict[str, Any]]) -> None:
    """Refuses a metric that no sound result of the suite has: it would be open for ever."""
    known = names_of([rows[cell] for job in jobs for cell in job.cells if cell in rows])
    if known and test.metric not in known:
        raise UserError(f"{suite}: {unknown('metric', test.metric, known)}")


def _compared(
    test: Test, rival: str | None, on: tuple[str, ...], plans: Mapping[Path, Sequence[Job]],
    rows: Mapping[str, dict[str, Any]], alpha: float, count: int,
) -> Comparison:  # fmt: skip
    """One of `count` comparisons of a claim at level 1 - alpha, from the plans of its suites and the results of their cells."""
    cells: dict[str, float] = {}
    logs_of: dict[str, set[str]] = {}  # fingerprints of what was learned from, by name

    def scores(path: Path, methods: Sequence[str], logs: Sequence[str]) -> dict[str, np.ndarray]:
        """A number a seed by log, NaN where there is none; of several methods their mean."""
        have = lambda cell: number(rows[cell], test.metric) if cell in rows else math.nan  # noqa: E731
        found = {}
        for log in logs:
            own = [[cell for job in plans[path] if (job.method, job.on) == (m, log) for cell in job.cells] for m in methods]
            values = _scaled(test, np.array([[have(cell) for cell in row] for row in own]))
            cells.update(zip(chain(*own), values.reshape(-1), strict=True))
            prints = (rows[cell]["log"] for cell in chain(*own) if cell in rows)
            logs_of.setdefault(log, set()).update(filter(None, prints))
            found[log] = values.mean(0)
        return found

    ours = scores(test.suite, test.method, on)
    if test.beside is not None:
        theirs = scores(test.beside, test.method, test.beside_on)
    elif test.among:
        theirs = {}
    elif rival is None:
        theirs = {log: _scaled(test, np.full_like(values, test.than)) for log, values in ours.items()}
    else:
        theirs = scores(test.suite, (rival,), on)
    for path in test.compared:
        _check_metric(test, path, plans[path], rows)
    if test.range is not None and (beyond := [x for x in cells.values() if x < test.range[0] or x > test.range[1]]):
        low, high = test.range
        raise UserError(f"{test.suite}: a result has the {test.metric} {beyond[0]:g}, beyond the range [{low:g}, {high:g}]")
    missing = cells.keys() - rows.keys()
    undefined = {cell for cell, value in cells.items() if not math.isfinite(value)} - missing
    needed = frozenset(cells), frozenset(missing), frozenset(undefined)
    diverged = frozenset(cell for cell in cells if cell in rows and rows[cell]["failure"])
    several = tuple(log for log, prints in logs_of.items() if len(prints) > 1)
    if missing or undefined:
        nothing = Interval(math.nan, math.nan, math.nan)
        return Comparison(test, rival, on, nothing, nothing, *needed, 1.0 - alpha, collections=several, diverged=diverged)
    if test.less:
        ours, theirs = theirs, ours
    gain, strict = (_gain(test, ours, theirs, level) for level in (1.0 - alpha, 1.0 - alpha / count))
    same = []
    if not test.among and test.beside is None:
        same = [log for log in ours if np.ptp(gap_of(ours[log], theirs[log])) == 0.0]
    return Comparison(
        test, rival, on, gain, strict, *needed, 1.0 - alpha, tuple(same), collections=several, diverged=diverged
    )


def _scaled(test: Test, values: np.ndarray) -> np.ndarray:
    """The numbers as the test compares them."""
    return np.sign(values) * np.log10(1.0 + np.abs(values)) if test.log else values


def _gain(test: Test, ours: Mapping[str, np.ndarray], theirs: Mapping[str, np.ndarray], level: float) -> Interval:
    """As the kind of test has it, from a number a seed by log."""
    if test.among and min(map(len, ours.values())) < 2:
        return Interval(math.nan, math.nan, math.nan)
    if test.among:
        return variance_ratio([logs for logs in _by_task(ours).values() if len(logs) > 1], level)
    if test.beside is None and test.range is not None:
        return paired_within(ours, theirs, test.range[1] - test.range[0], level)
    if test.beside is None:
        return paired(ours, theirs, level)
    # Logs of one task are no samples of their own.
    left, right = ({task: logs.mean(0) for task, logs in _by_task(side).items()} for side in (ours, theirs))
    return between(left, right, level)


def _by_task(scores: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those of the logs of each task, (logs, seeds)."""
    logs: dict[str, list[np.ndarray]] = {}
    for log, values in scores.items():
        logs.setdefault(task_of(log), []).append(values)
    return {task: np.array(values) for task, values in logs.items()}


def task_of(log: str) -> str:
    """Name of the task of a log, or its own name where it is none of the package's."""
    task = of_log(log)
    return log if task is None else task.name
