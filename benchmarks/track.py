"""What trackers and callbacks cost a run: `python benchmarks/track.py`.

Runs of the same agent on the same log take turns: with nothing, with a callback, and with each tracker. Counted is processor
time from the end of the first chunk (compiling is over) to the end of the last, of all threads and of processes that a tracker
starts, so that other work on the machine counts little; and, within a tracked run, the share that tracking itself took of it.
W&B runs offline and MLflow writes to a SQLite file: how long a server takes is the server's, and another thread waits for it.
"""

import argparse
import os
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import protocol

from deadreckon.agents import agent_class
from deadreckon.bench.idle import measuring
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.data.dataset import Dataset
from deadreckon.runs.trackers.feed import Tracking
from deadreckon.runs.train import train

WAYS = ("nothing", "callback", "tensorboard", "wandb", "mlflow")
MOST = 0.01  # that tracking may take of the time


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    add("--steps", type=int, default=5_000, help="updates of a run")
    add("--chunk", type=int, default=1_000, help="updates between two points; the default of runs")
    add("--repeats", type=int, default=5)
    add("--width", type=int, default=256)
    return parser.parse_args()


class Counted:
    """Processor time that tracking takes, by wrapping what it does in either thread."""

    def __init__(self):
        self.seconds, self.lock = 0.0, threading.Lock()
        for name in ("told", "_give"):
            setattr(Tracking, name, self.wrapped(getattr(Tracking, name)))

    def wrapped(self, method: Any) -> Any:
        def call(*arguments: Any) -> Any:
            began = time.thread_time()
            try:
                return method(*arguments)
            finally:
                with self.lock:
                    self.seconds += time.thread_time() - began

        return call


def spent() -> float:
    """Seconds of processors so far, of this process and those that it has waited for."""
    now = os.times()
    return now.user + now.system + now.children_user + now.children_system


def run(way: str, log: Dataset, arguments: argparse.Namespace, counted: Counted) -> tuple[float, float]:
    """Processor seconds of an update, and the share of them that tracking took."""
    agent = agent_class("td3_bc")(hidden=(arguments.width,) * 2)
    options: dict[str, Any] = {"steps": arguments.steps, "chunk": arguments.chunk, "evaluate_every": arguments.steps}
    first: list[float] = []

    def watch(progress: Any, steps: int) -> None:
        if not first:
            first.append(spent())
            counted.seconds = 0.0

    if way == "callback":
        options["callback"] = lambda progress: progress.metrics["critic_loss"].mean() > 1e9
    elif way != "nothing":
        options["track"] = way
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{folder}/mlflow.db"
        train(agent, log, out=Path(folder) / "run", holdout=0, task=False, watch=watch, **options)
        if way == "wandb":
            import wandb

            wandb.teardown()  # ends its process, whose time counts only then
    took = spent() - first[0]
    return took / (arguments.steps - arguments.chunk), counted.seconds / took


def report() -> int:
    arguments = parse()
    cache_compiled_programs()
    os.environ["WANDB_MODE"] = "offline"
    shape = protocol.options("td3_bc", batch=256, width=arguments.width, threads=1)
    log, counted = Dataset.from_arrays(**protocol.synthetic_log(shape)), Counted()
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in arguments.ways}
    run("nothing", log, arguments, counted)  # compiles
    for _ in range(arguments.repeats):
        for way, own in found.items():
            own.append(run(way, log, arguments, counted))
    plain = statistics.median(took for took, _ in found["nothing"]) if "nothing" in found else float("nan")
    wide = f"{arguments.width}x{arguments.width}, a point every {arguments.chunk:,} updates"
    print(f"TD3+BC, batch 256, networks {wide}, {arguments.repeats} runs of {arguments.steps:,} updates each by turns\n")
    print("| with | processor time of an update (ms) | beside nothing | share of tracking itself |\n|---|---:|---:|---:|")
    for way, own in found.items():
        took, share = statistics.median(took for took, _ in own), statistics.median(share for _, share in own)
        spread = f"[{1e3 * min(took for took, _ in own):.2f}, {1e3 * max(took for took, _ in own):.2f}]"
        tracked = "" if way in ("nothing", "callback") else f"{100 * share:.2f} %"
        print(f"| {way} | {1e3 * took:.2f} {spread} | {took / plain:.3f} | {tracked} |")
    return int(any(statistics.median(share for _, share in own) > MOST for own in found.values()))


if __name__ == "__main__":
    with measuring():
        raise SystemExit(protocol.told(report))
