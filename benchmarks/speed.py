"""Updates per second beside d3rlpy, in turn on the same cores: `python benchmarks/speed.py`.

Ours and d3rlpy take turns (ours, peer, ours, peer, ...) in two processes that stay alive. Before and after every slice
the driver times a matrix product; a pair of slices in which that drifts is thrown away and run again. So is one in which
other processes used the cores: under steady load the product is slow but steady, while thread pools that wait by spinning
(torch's) lose a hundredfold, and the ratio would mean nothing.
"""

import argparse
import json
import math
import os
import platform
import shlex
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import flops
import peers
import protocol
from protocol import BenchError, Worker

from deadreckon.bench.idle import measuring
from deadreckon.versions import cpu_model

HERE = Path(__file__).resolve().parent
RATIO, SHARE = 2.5, 0.6  # what we promise: this many times d3rlpy, or this part of the machine's rate
FQE_RATIO = 3.0  # of many policies at once; the rate is no way out there
NEMO_RATIO = 1.5  # of NEMO, beside a loop over its models in PyTorch; see nemo_parts.py for the share of the rate


@dataclass
class Row:
    """What was measured for one case."""

    case: str
    options: dict[str, Any]
    ours: list[float] = field(default_factory=list)  # updates/s of each accepted slice
    peer: list[float] = field(default_factory=list)
    rate: list[float] = field(default_factory=list)  # FLOP/s of XLA's 1024 product beside each of our slices
    rejected: int = 0
    wanted: int = 0
    needed: float = 0.0  # FLOPs of an update: as counted, of our program, of d3rlpy as counted, of d3rlpy as run
    program: float | None = None
    peer_counted: float = 0.0
    peer_program: float | None = None
    settings: str = ""
    error: str = ""

    @property
    def ratio(self) -> float | None:
        return statistics.median(self.ours) / statistics.median(self.peer) if self.ours and self.peer else None

    @property
    def promise(self) -> float:
        """How many times d3rlpy."""
        return {"fqe": FQE_RATIO, "nemo": NEMO_RATIO}.get(self.options["peer"], RATIO)

    @property
    def work(self) -> float:
        """FLOPs that we take credit for: never more than the program does."""
        return min(self.needed, self.program) if self.program else self.needed

    @property
    def share(self) -> float | None:
        """Part of the rate, each slice against the product timed beside it."""
        return statistics.median(u * self.work / r for u, r in zip(self.ours, self.rate)) if self.rate else None

    @property
    def share_for_ratio(self) -> float | None:
        """Part of the rate that the promised multiple of d3rlpy would take: towards 1 the arithmetic itself is the limit."""
        if not (self.peer and self.rate):
            return None
        return self.promise * statistics.median(self.peer) * self.work / statistics.median(self.rate)

    @property
    def complete(self) -> bool:
        return not self.error and max(len(self.ours), len(self.peer)) >= self.wanted

    @property
    def verdict(self) -> str:
        if self.error:
            return f"not measured: {self.error}"
        if not self.complete:
            return f"too noisy: {max(len(self.ours), len(self.peer))} of {self.wanted} repeats"
        if self.ratio is None:
            return "one side only"
        if self.ratio >= self.promise:
            return f"≥ {self.promise:g}x"
        if self.promise == RATIO and self.share is not None and self.share >= SHARE:
            return f"≥ {SHARE:.0%} of the rate"
        return "missed"


class Calibration:
    """A matrix product in the driver: what the machine gives, whoever else is on it."""

    def __init__(self, limit: float, seconds: float):
        import numpy as np  # here: its threads are set by then

        self._x = np.random.default_rng(0).standard_normal((1024, 1024), dtype=np.float32)
        self._seconds, self._limit = seconds, limit
        self.readings: list[float] = []
        for _ in range(5):
            self.read()

    def read(self) -> float:
        rate = protocol.product_rate(lambda: self._x @ self._x, 2 * 1024**3, self._seconds)
        self.readings.append(rate)
        return rate

    def steady(self, readings: list[float]) -> bool:
        """Neither drift within these readings, nor of all of them from the run's usual rate."""
        usual = statistics.median(self.readings)
        within = max(readings) / min(readings) - 1
        return max(within, abs(statistics.median(readings) / usual - 1)) <= self._limit


