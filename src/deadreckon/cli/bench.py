"""`deadreckon bench`: a declared table, run to its end; `bench list`, `bench show SUITE`."""

import dataclasses
import functools
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from deadreckon.cli.lines import Lines, outcome
from deadreckon.cli.parse import parse
from deadreckon.errors import UserError
from deadreckon.imports import trust
from deadreckon.interrupts import resumable

if TYPE_CHECKING:
    from deadreckon.bench.executor import Work


@dataclass
class Bench:
    """Run a benchmark suite of the package, or of your TOML file; finished runs are not repeated.

    See also `deadreckon bench list` and `deadreckon bench show`.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    """name of a suite (see `bench list`), or a TOML file of a suite or of a queue of suites"""
    out: str = "runs/bench"  # folder of results, also of several suites; existing results are not computed again
    full: bool = False  # run the full size that the suite declares under [full]
    time: Annotated[str | None, tyro.conf.arg(name="for")] = None
    """time after which to stop, such as 90s, 30m, 8h; the same command continues later; None: until all is done"""
    idle: bool = False  # use only idle processor time, and pause while a benchmark takes measurements
    gpu: bool = False  # fill one GPU for the time of --for with cells that train on logs, at full size where that fits
    executor: Literal["local", "ray"] = "local"  # where jobs run: processes on this machine (local), or a Ray cluster
    workers: int | None = None  # number of processes (local); None: one per core, or one for a GPU (with --gpu, up to 8)
    address: str | None = None  # address of the Ray cluster; None: RAY_ADDRESS, one on this machine, or a new one
    cpus: int = 1  # cores per job (ray)
    gpus: float = 0.0  # GPUs per job (ray); a fraction if several jobs share a GPU
    dry_run: bool = False  # print what would be run and the expected time, without running it
    track: Annotated[tuple[str, ...], tyro.conf.arg(metavar="tensorboard|wandb|mlflow|module:Class ...")] = ()
    """trackers that show the runs of suites of the kinds learn and online"""
    trust: tuple[str, ...] = ()  # modules whose agents, tasks and studies the suite may name: their code runs


@dataclass
class Show:
    """Show a suite's available results as a table."""

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    """name of a suite (see `bench list`), or a TOML file"""
    out: str = "runs/bench"  # folder of the results
    full: bool = False  # show results of the full size that the suite declares under [full]
    format: Literal["text", "markdown", "csv", "latex"] = "text"  # format of the table
    any_revision: bool = False  # whether to show results of other revisions of the methods and the protocol too
    trust: tuple[str, ...] = ()  # modules whose agents, tasks and studies the suite may name: their code runs


@dataclass
class List:
    """List the suites of the package."""


def bench(args: Sequence[str]) -> None:
    """Runs, shows or lists."""
    if args and args[0] == "list":
        return _list(args[1:])
    if args and args[0] == "show":
        return _show(args[1:])
    options = parse(Bench, args, "bench")
    trust(*options.trust)
    return _fill(options) if options.gpu else _run(options)


def _list(args: Sequence[str]) -> None:
    from deadreckon.bench.suite import names, read
    from deadreckon.text_table import table

    parse(List, args, "bench list")
    suites = [read(name) for name in names()]
    print(table([["suite", "what"], *([suite.name, suite.about] for suite in suites)]))


def _show(args: Sequence[str]) -> None:
    from deadreckon.bench.forms import rendered
    from deadreckon.bench.ledger import store_of
    from deadreckon.bench.plan import plan
    from deadreckon.bench.suite import queue
    from deadreckon.bench.tables import tables

    options = parse(Show, args, "bench show")
    trust(*options.trust)
    suites = queue(options.suite, options.full)
    store = store_of(suites, Path(options.out))
    found = [tables(suite, plan(suite), store, options.any_revision) for suite in suites]
    if options.format == "csv":
        return print(rendered([table for own in found for table in own], "csv"))
    for suite, own in zip(suites, found):
        if len(suites) > 1:
            print(f"\n{suite.name}{': ' * bool(suite.about)}{suite.about}\n")
        print(rendered(own, options.format))


def _fill(options: Bench) -> None:
    from deadreckon.cli.gpu import fill
    from deadreckon.runs.durations import seconds_of

    if options.track:
        raise UserError("--track does not go with --gpu; `deadreckon train --resume --track NAME` shows a finished run")
    other = {"full": False, "idle": False, "executor": "local", "address": None, "cpus": 1, "gpus": 0.0}
    for name, default in other.items():
        if getattr(options, name) != default:
            raise UserError(f"--{name} does not go with --gpu, which runs local processes and chooses each cell's size itself")
    if options.time is None:
        raise UserError("--gpu fills a limited time; set it with --for, such as --for 40m")
    fill(options.suite, Path(options.out), seconds_of(options.time), options.workers, options.dry_run)


