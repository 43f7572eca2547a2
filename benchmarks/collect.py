"""How much of the simulators' own speed collection keeps: `python benchmarks/collect.py [--repeats 5] [--out FILE]`.

Interleaved repeats, medians; the calibration product tells whether the machine was busy with something else.

Maze2D (`--mazes`, empty for none), beside MuJoCo:

- "loop": a Python loop of `mj_step` on one core, driven by the controller's own logged actions;
- "rollout": the same inside `mujoco.rollout`, one thread, 1,000 steps a call: the raw rate, with no Python in it;
- "collect": rows a second of `deadreckon.collect.generate`, everything included, with one thread and with all cores.

Gym-MuJoCo (`--robots`, empty for none), beside Gymnasium, both on all cores:

- "raw": a process a core, each stepping an environment of its own with random actions that were drawn beforehand, without
  Gymnasium's wrappers, and resetting it where an episode ends; nothing is kept;
- "collect": rows a second of `deadreckon.collect.rollouts.collect_rollouts` with a 256x256 tanh-Gaussian policy, everything
  included: the policy, its log-densities, and the columns on disk.

Robots that are led (`--led`, recipes; `door-expert-v1` too, where DAPG's policies are at hand), beside MuJoCo, on one core:

- "mj_step": a loop of nothing but setting the motors and `mj_step`, through the logged actions, an episode at a time;
- "collect": rows a second of `deadreckon.collect.generate`, everything included, with one thread.

Of Gym-MuJoCo, the two cannot take the same actions: a policy's follow from what it sees. Raw draws `tanh` of standard
normals, much as an untrained policy does, and the mean length of an episode is shown for both. `--policy medium` lets one
that comes with the package act; its episodes are longer than those of raw.
"""

import argparse
import multiprocessing
import os
import platform
import shlex
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from speed import table

from deadreckon.bench.idle import measuring
from deadreckon.collect import generate, recipe
from deadreckon.tasks import task
from deadreckon.tasks.gym_mujoco import TASKS as ROBOTS
from deadreckon.tasks.maze2d import model
from deadreckon.versions import cpu_model

LENGTH = 1_000
RATIO = 0.6  # of Gymnasium's rate, which we promise


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


def mazes(options: argparse.Namespace, cores: int) -> None:
    """Measures the Maze2D tasks and prints it."""
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


# ---- robots that are led ----------------------------------------------------------------------------------------------


def stepped(name: str, log: Any) -> float:
    """Steps a second of physics alone through a log's actions, each of its episodes from the same start."""
    simulator = task(name).simulate([0], 1)
    simulator.reset()
    compiled, data, skip, parts = simulator._models[0], simulator._data[0], simulator._skip, simulator._parts
    begins, actions = set(log.starts.tolist()), np.array(log.actions)
    begin = time.perf_counter()
    for at, action in enumerate(actions):
        if at in begins:
            mujoco.mj_setState(compiled, data, simulator._state[0], parts)
        simulator._control(data, 0, action)
        mujoco.mj_step(compiled, data, skip)
    return len(actions) / (time.perf_counter() - begin)


def led(options: argparse.Namespace) -> None:
    """Measures the recipes and prints it."""
    for name in options.led:
        generate(name, steps=10, threads=1)  # compiles
        shares, calibrations = [], []
        found: dict[str, list[float]] = {"mj_step": [], "collect": []}
        for repeat in range(options.repeats):
            calibrations.append(calibration())
            begin = time.perf_counter()
            log = generate(name, steps=options.led_steps, seed=repeat, threads=1)
            found["collect"].append(len(log) / (time.perf_counter() - begin))
            found["mj_step"].append(stepped(recipe(name).task, log))
            shares.append(found["collect"][-1] / found["mj_step"][-1])
        drift = max(calibrations) / min(calibrations) - 1
        print(f"{name}: {options.repeats} repeats of {options.led_steps:,} rows; calibration drifts {100 * drift:.0f} %")
        for key, rates in found.items():
            print(f"  {key:8s} {statistics.median(rates):9,.0f} steps/s ({min(rates):,.0f} .. {max(rates):,.0f})")
        print(f"  collect keeps {statistics.median(shares):.2f} of mj_step ({min(shares):.2f} .. {max(shares):.2f})")


# ---- Gym-MuJoCo -----------------------------------------------------------------------------------------------------


def step_raw(pipe: Any, name: str, seed: int) -> None:
    """A process that answers every number of steps with the episodes that it began in so many."""
    import gymnasium

    found = task(name)
    # v2's contact forces are no part of our tasks: without them Gymnasium has less to do.
    options = {"include_cfrc_ext_in_observation": False, "contact_cost_weight": 0.0} if name in ("ant", "humanoid") else {}
    env = gymnasium.make(found.gym_id.removeprefix("deadreckon/"), **options).unwrapped
    high = np.array(found.action_space.high)
    actions = (high * np.tanh(np.random.default_rng(seed).standard_normal((10_000, len(high))))).astype(np.float32)
    env.reset(seed=seed)
    age, at = 0, 0
    while steps := pipe.recv():
        episodes = 0
        for _ in range(steps):
            terminated = env.step(actions[at])[2]
            at = (at + 1) % len(actions)
            age += 1
            if terminated or age == found.horizon:
                env.reset()
                age = 0
                episodes += 1
        pipe.send(episodes)


