"""How much of SUMO's own speed the Flow tasks keep: `python benchmarks/flow.py [--repeats 3]`; needs the extra `flow`.

All rates are environment steps a second of processor time, so that other work on the machine counts little; on an idle machine
they are those of one core, because whoever asks waits while SUMO's process works.

- "raw": what SUMO spends in its own steps, of 64 roads with random actions: as if nothing were asked of it or told to it;
- "simulator": the same roads with actions set, observations and rewards read, as the process does it;
- "collect": rows of `deadreckon.collect.generate`, everything included: both processes, starts, columns on disk.
"""

import argparse
import multiprocessing
import os
import platform
import resource
import statistics
import time
from datetime import UTC, datetime
from importlib import metadata

import numpy as np

from deadreckon.bench.idle import measuring

COPIES = 64  # as many as a collection has side by side


def stepped(road: str, seed: int) -> tuple[float, float]:
    """Seconds in SUMO's steps, and in all, of an episode on each of `COPIES` roads."""
    from deadreckon import tasks
    from deadreckon.tasks.flow_world import World

    task = tasks.task(f"flow-{road}")
    generator, bound = np.random.default_rng(seed), task.action_space.high[0]
    world = World(road, COPIES, task.horizon, True)
    spent, step = 0.0, world.sumo.simulationStep

    class Timed:
        def __getattr__(self, name):
            return getattr(sumo, name)

        def simulationStep(self):
            nonlocal spent
            begun = time.process_time()
            step()
            spent += time.process_time() - begun

    sumo, world.sumo = world.sumo, Timed()
    world.begin(np.arange(COPIES), np.array([task.start(generator) for _ in range(COPIES)]))
    begun = time.process_time()
    for _ in range(task.horizon):
        world.step(generator.uniform(-bound, bound, (COPIES, task.action_space.size)).astype(np.float32))
    return spent, time.process_time() - begun


def collected(name: str, rows: int) -> float:
    """Seconds that collecting takes, SUMO's process included."""
    from deadreckon.collect import generate

    generate(name, steps=COPIES, threads=1)  # compiles
    before = used()
    generate(name, steps=rows, threads=1)
    return used() - before


def used() -> float:
    """Seconds of processor time of this process and those that it has waited for."""
    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(each.ru_utime + each.ru_stime for each in map(resource.getrusage, who))


def apart(function, *arguments):
    """Runs it in a process of its own: libsumo has one simulation a process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--roads", nargs="+", default=["ring", "merge"])
    options = parser.parse_args()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("libsumo", "numpy", "jax"))
    print(f"{datetime.now(UTC):%Y-%m-%d}, {os.cpu_count()} cores, Python {platform.python_version()}, {versions}; "
          f"medians of {options.repeats} repeats, load {os.getloadavg()[0]:.1f}")  # fmt: skip
    print("| road | raw | simulator | collect, random | simulator / raw | collect / raw |\n|---|---:|---:|---:|---:|---:|")
    for road in options.roads:
        steps = COPIES * {"ring": 100, "merge": 750}[road]
        rows = max(steps, 48_000)  # starting the processes is no part of it
        rates = []
        for repeat in range(options.repeats):
            raw, simulator = apart(stepped, road, repeat)
            rates.append((steps / raw, steps / simulator, rows / apart(collected, f"flow-{road}-random-v0", rows)))
        raw, simulator, collect = (statistics.median(each) for each in zip(*rates))
        shares = f"{simulator / raw:.2f} | {collect / raw:.2f}"
        print(f"| {road} | {raw:,.0f} | {simulator:,.0f} | {collect:,.0f} | {shares} |", flush=True)


if __name__ == "__main__":
    with measuring():
        main()
