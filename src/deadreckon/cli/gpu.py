"""`deadreckon bench --gpu`: fills an accelerator for a limited time with what several suites lack."""

import time
from pathlib import Path

from deadreckon.bench.device import device_kind, required, shared
from deadreckon.bench.executor import Event, Executor, run
from deadreckon.bench.filling import Filling, Load, Planned, jobs_of, missing, schedule, use
from deadreckon.bench.ledger import store_of
from deadreckon.bench.local import Local
from deadreckon.bench.rates import Rates, assumed_device
from deadreckon.bench.store import Store
from deadreckon.bench.suite import queue
from deadreckon.cli.lines import Lines
from deadreckon.errors import UserError
from deadreckon.interrupts import resumable
from deadreckon.runs.durations import in_words
from deadreckon.versions import cores

MOST = 8  # processes where nobody says how many: no more were measured side by side


def fill(suite: str, path: Path, seconds: float, workers: int | None, dry_run: bool) -> None:
    """Plans, and does it unless a dry run is asked for.

    Args:
        suite: name of a suite, or a file of a suite or a queue.
        path: folder of results.
        seconds: that are filled.
        workers: processes; None: half as many as cores, up to `MOST`.
        dry_run: print the plan alone.

    Raises:
        UserError: JAX sees no accelerator, or fewer than one worker.
    """
    if workers is not None and workers < 1:
        raise UserError(f"workers must be 1 or more, got {workers}")
    if dry_run:
        return print(plan_told(suite, path, seconds, workers, device_kind()))
    with shared() as how:
        kind = device_kind()
        if kind is None:
            raise UserError("--gpu needs an accelerator, and JAX sees none; --dry-run prints a plan nevertheless")
        print(how)
        with required():
            _run(suite, path, seconds, workers, kind)


def _prepared(
    suite: str, path: Path, seconds: float, workers: int | None, kind: str | None
) -> tuple[Store, Rates, list[Load], int]:
    small = queue(suite)
    large = queue(suite, full=True) if any(each.full for each in small) else []
    store = store_of(small, path)
    measured = path / "rates.json"
    rates = Rates(assumed_device(), measured) if kind is None else Rates(kind, measured, len(cores()))
    workers = workers or max(2, min(MOST, rates.cores // 2))
    return store, rates, missing(small, large, store, rates, seconds), workers


def plan_told(suite: str, path: Path, seconds: float, workers: int | None = None, kind: str | None = None) -> str:
    """What a dry run prints: a line a program, and what they make of the time.

    Args:
        suite, path, seconds, workers: as of `fill`.
        kind: of the device, as JAX calls it; None where there is none, and the plan is for one of which rates are known.
    """
    _, rates, loads, processes = _prepared(suite, path, seconds, workers, kind)
    planned = schedule(loads, seconds, processes)
    which = rates.device if kind else f"{rates.device}, which this machine does not have,"
    made = use(planned, seconds)
    cells = sum(one.load.program.lanes for one in planned if one.end is not None)
    left = sum(load.program.lanes for load in loads) - cells
    whole = f"{made.training:.0%} of it in training, {made.lanes:.0f} lanes on average"
    return "\n".join(
        [
            f"{Path(suite).stem}: {in_words(seconds)} of one {which} and {rates.cores} cores, {processes} processes",
            *(f"  {_line(one)}" for one in planned),
            f"{cells:,} cells would be done; {left:,} that train on logs would be left, some of them started",
            f"{made.rate:,.0f} updates per second, all seeds together, on average over the whole time, {whole}",
        ]
    )


def _line(one: Planned) -> str:
    load = one.load
    ends = "is started and continues another time" if one.end is None else f"done after {in_words(one.end)}"
    size, known = "full" if load.full else "CPU", "measured" if load.measured else "estimated"
    took = in_words(one.trained - one.trains)
    rate = f"{load.rate:,.0f} updates/s ({known})"
    return f"{load.program}, {size} size, {load.program.lanes} lanes: trains {took} at {rate}, {ends}"


def _run(suite: str, path: Path, seconds: float, workers: int | None, kind: str) -> None:
    began = time.monotonic()
    store, rates, loads, processes = _prepared(suite, path, seconds, workers, kind)
    jobs, filling, lines = jobs_of(loads), Filling(rates, store), Lines(len(loads))

    def told(event: Event) -> None:
        filling.hear(event)
        lines(event)

    with resumable(store.path, store.place):
        run(jobs, store, told, _executor(path, processes), seconds - (time.monotonic() - began), filling)
    took = time.monotonic() - began
    left = sum(len(job.seeds) for job in store.undone(jobs))
    print(
        f"{filling.updates / took:,.0f} updates per second, all seeds together, on average over {in_words(took)}, "
        f"{filling.training / took:.0%} of it in training; results in {store.place}"
    )
    if left:
        print(f"{left:,} cells that train on logs are left; the same command continues with them")
        raise SystemExit(1)


def _executor(path: Path, workers: int) -> Executor:
    return Local(path, workers)
