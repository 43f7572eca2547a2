"""What the runner of `deadreckon bench` costs beside the work itself: `python benchmarks/runner.py`.

Jobs that only sleep are run in as many processes as there are cores, by the local executor and on a Ray cluster of this
machine; what they take more than their sleep is the runner's. Then a plan of many cells is made, its results are written, found
again and shown.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deadreckon.bench.cluster import Cluster
from deadreckon.bench.executor import run
from deadreckon.bench.forms import rendered
from deadreckon.bench.idle import measuring
from deadreckon.bench.jobs import Job, Program, programs
from deadreckon.bench.local import Local
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import tables
from deadreckon.bench.times import forecast


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--seconds", type=float, default=10.0, help="that a cell sleeps")
    add("--each", type=int, default=8, help="cells of a worker")
    add("--executors", nargs="*", default=["local", "ray"], choices=["local", "ray"])
    add("--cells", type=int, default=10_000, help="of the plan")
    return parser.parse_args()


def rows(job: Job, seconds: float) -> JobResult:
    """Results of a job that did nothing."""
    told = {"score": 1.0, "raw": 1.0, "steps": 1, "seconds": seconds, "failure": "", "versions": json.dumps({"jax": "-"})}
    return JobResult([{"seed": seed} | told for seed in job.seeds], [])


def sleep(program: Program, folder: Path, watch: Callable[[int, int], None]) -> list[JobResult]:
    """Sleeps in ten parts, and tells of each."""
    [job] = program.jobs
    for part in range(10):
        time.sleep(job.options["seconds"] / 10)
        watch(part + 1, 10)
    return [rows(job, job.options["seconds"])]


def overhead(name: str, seconds: float, each: int) -> None:
    """Sleeping jobs, from the start of the first process to the last result on disk."""
    with tempfile.TemporaryDirectory() as folder:
        store, began = Store(Path(folder)), time.perf_counter()
        executor = {"local": Local, "ray": Cluster}[name](store.path, work=sleep)
        workers = executor.workers
        jobs = [Job("sleep", "sleep", "", {}, "", "", str(i), {"seconds": seconds}, (0,)) for i in range(each * workers)]
        run(jobs, store, lambda event: None, executor)
        took = time.perf_counter() - began
        assert len(store.results()) == len(jobs)
    more = took / (each * seconds) - 1
    what = f"{len(jobs)} cells of {seconds:g} s on {workers} workers"
    print(f"{name}: {what} took {took:.1f} s, {100 * more:.1f} % more than their sleep")


def planning(cells: int) -> None:
    """A plan, and a folder with all its results."""
    seeds, logs = 5, [f"maze2d-{maze}-v1" for maze in ("umaze", "medium", "large", "eval-umaze")]
    methods = cells // (seeds * len(logs))
    text = f"seeds = {seeds}\nlanes = 1\nlogs = {json.dumps(logs)}\n[methods]\n"
    text += "".join(f'm{i} = {{ agent = "td3_bc", fields = {{ alpha = {1.0 + i / methods} }} }}\n' for i in range(methods))
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "many.toml").write_text(text)
        store, times = Store(Path(folder) / "out"), {}

        def timed(what: str, do: Callable):
            began = time.perf_counter()
            found = do()
            times[what] = time.perf_counter() - began
            return found

        suite = timed("read the suite", lambda: read(path))
        jobs = timed("plan", lambda: plan(suite))
        timed("find what is missing in an empty folder", lambda: store.undone(jobs))
        timed("write all results", lambda: [store.keep(job, rows(job, 1.0)) for job in jobs])
        assert timed("find what is missing in a full one", lambda: store.undone(jobs)) == []
        timed("forecast of what is missing (all results are read)", lambda: forecast(programs(jobs[:1]), store))
        timed("make the table", lambda: rendered(tables(suite, jobs, store), "csv"))
    print(f"{sum(len(job.seeds) for job in jobs):,} cells in {len(jobs):,} jobs")
    for what, took in times.items():
        print(f"  {what}: {took:.2f} s")


if __name__ == "__main__":
    options = parse()
    with measuring():
        for executor in options.executors:
            overhead(executor, options.seconds, options.each)
        if options.cells:
            np.seterr(all="ignore")  # scores that are all the same have no spread
            planning(options.cells)
