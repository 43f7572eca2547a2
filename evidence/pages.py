"""Writes what pages show from the ledger: tables, figures, claims and what has not been run.

    python -m evidence.pages             (in the repository's folder: writes)
    python -m evidence.pages --check     (names what is not as the ledger says, and writes nothing)

A page holds blocks between `<!-- NAME ARGUMENTS -->` and `<!-- end -->`, whose contents are made here:

    record NAME          a table of `records/NAME.csv`: what was measured before there was a ledger (`records.py`)
    table SUITE          the suite's tables, as `deadreckon bench show evidence/SUITE --format markdown` prints them
    curves SUITE ...     learning curves, a panel for each log of the first suite: means over seeds with Student's intervals
    ranking SUITE ...    over the same logs: interquartile means, probability of improvement over the first method, profiles
    constraint SUITE     BEAR's scores beside its constraint at the end of each run: MMD and multiplier
    story                the same of all such suites, in a picture with threshold and floor
    overestimated        off-policy Q-learning's estimates beside what its policies get, by the amount of an expert's data
    changed              agents beside what they were before a change of their defaults
    improved             agents beside the logs' own mean scores
    above                on which design problems NEMO is above the forward model and the ensemble
    apart                ranks of dm_control's policies, all of them and those that are not D4PG's
    halves               means of ranks and regrets over D4RL's tasks and dm_control's
    claims               every claim with what the results say of it
    pending              declared cells without results, and what they would take
    plan                 what 40 minutes of a GPU would do of them
"""

import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deadreckon.bench.claims import Comparison, Verdict, verdict
from deadreckon.bench.claims_file import claims
from deadreckon.bench.forms import rendered
from deadreckon.bench.jobs import programs
from deadreckon.bench.ledger import Ledger, Snapshot, store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite, queue, read
from deadreckon.bench.tables import Cell, tables
from deadreckon.bench.times import Forecast, forecast
from deadreckon.cli.gpu import plan_told
from deadreckon.errors import UserError
from deadreckon.imports import trust
from deadreckon.report import charts, forest
from deadreckon.report.picture import PANEL, sheet
from deadreckon.report.text import words
from deadreckon.stats.interval import LEVEL, PERCENT
from deadreckon.stats.means import student_interval
from deadreckon.stats.scores import interval, iqm, performance_profile, probability_of_improvement
from evidence import bear
from evidence.changed import changed
from evidence.closing import hours, to_close
from evidence.designs_above import above
from evidence.improved import improved
from evidence.judged import apart, halves
from evidence.overestimated import overestimated
from evidence.records import record

STUDIES = "evidence.studies"
trust(STUDIES)

HERE = Path(__file__).resolve().parent
PAGES = HERE.parent / "docs" / "results"
_NAMES = "table|record|curves|ranking|constraint|story|above|apart|halves|claims|changed|improved|overestimated|pending|plan"
OPENING = rf"<!-- ({_NAMES})(?: ([\w. -]+))? -->\n"
BLOCK = re.compile(rf"({OPENING})((?:(?!<!-- ).)*?)(<!-- end -->)", re.S)


@cache
def _suite(name: str) -> tuple[Suite, Store]:
    suite = read(HERE / name)
    return suite, _store([suite])


def _store(suites: Sequence[Suite]) -> Store:
    """Where the results of suites lie, read once: all pages show the same moment."""
    return _read_once(store_of(suites, HERE))


@cache
def _read_once(store: Store) -> Store:
    return Snapshot(store.path, store.cells) if isinstance(store, Ledger) else store


def _asked(suite: Suite) -> str:
    """What a command needs to run the suite's own code."""
    return f" --trust {STUDIES}" if suite.kind == "study" else ""


def table(name: str, files: dict[str, bytes]) -> str:
    """A suite's tables in Markdown, with the command that prints them."""
    suite, store = _suite(name)
    shown = rendered(tables(suite, plan(suite), store), "markdown")
    return f"`deadreckon bench show evidence/{name} --format markdown{_asked(suite)}`\n\n{shown}\n"