@contextmanager
def processes(name: str, count: int) -> Iterator[list[Any]]:
    """Pipes to `count` processes that step an environment each."""
    context = multiprocessing.get_context("spawn")
    pairs = [context.Pipe() for _ in range(count)]
    workers = [context.Process(target=step_raw, args=(pair[1], name, i), daemon=True) for i, pair in enumerate(pairs)]
    for worker in workers:
        worker.start()
    pipes = [pair[0] for pair in pairs]
    try:
        raw(pipes, 100 * count)  # until all of them are there
        yield pipes
    finally:
        for pipe, worker in zip(pipes, workers):
            pipe.send(0)
            worker.join()


def raw(pipes: list[Any], steps: int) -> tuple[float, float]:
    """Steps a second of all processes together, and steps an episode."""
    begin = time.perf_counter()
    for pipe in pipes:
        pipe.send(steps // len(pipes))
    episodes = sum(pipe.recv() for pipe in pipes)
    return steps // len(pipes) * len(pipes) / (time.perf_counter() - begin), steps / max(episodes, 1)


def acting(name: str, policy: str) -> Any:
    """The policy that collects: one of the package's, or an untrained one of the same size."""
    import jax

    from deadreckon.agents.sac import SAC
    from deadreckon.data.normalizer import Normalizer
    from deadreckon.data.spec import Spec
    from deadreckon.policies import library
    from deadreckon.policies.deployed import EnvPolicy

    if policy != "untrained":
        return library.snapshot(name, policy).policy()
    found = task(name)
    spec = Spec.empty(found.observation_shape, found.action_space, name)
    return EnvPolicy.of(SAC().policy(SAC().init(spec, jax.random.key(0))), Normalizer.of(spec))


def perform_rows(name: str, policy: Any, steps: int, threads: int) -> tuple[float, float]:
    """Rows a second of a collection, and steps an episode."""
    from deadreckon.collect.rollouts import Segment, collect_rollouts
    from deadreckon.data.provenance import Provenance

    with tempfile.TemporaryDirectory() as scratch:
        begin = time.perf_counter()
        log = collect_rollouts(
            task(name), [Segment(policy, steps)], name=name, seed=0, provenance=Provenance(), scratch=Path(scratch),
            threads=threads,
        )  # fmt: skip
        return steps / (time.perf_counter() - begin), steps / log.episodes


def robots(options: argparse.Namespace, cores: int) -> str:
    """Measures the Gym-MuJoCo tasks and gives the page about it."""
    lines, drifts = [], []
    for name in options.robots:
        policy = acting(name, options.policy)
        perform_rows(name, policy, 100, cores)  # compiles
        found: dict[str, list[tuple[float, float]]] = {"raw": [], "collect": []}
        calibrations = []
        with processes(name, cores) as pipes:
            for _ in range(options.repeats):
                calibrations.append(calibration())
                found["raw"].append(raw(pipes, options.robot_steps))
                found["collect"].append(perform_rows(name, policy, options.robot_steps, cores))
        drifts.append(max(calibrations) / min(calibrations) - 1)
        rates, lengths = ({key: [row[i] for row in rows] for key, rows in found.items()} for i in (0, 1))
        ratio = statistics.median(np.divide(rates["collect"], rates["raw"]))
        cells = [f"{statistics.median(r):,.0f} ({min(r):,.0f} to {max(r):,.0f})" for r in rates.values()]
        long = " / ".join(f"{statistics.median(lengths[key]):,.0f}" for key in ("raw", "collect"))
        verdict = f"≥ {RATIO}" if ratio >= RATIO else "missed"
        lines.append([name, *cells, f"{ratio:.2f}", long, f"{100 * drifts[-1]:.0f} %", verdict])
    versions = ", ".join(f"{each} {metadata.version(each)}" for each in ("deadreckon", "gymnasium", "mujoco", "jax", "numpy"))
    who = "an untrained policy" if options.policy == "untrained" else f"the package's policy `{options.policy}`"
    return "\n".join(
        [
            "# Collection beside Gymnasium",
            "",
            f"`python benchmarks/collect.py {shlex.join(sys.argv[1:])}`",
            "",
            f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC · {cpu_model()}, {cores} cores used · {platform.system()} "
            f"{platform.machine()}  ",
            versions,
            "",
            f"Steps a second: median (least to greatest) of {options.repeats} interleaved repeats of {options.robot_steps:,} "
            f"steps; the ratio is the median over pairs. Raw: {cores} processes, each stepping Gymnasium's environment "
            "without wrappers, with random actions that were drawn beforehand; nothing is kept. Collect: "
            f"{who} (256x256, tanh-Gaussian), its log-densities and the columns on disk, {cores} threads. Drift: of a matrix "
            "product timed before every pair.",
            "",
            *table(
                ["task", "raw Gymnasium", "collect", "ratio", "steps an episode, raw / collect", "drift", "verdict"], lines
            ),
        ]
    ).rstrip() + "\n"  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--mazes", nargs="*", default=["maze2d-umaze", "maze2d-medium", "maze2d-large"])
    parser.add_argument("--robots", nargs="*", default=[robot.name for robot in ROBOTS])
    parser.add_argument("--robot-steps", type=int, default=200_000, help="a repeat")
    parser.add_argument("--led", nargs="*", default=["antmaze-umaze-v2", "antmaze-large-play-v2", "kitchen-mixed-v0"])
    parser.add_argument("--led-steps", type=int, default=10_000, help="a repeat")
    parser.add_argument("--policy", default="untrained", help="who collects: untrained, or such as medium or snapshot-05")
    parser.add_argument("--out", type=Path, help="markdown page about the robots (default: print it)")
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    mazes(options, cores)
    led(options)
    if options.robots:
        page = robots(options, cores)
        if options.out is None:
            print(page, end="")
        else:
            options.out.write_text(page)


if __name__ == "__main__":
    with measuring():
        main()