class Others:
    """The part of our cores that other processes (or the hypervisor's other guests) used since the last `read`."""

    def __init__(self, pids: list[int]):
        self._pids = [os.getpid(), *pids]
        self._last: tuple[float, float, float] | None = None
        self.read()

    def read(self) -> float | None:
        """None where the system does not say."""
        try:
            now = self._times()
        except (OSError, AttributeError):
            return None
        last, self._last = self._last, now
        if last is None:
            return None
        busy, own, total = (a - b for a, b in zip(now, last))
        return max(0.0, busy - own) / max(total, 1e-9)

    def _times(self) -> tuple[float, float, float]:
        """Clock ticks so far: our cores busy, busy with our processes, and altogether."""
        names = {f"cpu{n}" for n in os.sched_getaffinity(0)}
        busy = total = 0
        for line in Path("/proc/stat").read_text().splitlines():
            if (words := line.split()) and words[0] in names:
                times = [int(word) for word in words[1:9]]  # user nice system idle iowait irq softirq steal
                total += sum(times)
                busy += sum(times) - times[3] - times[4]
        own = 0
        for pid in self._pids:
            # The name before the last bracket may hold blanks; user and system time are the 12th and 13th word after.
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            own += int(words[11]) + int(words[12])
        return busy, own, total


def slice_updates(worker: Worker, seconds: float) -> int:
    """How many updates take at least `seconds`, found with the program warm."""
    count = worker.ask("run", updates=20)["updates"]  # compiles, fills caches
    while True:
        took = worker.ask("run", updates=count)
        if took["seconds"] >= seconds / 6:
            return math.ceil(1.15 * seconds * took["updates"] / took["seconds"])
        count = math.ceil(count * min(8.0, 1.5 * seconds / 6 / max(took["seconds"], 1e-4)))


def measure(
    row: Row, workers: dict[str, Worker], calibration: Calibration, others: Others, arguments: argparse.Namespace
) -> None:
    """Fills `row` with the accepted pairs asked for, or as many as three times that many tries gave."""
    opts, repeats, seconds = row.options, arguments.repeats, arguments.seconds
    row.wanted = repeats
    row.needed, row.peer_counted = flops.needed(opts), flops.peer(opts)
    counts = {}
    for name, worker in workers.items():
        facts = worker.ask("build", options=opts)
        if name == "ours":
            row.program, row.settings = facts["flops"], facts["settings"]
        else:
            row.peer_program = facts["flops"]
        counts[name] = slice_updates(worker, seconds)
    before = calibration.read()
    tries = 0
    while max(len(row.ours), len(row.peer)) < repeats and tries < 3 * repeats:
        tries += 1
        readings, speeds, rate, why = [before], {}, None, ""
        others.read()
        for name, worker in workers.items():
            took = worker.ask("run", updates=counts[name])
            speeds[name] = took["updates"] / took["seconds"]
            if took["seconds"] < seconds:
                counts[name], why = math.ceil(1.15 * seconds * speeds[name]), "slice too short"
            if name == "ours":
                rate = worker.ask("matmul", shapes=[[1024, 1024]], seconds=0.3)["rates"][0]
            readings.append(calibration.read())
        before = readings[-1]
        foreign = others.read()
        if foreign is not None and foreign > arguments.busy:
            why = f"others used {foreign:.0%} of the cores"
        elif not calibration.steady(readings):
            why = "calibration drifted"
        if not why:
            for name, speed in speeds.items():
                getattr(row, name).append(speed)
            if rate is not None:
                row.rate.append(rate)
        else:
            row.rejected += 1
        shown = "  ".join(f"{name} {speed:9.1f}/s" for name, speed in speeds.items())
        note = f"  rejected: {why}" if why else ""
        rates = [round(r / 1e9) for r in readings]
        print(f"  {row.case:14} {shown}  calibration {rates} GFLOP/s{note}", file=sys.stderr, flush=True)


# ---- the report -----------------------------------------------------------------------------------------------------


def spread(values: list[float]) -> str:
    """Median and interquartile range."""
    if not values:
        return "-"
    text = f"{statistics.median(values):,.1f}"
    if len(values) > 1:
        low, _, high = statistics.quantiles(values, n=4, method="inclusive")
        text += f" [{low:,.1f}, {high:,.1f}]"
    return text


def form(value: float | None, pattern: str) -> str:
    return "-" if value is None else pattern.format(value)


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(cells) + " |" for cells in [head, *rows]]
    return [lines[0], "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|", *lines[1:], ""]