def _joined(names: str) -> tuple[list[Suite], Store]:
    """Suites that are shown together, on the logs of the first, and their results.

    Raises:
        UserError: the results of one cannot stand beside those of the first.
    """
    suites = [_suite(name)[0] for name in names.split()]
    first, *others = suites
    size = _size(first, first.on)
    methods = {method.name for method in first.methods}
    for other in others:
        if _size(other, first.on) != size:
            raise UserError(f"{other.name} has not the logs of {first.name} with its seeds, steps, episodes and rows")
        if both := methods & (own := {method.name for method in other.methods}):
            raise UserError(f"{other.name} has methods of the suites before it: {', '.join(sorted(both))}")
        methods |= own
    return suites, _store(suites)


def _size(suite: Suite, logs: Sequence[str]) -> tuple[int | None, ...]:
    """What is alike in results that are compared; None among them where the suite lacks a log."""
    return suite.seeds, suite.episodes, suite.rows, *(suite.steps.get(log) for log in logs)


def _line(method: str, slot: int, x: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray) -> charts.Series:
    """A method's line with its band, dashed where no colour is left."""
    return charts.Series(method, slot % forest.SLOTS, x, value, low, high, dashed=slot >= forest.SLOTS)


def curves(names: str, files: dict[str, bytes]) -> str:
    """A picture of learning curves."""
    suites, store = _joined(names)
    first, methods = suites[0], [method.name for suite in suites for method in suite.methods]
    known = {row["cell"] for row in store.results().to_pylist()}
    points: dict[str, dict[int, float]] = {}  # a cell that two machines have done is in two files
    for row in store.curves().to_pylist():
        points.setdefault(row["cell"], {})[row["step"]] = row["score"]
    found: dict[str, dict[str, list[list[tuple[int, float]]]]] = {}
    for job in (job for suite in suites for job in plan(suite)):
        own = [sorted(points[cell].items()) for cell in job.cells if cell in known]
        found.setdefault(job.on, {}).setdefault(job.method, []).extend(own)
    panels = {}
    for on in first.on:
        series = [_curve(method, methods.index(method), own) for method, own in found[on].items() if own]
        if series:
            panels[on] = charts.lines(series, title=on, unit="normalised score", size=PANEL)
    if not panels:
        return "No curve yet.\n"
    with tempfile.TemporaryDirectory() as folder:
        path = sheet(Path(folder) / "curves.svg", panels, methods)  # a page is too narrow for three columns
        files[picture := f"{first.name}-curves.svg"] = path.read_bytes()
    text = (
        f"Line: mean over seeds; band: Student's {PERCENT} interval over seeds, wide where these are few. "
        "Seeds that diverged keep the score of their last good policy."
    )
    return f"![Normalised score against updates, a panel for each log]({picture})\n\n{text}\n"


def _curve(method: str, slot: int, seeds: list[list[tuple[int, float]]]) -> charts.Series:
    """Mean over seeds with its interval."""
    steps = np.array([step for step, _ in max(seeds, key=len)], float)
    # A seed that diverged ends early and keeps its last good policy, whose score goes on.
    held = [np.pad([score for _, score in curve], (0, len(steps) - len(curve)), "edge") for curve in seeds]
    means = [student_interval(scores) for scores in np.array(held).T]
    value, low, high = (np.array([getattr(mean, end) for mean in means]) for end in ("value", "low", "high"))
    return _line(method, slot, steps, value, low, high)


def ranking(names: str, files: dict[str, bytes]) -> str:
    """Methods that have all seeds of all logs, over all logs together."""
    suites, store = _joined(names)
    first = suites[0]
    cells: dict[str, dict[str, Cell]] = {}
    for suite in suites:
        cells |= tables(suite, plan(suite), store)[0].cells
    sound = [method for method, row in cells.items() if all(row[on].sound for on in first.on)]
    whole = {method: {on: cells[method][on].scores for on in first.on} for method in sound}
    if len(whole) < 2:
        return "No two methods have results on all logs yet.\n"
    rival = sound[0]
    order = sorted(whole, key=lambda method: -interval(whole[method], iqm).value)
    rows = [f"| method | interquartile mean | probability of improvement over {rival} |", "|---|---:|---:|"]
    for method in order:
        better = "" if method == rival else f"{probability_of_improvement(whole[method], whole[rival]):.2f}"
        rows.append(f"| {method} | {interval(whole[method], iqm):.1f} | {better} |")
    grid = np.linspace(0.0, 120.0, 61)
    series = []
    for slot, method in enumerate(whole):
        profile = performance_profile(whole[method], grid)
        series.append(_line(method, slot, grid, profile.share, profile.low, profile.high))
    chart = charts.lines(series, title="Performance profiles", unit="share of runs above", size=PANEL, across="score")
    with tempfile.TemporaryDirectory() as folder:
        path = sheet(Path(folder) / "profiles.svg", {"Performance profiles": chart}, list(whole))
        files[picture := f"{first.name}-profiles.svg"] = path.read_bytes()
    text = f"{len(first.on)} logs, {first.seeds} seeds; {PERCENT} bootstrap intervals, too narrow for few seeds."
    if lacking := [method for method in cells if method not in whole]:
        text += f" Without all seeds of all logs, and left out: {', '.join(lacking)}."
    return "\n".join([*rows, "", text, "", f"![Share of runs that score above a threshold]({picture})", ""])


