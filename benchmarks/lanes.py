"""Many seeds as lanes of one program, as processes, or one after another: `python benchmarks/lanes.py`.

Each way trains the same agent (TD3+BC, batch 256, networks 256x256) on the same synthetic log, and says how many updates of a
seed it makes a second, all seeds together, and how long a process needs before its first update is done (start, imports,
compiling). Processes are started together and wait for each other before they are timed; on a CPU each has a core of its own.

With --settings N it says instead how long whole runs of N learning rates take, as lanes of one program and one after another
in one process: start, compiling and checkpoints included, each way in processes of its own, by turns, on a CPU on one core;
programs come from the cache of compiled ones.
The first repeat compiles for those that follow and is not counted.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import protocol

from deadreckon.bench.idle import measuring

HERE = Path(__file__).resolve().parent


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--agent", default="td3_bc")
    add("--lanes", type=int, nargs="+", default=[1, 4, 16], help="seeds of one program, in one process; 1 is one after another")
    add("--processes", type=int, nargs="*", default=[2], help="processes of one seed each, side by side")
    add("--seconds", type=float, default=10.0, help="that each is timed")
    add("--repeats", type=int, default=3)
    add("--width", type=int, default=256, help="of both hidden layers")
    add("--chunk", type=int, default=500, help="updates between two looks from outside")
    add("--platform", default="cpu", help="of JAX: cpu, or cuda")
    add("--settings", type=int, help="whole runs of so many settings instead, with one seed each")
    add("--steps", type=int, default=5000, help="updates of each of those runs")
    add("--worker", type=int, help=argparse.SUPPRESS)  # seeds of this worker
    add("--together", choices=["yes", "no"], help=argparse.SUPPRESS)  # how this worker runs settings
    return parser.parse_args()


def work(arguments: argparse.Namespace) -> None:
    """A worker: builds, makes a chunk, and then makes chunks for so many seconds whenever it is asked to."""
    began = time.perf_counter()
    import jax

    from deadreckon.agents import agent_class
    from deadreckon.cli.main import cache_compiled_programs
    from deadreckon.data.batch import TransitionSource
    from deadreckon.data.dataset import Dataset
    from deadreckon.training.fit import Fit

    cache_compiled_programs()
    shape = protocol.options("td3_bc", batch=256, width=arguments.width, threads=1)
    log = Dataset.from_arrays(**protocol.synthetic_log(shape))
    agent = agent_class(arguments.agent)(hidden=(arguments.width,) * 2).resolve(log.spec, 10**9)
    seeds = list(range(arguments.worker))
    walk = Fit([agent] * len(seeds), TransitionSource(log, agent.needs(log.spec)), seeds, 10**9, chunk=arguments.chunk).chunks()
    jax.block_until_ready(next(walk).states)
    print(json.dumps({"ready": time.perf_counter() - began}), flush=True)
    for line in sys.stdin:
        done, start = 0, time.perf_counter()
        while time.perf_counter() - start < float(line):
            jax.block_until_ready(next(walk).states)
            done += arguments.chunk
        print(json.dumps({"rate": done * len(seeds) / (time.perf_counter() - start)}), flush=True)


def measure(arguments: argparse.Namespace, processes: int, lanes: int) -> dict[str, Any]:
    """Updates of a seed a second, of all processes together: median, least and greatest of the repeats."""
    cores = sorted(os.sched_getaffinity(0))
    command = [sys.executable, str(HERE / "lanes.py"), "--worker", str(lanes), "--chunk", str(arguments.chunk)]
    command += ["--agent", arguments.agent, "--width", str(arguments.width)]
    workers = []
    for index in range(processes):
        # Processes of one seed share the cores evenly: a program that takes all of them would fight with its neighbours.
        own = {cores[index % len(cores)]} if processes > 1 and arguments.platform == "cpu" else set(cores)
        start = ["taskset", "-c", ",".join(map(str, sorted(own)))]
        workers.append(
            subprocess.Popen(
                start + command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                env={**os.environ, "JAX_PLATFORMS": arguments.platform},
            )
        )  # fmt: skip

    def answers(key: str) -> list[float]:
        lines = [worker.stdout.readline() for worker in workers]
        if not all(lines):
            raise protocol.BenchError(f"{processes} processes of {lanes} seeds: a worker ended; what it said stands above")
        return [json.loads(line)[key] for line in lines]

    ready, rates = max(answers("ready")), []
    for _ in range(arguments.repeats):
        for worker in workers:
            worker.stdin.write(f"{arguments.seconds}\n")
            worker.stdin.flush()
        rates.append(sum(answers("rate")))
    for worker in workers:
        worker.stdin.close()
        worker.wait()
    return {"rate": statistics.median(rates), "least": min(rates), "most": max(rates), "ready": ready}


def run_settings(arguments: argparse.Namespace) -> None:
    """A worker: trains all settings, with a folder of their own on disk each."""
    from deadreckon.agents import agent_class
    from deadreckon.cli.main import cache_compiled_programs
    from deadreckon.data.dataset import Dataset
    from deadreckon.runs.train import train, train_together

    cache_compiled_programs()
    shape = protocol.options("td3_bc", batch=256, width=arguments.width, threads=1)
    log, kind = Dataset.from_arrays(**protocol.synthetic_log(shape)), agent_class(arguments.agent)
    rates = [1e-4 * (1 + i) for i in range(arguments.settings)]
    agents = {f"{i}": kind(hidden=(arguments.width,) * 2, actor_lr=rate, critic_lr=rate) for i, rate in enumerate(rates)}
    options: dict[str, Any] = {"steps": arguments.steps, "evaluate_every": arguments.steps, "chunk": arguments.chunk}
    with tempfile.TemporaryDirectory() as folder:
        if arguments.together == "yes":
            train_together(agents, log, out=Path(folder) / "all", **options)
            return
        for name, agent in agents.items():
            train(agent, log, out=Path(folder) / name, **options)


def compare_settings(arguments: argparse.Namespace) -> None:
    cores = sorted(os.sched_getaffinity(0))
    own = cores[:1] if arguments.platform == "cpu" else cores  # a worker of `deadreckon bench` has as many
    names = {"no": "one after another", "yes": "lanes of one program"}
    took: dict[str, list[float]] = {way: [] for way in names}
    for repeat in range(arguments.repeats + 1):
        for way, seconds in took.items():
            command = ["taskset", "-c", ",".join(map(str, own)), sys.executable, str(HERE / "lanes.py"), "--together", way]
            for name in ("settings", "steps", "agent", "width", "chunk"):
                command += [f"--{name}", str(getattr(arguments, name))]
            began = time.perf_counter()
            subprocess.run(command, check=True, env={**os.environ, "JAX_PLATFORMS": arguments.platform})
            if repeat:
                seconds.append(time.perf_counter() - began)
    print(f"| {arguments.settings} settings, {arguments.steps:,} updates each | seconds | relative to one after another |")
    print("|---|---:|---:|")
    alone = statistics.median(took["no"])
    for way, seconds in took.items():
        middle = statistics.median(seconds)
        print(f"| {names[way]} | {middle:.0f} [{min(seconds):.0f}, {max(seconds):.0f}] | {middle / alone:.2f} |")


def compare(arguments: argparse.Namespace) -> int:
    if arguments.together is not None:
        run_settings(arguments)
        return 0
    if arguments.settings is not None:
        compare_settings(arguments)
        return 0
    if arguments.worker is not None:
        work(arguments)
        return 0
    ways = [(1, lanes) for lanes in arguments.lanes] + [(count, 1) for count in arguments.processes]
    print("| seeds at once | updates per second, sum over seeds | relative to one after another | seconds to the first |")
    print("|---|---:|---:|---:|", flush=True)
    alone = None
    for processes, lanes in ways:
        took = measure(arguments, processes, lanes)
        alone = alone or took["rate"]
        name = f"{processes} processes" if processes > 1 else f"{lanes} lanes" if lanes > 1 else "one"
        spread = f"{took['rate']:,.0f} [{took['least']:,.0f}, {took['most']:,.0f}]"
        print(f"| {name} | {spread} | {took['rate'] / alone:.2f} | {took['ready']:.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    # A worker is a part of the measurement that started it, which holds the lock.
    asked = parse()
    with measuring() if asked.worker is None and asked.together is None else contextlib.nullcontext():
        sys.exit(protocol.told(lambda: compare(asked)))
