"""What an update costs as work grows: `python benchmarks/growth.py`.

One thing grows at a time: the batch, the width of the networks, seeds as lanes of one program, rows of the log (TD3+BC), and
policies that are judged at once (FQE, a critic each). Everything else stays at batch 256, width 256, one seed and 100,000 rows.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import jax
import protocol

from deadreckon.agents import agent_class
from deadreckon.bench.idle import measuring
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets.mlp import MLP
from deadreckon.ope.case import OPEInput
from deadreckon.ope.fqe import FQE
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.training.fit import Fit

CHUNK = 20  # updates between two looks at the clock
BASE = {"batch": 256, "width": 256, "seeds": 1, "rows": 100_000}
GROWTH = {
    "batch": (64, 256, 1024, 4096), "width": (64, 256, 1024), "seeds": (1, 4, 16),
    "rows": (10_000, 100_000, 1_000_000, 10_000_000), "policies": (1, 10, 100),
}  # fmt: skip
WORDS = {"batch": "rows a batch", "width": "width of both layers", "seeds": "seeds", "rows": "rows of the log",
         "policies": "policies evaluated at once (FQE)"}  # fmt: skip


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--what", nargs="+", choices=list(GROWTH), default=list(GROWTH))
    add("--seconds", type=float, default=3.0, help="that each is timed, three times")
    add("--most-rows", type=int, default=10_000_000)
    return parser.parse_args()


def agent(batch: int, width: int, seeds: int, rows: int) -> Callable[[], int]:
    """Makes a chunk of updates, and says how many updates of a seed that was."""
    made = agent_class("td3_bc")(hidden=(width,) * 2, batch_size=batch)
    options = protocol.options("td3_bc", batch=batch, width=width, threads=1, rows=rows)
    log = Dataset.from_arrays(**protocol.synthetic_log(options))
    made = made.resolve(log.spec, 10**9)
    rows = TransitionSource(log, made.needs(log.spec))
    return _walk(Fit([made] * seeds, rows, list(range(seeds)), 10**9, chunk=CHUNK), seeds)


def judged(policies: int) -> Callable[[], int]:
    """The same of FQE, counted in updates of one policy's critic."""
    options = protocol.options("fqe-11", batch=BASE["batch"], width=BASE["width"], threads=1, rows=20_000)
    log, view = Dataset.from_arrays(**protocol.synthetic_log(options)), Normalizer.of
    shape = (options["observation"], (BASE["width"],) * 2, 2 * options["action"])
    nets = [MLP.create(*shape, jax.random.key(i)) for i in range(policies)]
    estimator = FQE(members=1, hidden=(BASE["width"],) * 2, batch_size=BASE["batch"])
    learner, rows = estimator.problem(OPEInput(log, [EnvPolicy.of(TanhGaussian(net), view(log.spec)) for net in nets]))
    return _walk(Fit([learner], rows, [0], 10**9, chunk=CHUNK), policies)


def _walk(fit: Fit, counted: int) -> Callable[[], int]:
    walk = fit.chunks()

    def chunk() -> int:
        jax.block_until_ready(next(walk).states)
        return CHUNK * counted

    return chunk


def rate(chunk: Callable[[], int], seconds: float) -> float:
    """Updates a second: the median of three slices, the first chunk (compiling) aside."""
    chunk()
    rates = []
    for _ in range(3):
        done, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            done += chunk()
        rates.append(done / (time.perf_counter() - start))
    return statistics.median(rates)


def report() -> int:
    arguments = parse()
    cache_compiled_programs()
    for what in arguments.what:
        print(f"\n| {WORDS[what]} | updates a second | an update takes |\n|---:|---:|---:|", flush=True)
        first = None
        for size in GROWTH[what]:
            if what == "rows" and size > arguments.most_rows:
                continue
            found = rate(judged(size) if what == "policies" else agent(**BASE | {what: size}), arguments.seconds)
            first = first or found
            print(f"| {size:,} | {found:,.1f} | {first / found:.2f} times the first |", flush=True)
    return 0


if __name__ == "__main__":
    with measuring():
        raise SystemExit(protocol.told(report))
