"""Claims, declared with the cells and the rule that decide them, and what the results say of each.

    [tuned]                                 # logs on which the defaults of an agent were chosen: they decide nothing about it
    bear = ["hopper-medium-v2"]

    [[claims]]
    id = "C3"
    says = "BEAR is better than BC and TD3 on medium data."
    place = "thesis 4.6, Figure 4.3"

    [[claims.tests]]
    suite = "constraint.toml"               # beside this file
    method = "BEAR"
    than = ["BC", "TD3"]                    # methods of the suite; or one number
    on = ["walker2d-medium-v2"]             # of the suite's logs, tasks, problems or cases; all where it is absent
    metric = "score"                        # a column of results, or a name in their `more`
    less = false                            # whether less is better
    margin = 0.0                            # the gain that is claimed; below zero where it is "no worse"
    each = false                            # whether it is claimed of each log by itself, and not of their mean

A test compares the method with each of its rivals: the gain is the mean over logs of the mean difference between runs of the
same seed, with Student's interval (`stats.comparison.paired`). It *holds* where the whole interval lies above the margin, is
*contradicted* where it lies below, and is *open* else, or where cells are missing or have no finite number, or where all
differences are equal: an interval of no width says that there are too few runs, not that there is no doubt. A claim holds where
all its comparisons hold. It is contradicted where one of its k comparisons is, whose interval has level 1 - alpha / k then
(Bonferroni).
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deadreckon.bench.jobs import Job
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite, read
from deadreckon.bench.tables import number
from deadreckon.errors import UserError, unknown
from deadreckon.files import read_toml
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


def claims(path: Path | str) -> list[Claim]:
    """Those of a file, without the logs that decide nothing.

    Raises:
        UserError: the file cannot be read, or says something that cannot be: one line says what.
    """
    path = Path(path)
    found = read_toml(path)
    _check_keys(str(path), found, {"claims", "tuned"}, ("claims",))
    suites: dict[str, Suite] = {}
    all_claims = [_claim(path, one, found.get("tuned", {}), suites) for one in found["claims"]]
    for name, count in Counter(claim.id for claim in all_claims).items():
        if count > 1:
            raise UserError(f"{path}: {count} claims have the id {name}; give each its own")
    _check_tuned(path, found.get("tuned", {}), suites.values())
    return all_claims


def _check_tuned(path: Path, tuned: Mapping[str, Sequence[str]], suites: Iterable[Suite]) -> None:
    """Refuses names that mean nothing, as the logs that were tuned on would decide claims then."""
    from deadreckon.agents import AGENTS
    from deadreckon.collect.recipes import recipe_names

    agents = {*AGENTS, *(method.agent for suite in suites for method in suite.methods)}
    logs = {*recipe_names(), *(on for suite in suites for on in suite.on)}
    for agent, own in tuned.items():
        if agent not in agents:
            raise UserError(f"{path}, [tuned]: {unknown('agent', agent, agents)}")
        if not isinstance(own, list):
            raise UserError(f"{path}, [tuned]: {agent} must be a list of logs, got {own!r}")
        for log in own:
            if log not in logs:
                raise UserError(f"{path}, [tuned], {agent}: {unknown('log', str(log), logs)}")


_TEXT, _NAMES, _TRUTH = (str, "text"), (list, "a list of names"), (bool, "true or false")
_KINDS: dict[str, tuple[Any, str]] = {
    "suite": _TEXT, "method": _TEXT, "than": (list | int | float, "a list of methods, or a number"), "on": _NAMES,
    "metric": _TEXT, "less": _TRUTH, "margin": (int | float, "a number"), "each": _TRUTH,
}  # fmt: skip


def _claim(path: Path, said: dict[str, Any], tuned: Mapping[str, Sequence[str]], suites: dict[str, Suite]) -> Claim:
    where = f"{path}, claim {said.get('id', '?')}"
    _check_keys(where, said, {f.name for f in fields(Claim)}, ("id", "says", "place"))
    tests = []
    for test in said.get("tests", ()):
        _check_keys(where, test, {f.name for f in fields(Test)}, ("suite", "method", "than"))
        name = test["suite"]
        suite = suites.setdefault(name, read(path.parent / name))
        methods = {method.name: method.agent for method in suite.methods}
        for key, value in test.items():
            wanted, kind = _KINDS[key]
            if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
                raise UserError(f"{where}: {key} must be {kind}, got {value!r}")
        than = test["than"] if isinstance(test["than"], list) else float(test["than"])
        for method in [test["method"], *(than if isinstance(than, list) else ())]:
            if method not in methods:
                raise UserError(f"{where}: {unknown(f'method of {name}', method, methods)}")
        for on in test.get("on", ()):
            if on not in suite.on:
                raise UserError(f"{where}: {unknown(f'log, task, problem or case of {name}', on, suite.on)}")
        judged = {methods[method] for method in [test["method"], *(than if isinstance(than, list) else ())]}
        void = {log for agent in judged for log in tuned.get(agent, ())}
        left = tuple(on for on in test.get("on", suite.on) if on not in void)
        if not left:
            raise UserError(f"{where}: all its logs are ones on which an agent was tuned, so they decide nothing")
        given = test | {"suite": path.parent / name, "than": tuple(than) if isinstance(than, list) else than, "on": left}
        tests.append(Test(**given))
    return Claim(said["id"], said["says"], said["place"], tuple(tests), said.get("note", ""))


def _check_keys(where: str, said: dict[str, Any], known: set[str], needed: Sequence[str]) -> None:
    for key in said:
        if key not in known:
            raise UserError(f"{where}: {unknown('key', key, known)}")
    if missing := [key for key in needed if key not in said]:
        raise UserError(f"{where}: {missing[0]} is missing")


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