def constraint(name: str, files: dict[str, bytes]) -> str:
    """Whether BEAR's constraint is met at the end of runs, and what they score."""
    return bear.constraint(*_suite(name))


def _reads(verdict: Verdict) -> str:
    """The verdict in words, its state in bold where all scores are there, or one comparison has decided."""
    told = str(verdict)
    if verdict.state == "open" and (verdict.missing or not verdict.comparisons):
        return told
    return told.replace(verdict.state, f"**{verdict.state}**", 1)


def _effect(one: Comparison) -> str:
    test = one.test
    ours = test.method[0] if len(test.method) == 1 else f"the mean of {words([*test.method])}"
    where = f" on {', '.join(one.on)}" if len(one.on) < len(read(test.suite).on) else ""
    if test.among:
        rival = "variance between logs of a task over that between seeds"
    elif test.beside:
        rival = f"against the same on the tasks of {test.beside.name}"
    else:
        rival = f"against {one.rival or f'{test.than:g}'}"
    told = f"{test.metric}{' (less is better)' if test.less else ''}: {ours}{', ' if test.among else ' '}{rival}{where}"
    margin = f", margin {test.margin:g}" if test.margin else ""
    told += ", as sign(x) log10(1 + |x|)" if test.log else ""
    level = "" if one.level == LEVEL else f" ({one.level:.1%} interval)"
    same = f", the same with every seed on {words([*one.constant])}" if one.constant else ""
    logs = f", from several collections of {words([*one.collections])}" if one.collections else ""
    lost = f", the last good policies of {len(one.diverged):,} runs that diverged" if one.diverged else ""
    found = f"{'' if test.among else 'gain '}{one.gain:.3g}{level}{margin}{same}{logs}{lost}, {one.alone}"
    if one.undefined:
        found = f"{len(one.undefined):,} of {len(one.cells):,} scores are not finite"
    return f"`{test.suite.name}`, {told}: " + ("not there yet" if one.missing else found)


class _Waiting(NamedTuple):
    """A suite of the queue at one size: how many cells it has, and what each of those that are missing is expected to take."""

    suite: Suite
    full: bool
    cells: int
    missing: dict[str, Forecast | None]


@cache
def _waiting() -> list[_Waiting]:
    """All suites at either size, in the order of the queue."""
    sized = [(suite, full) for full in (False, True) for suite in queue(HERE / "queue.toml", full)]
    store = _store([suite for suite, _ in sized])
    planned = [(suite, full, len(jobs), programs(store.undone(jobs))) for suite, full in sized for jobs in [plan(suite, 1)]]
    times = forecast([program for *_, missing in planned for program in missing], store)
    one = lambda program: program.jobs[0].cells[0]  # noqa: E731 - planned for a lane, so it is the only one
    return [_Waiting(*about, {one(each): times[each.name] for each in missing}) for *about, missing in planned]


TO_CLOSE = (
    "*To close* is what the CPU size lacks: core-hours of the scores that are missing (the marks are those of "
    "[what has not been run](PENDING.md)), or, where all are there, fresh seeds of a further stage, if mean and spread stay as "
    "they are; they would have to be declared before they are run."
)
STAGES = ("", ", again", ", third stage", ", fourth stage")