def commit() -> str:
    try:
        ask = ["git", "-C", str(HERE), "describe", "--always", "--dirty", "--exclude", "*"]
        return subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def report(rows: list[Row], shapes: dict[str, float], facts: dict[str, Any], calibration: Calibration) -> str:
    arguments = facts["arguments"]
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    lines = [
        "## Beside d3rlpy",
        "",
        f"`{facts['command']}`",
        "",
        f"{facts['date']} · {facts['cpu']}, {arguments.cores} cores used · {platform.system()} {platform.machine()}  ",
        f"{versions} · commit {facts['commit']}",
        "",
        f"Batch {arguments.batch}, networks {arguments.width}x{arguments.width}, observations of 17 and actions of 6 "
        "numbers, a log of 100,000 rows. Updates per second, sampling of the batch included: median [quartiles] of "
        f"{arguments.repeats} slices of at least {arguments.seconds:g} s. The two take turns; a pair in which a "
        f"1024x1024 float32 product drifted by more than {arguments.drift:.0%}, or other processes used more than "
        f"{arguments.busy:.0%} of the cores, was run again.",
        "",
        *table(
            ["agent", "deadreckon", "d3rlpy", "ratio", "share of rate", "share the promise needs", "rejected", "verdict"],
            [
                [
                    row.case,
                    spread(row.ours),
                    spread(row.peer),
                    form(row.ratio, "{:.2f}"),
                    form(row.share, "{:.0%}"),
                    form(row.share_for_ratio, "{:.0%}"),
                    str(row.rejected),
                    row.verdict,
                ]
                for row in rows
            ],
        ),
        "Share of rate: FLOPs of an update x updates per second / FLOP/s of XLA's 1024x1024 float32 product, timed "
        f"beside each slice. `share the promise needs`: the share at which we would be {RATIO} times as fast as d3rlpy "
        f"({FQE_RATIO:g} for FQE of {protocol.POLICIES} policies, where an update is one of each policy's critic, all on one "
        "batch, where d3rlpy samples one for each); "
        "where it nears 100 % the arithmetic is the limit. Beside every BEAR stands d3rlpy's only one, "
        "with a VAE of the same width. d3rlpy's BC is its default, deterministic. "
        "NEMO ({bins} models, {designs} designs, batches of {batch}) stands beside a loop over its models in "
        "PyTorch; ".format_map(protocol.NEMO)
        + f"there we promise {NEMO_RATIO:g} times the speed; `nemo_parts.py` shows which share of the rate its products leave.",
        "",
        "## FLOPs of an update",
        "",
        "Matrix products in millions (`benchmarks/flops.py` has the formulas). *Needed* is what the algorithm needs; "
        "the share counts the smaller of *needed* and *our program*.",
        "",
        *table(
            ["agent", "needed", "our program (jaxpr)", "d3rlpy, by formula", "d3rlpy, by torch's counter"],
            [
                [row.case]
                + [
                    form(value / 1e6 if value else None, "{:,.1f}")
                    for value in (row.needed, row.program, row.peer_counted, row.peer_program)
                ]
                for row in rows
            ],
        ),
    ]
    readings = calibration.readings
    lines += ["## The machine's rate", "", "float32 products in GFLOP/s.", ""]
    products = [[f"XLA, {name}", f"{rate / 1e9:.0f}"] for name, rate in shapes.items()]
    low, usual, high = (f"{f(readings) / 1e9:.0f}" for f in (min, statistics.median, max))
    span = f"{usual} ({low} to {high} in the run)"
    lines += table(["product", "rate"], [*products, ["numpy, 1024 x 1024 x 1024 (the calibration)", span]])
    settings = [f"- {row.case}: {row.settings}" for row in rows if row.settings]
    if settings:
        lines += ["## Settings of ours", "", *settings, ""]
    return "\n".join(lines).rstrip() + "\n"


# ---- command --------------------------------------------------------------------------------------------------------