def _run(options: Bench) -> None:
    from deadreckon.bench.executor import run
    from deadreckon.bench.forms import rendered
    from deadreckon.bench.ledger import store_of
    from deadreckon.bench.plan import plan_all
    from deadreckon.bench.suite import queue
    from deadreckon.bench.tables import tables
    from deadreckon.runs.durations import seconds_of

    began = time.monotonic()
    suites = queue(options.suite, options.full)
    work = _work(suites, options.track)
    seconds = None if options.time is None else seconds_of(options.time)
    store = store_of(suites, Path(options.out))
    plan_all(suites)  # refuses what cannot be run before a cluster is joined
    executor = _executor(options, work)
    jobs = plan_all(suites, executor.lanes)
    waiting = announce(Path(options.suite).stem, jobs, store, executor, options.dry_run)
    if options.dry_run:
        return executor.close()
    lines, found = Lines(len(waiting)), set[str]()

    def told(event) -> None:
        lines(event)
        if event.what == "done":
            found.update(job.suite for job in event.program.jobs)

    with resumable(store.path, store.place):
        run(jobs, store, told, executor, None if seconds is None else seconds - (time.monotonic() - began))
    for suite in suites:
        own = [job for job in jobs if job.suite == suite.name]
        if len(suites) == 1:
            outcome("\n" + rendered(tables(suite, own, store)))
        elif (seconds is not None and suite.name not in found) or not store.of(own).num_rows:
            continue  # of a queue that has not come to it, or had no time for more
        if page := _page(suite, own, store, options.full):
            outcome(page)
    if left := store.undone(jobs):
        waits = sum(store.failure(job, seed) is None for job in left for seed in job.seeds)
        if seconds is not None and waits:
            outcome(f"{waits:,} cell{'s are' if waits != 1 else ' is'} left; the same command continues with them")
        raise SystemExit(1)


def announce(name, jobs, store, executor, each: bool):
    """Says what is to be done and how long it may take, job by job if `each`, and gives it."""
    from deadreckon.bench.jobs import programs
    from deadreckon.bench.times import forecast
    from deadreckon.runs.durations import in_words

    waiting = programs(store.undone(jobs))
    cells, missing = len({cell for job in jobs for cell in job.cells}), sum(program.lanes for program in waiting)
    print(f"{name}: {cells:,} cell{'s' * (cells != 1)}, {cells - missing:,} of them done; results in {store.place}")
    expected = forecast(waiting, store, accelerated=executor.lanes is None)
    for program in waiting if each else ():
        took = expected[program.name]
        if took is None:
            print(f"  {program}: time not known, no similar job is finished")
            continue
        how = "about" if took.close else "roughly" if took.whole else "updates alone roughly"
        print(f"  {program}: {how} {in_words(took.seconds)}")
    found = [took for took in expected.values() if took is not None]
    known = [took.seconds for took in found]
    if known:
        more = f"; the times of {len(waiting) - len(known)} more are not known" if len(known) < len(waiting) else ""
        workers = f"{executor.workers} worker{'s' * (executor.workers != 1)}"
        spread = f"{in_words(max(max(known), sum(known) / executor.workers))} with {workers}"
        least = "" if all(took.whole for took in found) else "at least "
        print(f"{least}about {spread}, by the times of finished jobs{more}")
    return waiting


def _work(suites, track: tuple[str, ...]):
    """What executors do of a program: with trackers, where some are asked for.

    Raises:
        UserError: there is no such tracker, or nothing that it could show.
    """
    from deadreckon.bench.work import TRACKED, perform
    from deadreckon.runs.trackers.tracker import trackers_of

    if not track:
        return perform
    trackers_of(track, 1)
    if not any(suite.kind in TRACKED for suite in suites):
        have = ", ".join(dict.fromkeys(suite.kind for suite in suites))
        kinds = ", ".join(TRACKED)
        raise UserError(f"--track shows runs of agents (suites of the kinds {kinds}), and these are of the kinds {have}")
    return functools.partial(perform, track=track)


def _executor(options: Bench, work: "Work"):
    if options.executor == "ray":
        if options.idle:
            raise UserError("--idle needs --executor local")
        if options.workers is not None:
            raise UserError("--workers needs --executor local; a Ray cluster runs as many jobs as --cpus and --gpus allow")
        from deadreckon.bench.cluster import Cluster

        return Cluster(Path(options.out), options.address, options.cpus, options.gpus, work)
    from deadreckon.bench.local import Local

    for name, default in (("address", None), ("cpus", 1), ("gpus", 0.0)):
        if getattr(options, name) != default:
            raise UserError(f"--{name} needs --executor ray")
    return Local(Path(options.out), options.workers, work, options.idle)


def _page(suite, jobs, store, full: bool = False):
    """The suite's page, which links to one per log or task; those of the full size have names of their own."""
    from deadreckon.bench.jobs import file_name
    from deadreckon.bench.tables import tables
    from deadreckon.report import write
    from deadreckon.report.suite import write_suite

    name = file_name(f"{suite.name}-full" if full else suite.name)
    if suite.kind == "ope":
        from deadreckon.ope.dope import from_json
        from deadreckon.report.dope import write_bench

        # By their names in the suite, which may have one estimator with several settings, and not in the one that did them.
        names = {cell: job.method for job in jobs for cell in job.cells}
        told = [(names[row["cell"]], json.loads(row["more"])["result"]) for row in store.of(jobs).to_pylist()]
        results = [dataclasses.replace(from_json(result), method=name) for name, result in told]
        return write_bench(results, store.path / "reports" / f"{name}.html") if results else None
    pages = []
    folders = {row["cell"]: store.run_of(row) for row in store.of(jobs).to_pylist()}
    for on in suite.on if suite.kind != "design" else ():
        cells = [cell for job in jobs if job.on == on for cell in job.cells if cell in folders]
        runs = [folder for folder in dict.fromkeys(folders[cell] for cell in cells) if folder.exists()]  # not on another node
        if runs:
            page = store.path / "reports" / f"{file_name(f'{name}-{on}')}.html"
            pages.append(write(runs, page, title=f"{suite.name}: {on}"))
    return write_suite(tables(suite, jobs, store), store.path / "reports" / f"{name}.html", pages)
