"""Claims, and what the results say of each; how they are written is in `claims_file.py`.

A test compares the method with each of its rivals: the gain is the mean over logs of the mean difference between runs of the
same seed, with Student's interval (`stats.comparison.paired`). It *holds* where the whole interval lies above the margin, is
*contradicted* where it lies below, and is *open* else, or where cells are missing or have no finite number, or where all
differences are equal: an interval of no width says that there are too few runs, not that there is no doubt. A claim holds where
all its comparisons hold. It is contradicted where one of its k comparisons is, whose interval has level 1 - alpha / k then
(Bonferroni).
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deadreckon.bench.jobs import Job
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import number
from deadreckon.errors import UserError, unknown
from deadreckon.stats.comparison import paired
from deadreckon.stats.interval import ALPHA, Interval

State = Literal["holds", "contradicted", "open"]


@dataclass(frozen=True)
class Test:
    """What is compared.

    Attributes:
        suite: its file.
        method: of the suite.
        than: methods of the suite, or a number.
        on: logs, tasks, problems or cases of the suite.
        metric: a column of results, or a name in their `more`.
        less: whether less is better.
        margin: the gain that is claimed.
        each: whether it is claimed of each of `on`, not of their mean.
    """

    suite: Path
    method: str
    than: tuple[str, ...] | float
    on: tuple[str, ...]
    metric: str = "score"
    less: bool = False
    margin: float = 0.0
    each: bool = False


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
        rival: method of the suite, or None where it is a number.
        on: what it rests on.
        gain: mean difference, more being better, with its interval; NaN where there is nothing.
        strict: the same at the level at which one of many comparisons contradicts the claim.
        cells: that it needs.
        missing: of these, that are not there.
        undefined: of these, that are there and have no finite number for the metric, such as a correlation of equal estimates.
    """

    test: Test
    rival: str | None
    on: tuple[str, ...]
    gain: Interval
    strict: Interval
    cells: int
    missing: int
    undefined: int

    @property
    def state(self) -> State:
        """What it says."""
        if self.missing or self.undefined or not self.gain.low < self.gain.high:  # also where they are NaN
            return "open"
        if self.gain.low > self.test.margin:
            return "holds"
        return "contradicted" if self.strict.high < self.test.margin else "open"


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

    @property
    def cells(self) -> int:
        """That it needs, those of several comparisons counted for each."""
        return sum(each.cells for each in self.comparisons)

    @property
    def missing(self) -> int:
        """Of these, that are not there."""
        return sum(each.missing for each in self.comparisons)

    @property
    def undefined(self) -> int:
        """Of these, that are there without a finite number."""
        return sum(each.undefined for each in self.comparisons)


def verdict(claim: Claim, store: Store, full: bool = False) -> Verdict:
    """What results say of a claim.

    Args:
        claim: the claim.
        store: the results.
        full: at the full size of those of its suites that have one, else at their own.

    Raises:
        UserError: as `plan` does, or there are results and none has the metric of a test.
    """
    pairs = [
        (test, rival, on)
        for test in claim.tests
        for rival in (test.than if isinstance(test.than, tuple) else (None,))
        for on in ([(each,) for each in test.on] if test.each else [test.on])
    ]
    plans = {path: plan(read(path, full and read(path).full)) for path in dict.fromkeys(test.suite for test in claim.tests)}
    rows = {row["cell"]: row for row in store.results().to_pylist()}  # the newest last
    return Verdict(claim, tuple(_compared(*pair, plans[pair[0].suite], rows, len(pairs)) for pair in pairs))


def _check_metric(test: Test, jobs: Sequence[Job], rows: Mapping[str, dict[str, Any]]) -> None:
    """Refuses a metric that no sound result of the suite has: it would be open for ever."""
    sound = [rows[cell] for job in jobs for cell in job.cells if cell in rows and not rows[cell]["failure"]]
    known = {name for row in sound for name in (*row, *json.loads(row["more"] or "{}"))}
    if sound and test.metric not in known:
        raise UserError(f"{test.suite}: {unknown('metric', test.metric, known)}")


def _compared(
    test: Test, rival: str | None, on: tuple[str, ...], jobs: Sequence[Job], rows: Mapping[str, dict[str, Any]], count: int
) -> Comparison:
    """One of `count` comparisons of a claim, from the plan of its suite and all results by cell."""

    missing = 0

    def scores(method: str) -> dict[str, np.ndarray]:
        """A number a seed by log, NaN where there is none."""
        nonlocal missing
        cells = {log: [cell for job in jobs if (job.method, job.on) == (method, log) for cell in job.cells] for log in on}
        missing += sum(cell not in rows for own in cells.values() for cell in own)
        have = lambda cell: number(rows[cell], test.metric) if cell in rows else math.nan  # noqa: E731
        return {log: np.array([have(cell) for cell in own]) for log, own in cells.items()}

    ours = scores(test.method)
    judged = [ours]
    if rival is None:
        theirs = {log: np.full_like(values, test.than) for log, values in ours.items()}
    else:
        theirs = scores(rival)
        judged.append(theirs)
    _check_metric(test, jobs, rows)
    values = np.concatenate([each for method in judged for each in method.values()])
    if lacking := int((~np.isfinite(values)).sum()):
        nothing = Interval(math.nan, math.nan, math.nan)
        return Comparison(test, rival, on, nothing, nothing, len(values), missing, lacking - missing)
    if test.less:
        ours, theirs = theirs, ours
    gain, strict = (paired(ours, theirs, level) for level in (1.0 - ALPHA, 1.0 - ALPHA / count))
    return Comparison(test, rival, on, gain, strict, len(values), 0, 0)