def at_least(low: float, kind: Callable[[str], Any]) -> Callable[[str], Any]:
    def parse(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
        if not value >= low:
            raise argparse.ArgumentTypeError(f"{text} is below {low:g}")
        return value

    return parse


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--agents", default=",".join(protocol.CASES), help="cases, with commas between (default: all)")
    add("--batch", type=at_least(1, int), default=256)
    add("--width", type=at_least(1, int), default=256, help="of both hidden layers")
    add("--repeats", type=at_least(1, int), default=7, help="accepted pairs of slices a case")
    add("--seconds", type=at_least(0.1, float), default=3.0, help="least length of a slice")
    add("--drift", type=at_least(0, float), default=0.15, help="of the calibration product within a pair")
    add("--busy", type=at_least(0, float), default=0.05, help="part of the cores that others may use in a pair")
    add("--cores", type=at_least(1, int), default=2)
    add("--only", choices=["ours", "peer"], help="time one side alone")
    add("--quick", action="store_true", help="3 repeats of 1 s: to see that it works, not to quote")
    add("--peer-python", type=Path, help="Python with d3rlpy (default: .cache/peer, made if absent)")
    add("--ours", type=Path, default=HERE / "ours.py", help="file that defines make_ours")
    add("--timeout", type=at_least(1, float), default=900.0, help="seconds to wait for a worker")
    add("--out", type=Path, help="markdown report, such as docs/results/speed.md (default: print it)")
    add("--json", type=Path, help="every slice, for later questions")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.repeats, arguments.seconds = 3, 1.0
    return arguments


def environment(cores: int) -> dict[str, str]:
    """Pins this process and so its children, and gives every thread pool as many threads."""
    if hasattr(os, "sched_setaffinity"):
        available = sorted(os.sched_getaffinity(0))
        if len(available) < cores:
            raise BenchError(f"--cores {cores}: only {len(available)} can be used here")
        os.sched_setaffinity(0, available[:cores])
    pools = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    os.environ.update(dict.fromkeys(pools, str(cores)))
    return {**os.environ, "JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": "", "PYTHONWARNINGS": "ignore"}


def compare(arguments: argparse.Namespace) -> int:
    cases = [name.strip() for name in arguments.agents.split(",") if name.strip()]
    rows = [
        Row(case, protocol.options(case, batch=arguments.batch, width=arguments.width, threads=arguments.cores))
        for case in cases
    ]
    for path in (arguments.out, arguments.json):
        if path and not path.parent.is_dir():
            raise BenchError(f"{path}: its folder does not exist")  # now, not after half an hour
    commands = {}
    if arguments.only != "peer":
        commands["ours"] = [sys.executable, str(HERE / "worker_ours.py"), str(arguments.ours)]
    if arguments.only != "ours":
        python = arguments.peer_python or peers.setup(sys.executable)
        if not peers.ready(python):
            raise BenchError(f"{python} has not d3rlpy {peers.D3RLPY} with torch {peers.TORCH}")
        commands["peer"] = [str(python), str(HERE / "peer_d3rlpy.py")]
    variables = environment(arguments.cores)
    workers: dict[str, Worker] = {}
    try:
        for name, command in commands.items():
            workers[name] = Worker(name, command, variables, arguments.timeout)
        versions: dict[str, str] = {}
        for worker in workers.values():
            versions = {**worker.ask("versions")["versions"], **versions}
        # Shapes that occur: a layer on a batch, on all target actions, and the wide VAE's.
        batch, width = arguments.batch, arguments.width
        places = [(1024, 1024), (batch, width), (10 * batch, width), (4 * batch, 750)]
        shapes = {}
        if "ours" in workers:
            rates = workers["ours"].ask("matmul", shapes=places, seconds=0.5)["rates"]
            shapes = {f"{rows_} x {n} x {n}": rate for (rows_, n), rate in zip(places, rates)}
        calibration = Calibration(arguments.drift, 0.2)
        others = Others([worker.pid for worker in workers.values()])
        for row in rows:
            try:
                measure(row, workers, calibration, others, arguments)
            except BenchError as error:
                row.error = str(error)  # the other cases still count
                print(f"  {row.case:14} {error}", file=sys.stderr, flush=True)
    finally:
        for worker in workers.values():
            worker.close()
    facts = {
        "command": shlex.join(["python", "benchmarks/speed.py", *sys.argv[1:]]),
        "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "cpu": cpu_model(),
        "versions": versions,
        "commit": commit(),
        "arguments": arguments,
    }
    text = report(rows, shapes, facts, calibration)
    if arguments.out:
        arguments.out.write_text(text)
        print(f"wrote {arguments.out}")
    else:
        print("\n" + text)
    if arguments.json:
        content = {
            **{key: value for key, value in facts.items() if key != "arguments"},
            "shapes": shapes,
            "calibration": calibration.readings,
            "rows": [{**asdict(row), "ratio": row.ratio, "share": row.share, "verdict": row.verdict} for row in rows],
        }
        arguments.json.write_text(json.dumps(content, indent=1))
    return 0 if all(row.complete and row.verdict != "missed" for row in rows) else 1


def main() -> int:
    return protocol.told(lambda: compare(parse()))


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