def claimed(name: str, files: dict[str, bytes]) -> str:
    """A row for each claim, and below them what each rests on."""
    rows = ["| | claim | in the thesis | CPU size | to close | full size |", "|---|---|---|---|---|---|"]
    details: list[str] = []
    cost = {cell: took for each in _waiting() if not each.full for cell, took in each.missing.items()}
    for claim in claims(HERE / "claims.toml"):
        store = _store([read(path) for test in claim.tests for path in test.suites]) if claim.tests else Store(HERE)
        own = verdict(claim, store)
        sized = any(read(path).full for test in claim.tests for path in test.suites)
        full = _reads(verdict(claim, store, full=True)) if sized else "the same"
        told = _reads(own), to_close(own, cost), full if claim.tests else ""
        rows.append(f"| {' | '.join([claim.id, claim.says, claim.place, *told])} |")
        for one in own.comparisons:
            details += [f"- {claim.id}{STAGES[i]}, {_effect(each)}" for i, each in enumerate(one.stages)]
        if claim.note:
            details.append(f"- {claim.id}: {claim.note}")
    return "\n".join([*rows, "", TO_CLOSE, "", *details, ""])


def story(name: str, files: dict[str, bytes]) -> str:
    """Floor, threshold, multiplier and score of BEAR's forms."""
    suites = [read(HERE / f"{each}.toml") for each in bear.SUITES]
    return bear.story(suites, _store(suites), files)


def of_queue(make: Callable[[Sequence[Suite], Store], str]) -> Callable[[str, dict[str, bytes]], str]:
    """What is made of all suites of the queue and their results."""

    def block(name: str, files: dict[str, bytes]) -> str:
        suites = queue(HERE / "queue.toml")
        return make(suites, _store(suites))

    return block


def pending(name: str, files: dict[str, bytes]) -> str:
    """Suites with cells that are missing, and the time of a core that they would take by that of finished ones."""
    rows = ["| suite | size | cells missing | hours of one core | command |", "|---|---|---:|---:|---|"]
    for suite, full, cells, missing in _waiting():
        if not missing:
            continue
        command = f"deadreckon bench evidence/{suite.name}.toml{' --full' if full else ''}{_asked(suite)}"
        size, count = "full" if full else "CPU", f"{len(missing):,} of {cells:,}"
        rows.append(f"| {suite.about} | {size} | {count} | {hours(missing.values())} | `{command}` |")
    return "\n".join([*rows, ""]) if len(rows) > 2 else "Nothing.\n"


def gpu(name: str, files: dict[str, bytes]) -> str:
    """The plan for a GPU that is lent for a while, by the rates that the package knows."""
    told = plan_told(str(HERE / "queue.toml"), HERE, 40 * 60.0)
    known = "by the ledger and `bench/rates.toml`, nothing being half done"
    return f"`make evidence-gpu FOR=40m PLAN=1`, {known}\n\n```text\n{told}\n```\n"


MAKE: dict[str, Callable[[str, dict[str, bytes]], str]] = {
    "table": table, "record": record, "curves": curves, "ranking": ranking, "constraint": constraint, "story": story,
    "claims": claimed, "above": of_queue(above), "changed": of_queue(changed), "improved": of_queue(improved),
    "overestimated": of_queue(overestimated), "apart": apart, "halves": halves, "pending": pending, "plan": gpu,
}  # fmt: skip


def made(text: str, files: dict[str, bytes]) -> str:
    """A page with its blocks as the ledger says; `files` gets the pictures that they show, by name.

    Raises:
        UserError: a block that does not end before the next one begins.
    """
    whole = {match.start() for match in BLOCK.finditer(text)}
    for match in re.finditer(OPENING, text):
        if match.start() not in whole:
            raise UserError(f"{match[0].strip()} has no <!-- end --> before what follows it")
    return BLOCK.sub(lambda m: f"{m[1]}\n{MAKE[m[2]](m[3] or '', files)}\n{m[5]}", text)


def main(args: Sequence[str]) -> int:
    """Writes, or checks."""
    if unknown := [arg for arg in args if arg != "--check"]:
        print(f"python -m evidence.pages takes --check or nothing, got {unknown[0]}", file=sys.stderr)
        return 2
    check, files, wanted = "--check" in args, {}, {}
    for path in sorted(PAGES.glob("*.md")):  # all are made before any is written
        try:
            wanted[path] = made(path.read_text(), files).encode()
        except UserError as error:
            print(f"{path}: {error}", file=sys.stderr)
            return 2
    wanted |= {PAGES / name: data for name, data in files.items()}
    wrong = [path for path, data in wanted.items() if not path.exists() or path.read_bytes() != data]
    for path in wrong:
        if not check:
            path.write_bytes(wanted[path])
        print(f"{path} {'is not what the ledger says: run python -m evidence.pages' if check else 'written'}")
    return int(check and bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
