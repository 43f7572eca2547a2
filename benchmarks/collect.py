"""How much of MuJoCo's own speed Maze2D collection keeps: `python benchmarks/collect.py [--repeats 5] [--steps 500000]`.

Interleaved repeats, medians; the calibration product tells whether the machine was busy with something else.

- "loop": a Python loop of `mj_step` on one core, driven by the controller's own logged actions;
- "rollout": the same inside `mujoco.rollout`, one thread, 1,000 steps a call: the raw rate, with no Python in it;
- "collect": rows a second of `deadreckon.collect.generate`, everything included, with one thread and with all cores.
"""

import argparse
import os
import statistics
import time

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from deadreckon.collect import generate
from deadreckon.tasks import task
from deadreckon.tasks.maze2d import model

LENGTH = 1_000


def calibration() -> float:
    matrix = np.ones((600, 600), np.float32)
    start = time.perf_counter()
    for _ in range(20):
        matrix @ matrix
    return 20 * 2 * 600**3 / (time.perf_counter() - start) / 1e9


def segments(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts (count, 5) and forces (count, LENGTH, 2) as the controller really made them."""
    log = generate(f"{name}-v1", steps=count * 2 * LENGTH)
    rows = np.arange(count) * 2 * LENGTH
    starts = np.concatenate([np.zeros((count, 1)), log.observations[rows]], 1)
    return starts.astype(float), log.actions[rows[:, None] + np.arange(LENGTH)].astype(float)


def loop(name: str, starts: np.ndarray, forces: np.ndarray) -> float:
    compiled = model(task(name).layout)
    data = mujoco.MjData(compiled)
    spent = 0.0
    for start, force in zip(starts, forces):
        data.qpos[:], data.qvel[:] = start[1:3], start[3:]
        step, control = mujoco.mj_step, data.ctrl
        begin = time.perf_counter()
        for row in force:
            control[:] = row
            step(compiled, data)
        spent += time.perf_counter() - begin
    return len(starts) * LENGTH / spent


def loop_alone(name: str, starts: np.ndarray) -> float:
    """Only the calls of `mj_step`, forces held."""
    compiled = model(task(name).layout)
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:] = starts[0, 1:3], starts[0, 3:]
    step, steps = mujoco.mj_step, len(starts) * LENGTH
    begin = time.perf_counter()
    for _ in range(steps):
        step(compiled, data)
    return steps / (time.perf_counter() - begin)


def rollout(name: str, starts: np.ndarray, forces: np.ndarray) -> float:
    compiled = model(task(name).layout)
    data = mujoco.MjData(compiled)
    state = np.empty((len(starts), LENGTH, 5))
    begin = time.perf_counter()
    with Rollout(nthread=0) as pool:
        pool.rollout(compiled, data, starts, forces, state=state)
    return state.shape[0] * LENGTH / (time.perf_counter() - begin)


def rows(name: str, steps: int, threads: int) -> float:
    begin = time.perf_counter()
    generate(f"{name}-v1", steps=steps, threads=threads)
    return steps / (time.perf_counter() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--mazes", nargs="+", default=["maze2d-umaze", "maze2d-medium", "maze2d-large"])
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    for name in options.mazes:
        starts, forces = segments(name, 100)
        measures = {
            "mj_step alone": lambda name=name, starts=starts: loop_alone(name, starts),
            "mj_step loop": lambda name=name, starts=starts, forces=forces: loop(name, starts, forces),
            "rollout, 1 thread": lambda name=name, starts=starts, forces=forces: rollout(name, starts, forces),
            "collect, 1 thread": lambda name=name: rows(name, options.steps, 1),
            f"collect, {cores} threads": lambda name=name: rows(name, options.steps, cores),
        }
        raw, ours = list(measures)[:3], list(measures)[3:]
        found: dict[str, list[float]] = {key: [] for key in measures}
        busy: dict[str, list[float]] = {key: [] for key in measures}
        calibrations = []
        for _ in range(options.repeats):
            calibrations.append(calibration())
            for key, measure in measures.items():
                wall, cpu = time.perf_counter(), time.process_time()
                found[key].append(measure())
                busy[key].append((time.process_time() - cpu) / (time.perf_counter() - wall))
        drift = max(calibrations) / min(calibrations) - 1
        print(f"{name}: {options.repeats} interleaved repeats, {options.steps:,} rows; calibration drifts {100 * drift:.0f} %")
        for key, values in found.items():
            low, middle, high = min(values), statistics.median(values), max(values)
            print(f"  {key:18s} {middle:9,.0f} steps/s ({low:,.0f} .. {high:,.0f}) on {statistics.median(busy[key]):.2f} cores")
        for key in ours:
            ratios = ", ".join(f"{statistics.median(np.divide(found[key], found[r])):.2f} of {r}" for r in raw)
            print(f"  {key}: {ratios}")
        # A machine that others use too takes the core away for a while: per second of its own processor time, it shows less.
        used = {key: np.divide(found[key], busy[key]) for key in (*raw, ours[0])}
        ratios = ", ".join(f"{statistics.median(used[ours[0]] / used[r]):.2f} of {r}" for r in raw)
        print(f"  {ours[0]}, per second of processor time: {ratios}")


if __name__ == "__main__":
    main()
