"""The arithmetic of 1,000 environment steps of MBPO on Hopper, beside a loop in PyTorch: fitting, rollouts and updates apart.

    python benchmarks/mbpo.py            # two cores, five repeats, three minutes

Both do the same arithmetic on the same numbers of rows: an epoch of seven networks of 4 x 200 on 16,000 rows in batches of
256, and their errors on 4,000; 100,000 steps of the policy in the model, each by one of five networks; an update of SAC with
2 x 256 units on 256 rows. Per 1,000 environment steps there are 4 fits of 10 epochs (`EPOCHS`; how many it takes depends on the
data), 4 times 100,000 made-up steps, and 20,000 updates. Neither the simulator, nor acting, nor the shuffling of rows into the
buffer is counted, on either side. The two processes take turns.
"""

import argparse
import dataclasses
import os
import statistics
import sys
from pathlib import Path
from typing import Any

import flops
import peers
import protocol

from deadreckon.bench.idle import measuring

ROWS, HELD, MADE_UP, OBSERVATION, ACTION = 20_000, 4_000, 100_000, 11, 3
EPOCHS, FITS, UPDATES, SLICE = 10, 4, 20_000, 500
PARTS = {"fit": FITS * EPOCHS, "rollout": FITS, "update": UPDATES}  # units of each in 1,000 environment steps
UNITS = {"fit": "an epoch", "rollout": "100,000 steps", "update": "an update"}
RATIO, SHARE = 3.0, 0.6  # what we promise of each part: this many times PyTorch, or this share of the machine's rate
MEMBERS, BATCH = 7, 256


def products(part: str) -> float:
    """Operations of the matrix products that a unit of a part needs."""
    model = [OBSERVATION + ACTION, 200, 200, 200, 200, 2 * (OBSERVATION + 1)]  # means and deviations of the change and reward
    if part == "fit":
        return MEMBERS * (flops.train(ROWS - HELD, model) + flops.forward(HELD, model))
    if part == "rollout":
        return flops.forward(MADE_UP, [OBSERVATION, 256, 256, 2 * ACTION]) + flops.forward(MADE_UP, model)
    sizes = {"case": "sac", "batch": BATCH, "width": 256, "threads": 1}
    return flops.needed(protocol.options(**sizes) | {"observation": OBSERVATION, "action": ACTION})


def rows(seed: int = 0) -> dict[str, Any]:
    """Transitions of a smooth made-up system; only their shapes matter for speed."""
    import numpy as np

    rng = np.random.default_rng(seed)
    seen, action = rng.standard_normal((ROWS, OBSERVATION)), rng.uniform(-1, 1, (ROWS, ACTION))
    moved = seen + 0.1 * np.tanh(seen) + 0.1 * action @ rng.standard_normal((ACTION, OBSERVATION))
    columns = {"observation": seen, "action": action, "reward": seen[:, 0], "next_observation": moved}
    columns["terminal"] = np.zeros(ROWS)
    return {name: column.astype(np.float32) for name, column in columns.items()}


def ours() -> dict[str, Any]:
    """What a unit of each part is, by this package."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from deadreckon.agents import MBPO
    from deadreckon.data.batch import TransitionSource
    from deadreckon.data.dataset import Dataset
    from deadreckon.data.spec import Box, Spec
    from deadreckon.dynamics import branches, packed
    from deadreckon.training.fit import Fit

    space = Box([-1.0] * ACTION, [1.0] * ACTION)
    spec = Spec.empty((OBSERVATION,), space, "hopper")
    agent = MBPO(termination="learned").resolve(spec, 1)
    columns = rows()
    # All epochs are done: patience never ends.
    trainer = dataclasses.replace(agent.trainer, patience=10**6, most_epochs=EPOCHS)
    held: dict[str, Any] = {}
    never = lambda seen: jnp.zeros(len(seen), bool)  # noqa: E731

    def fit() -> int:
        held["model"], _ = trainer.fit(agent.model, spec, columns, 0, held.get("model"))
        return EPOCHS

    def rollout() -> int:
        starts = jnp.asarray(columns["observation"][np.random.default_rng(0).integers(ROWS, size=MADE_UP)])
        found = packed(branches(agent.model, held["model"], agent.policy(held["state"]), starts, 1, jax.random.key(0), never))
        assert found.shape == (MADE_UP, 2 * OBSERVATION + ACTION + 2)
        return 1

    log = Dataset.from_arrays(
        observations=columns["observation"], actions=columns["action"], rewards=columns["reward"],
        terminals=columns["terminal"] > 0, final_observations=columns["next_observation"][-1:],
        timeouts=np.arange(ROWS) == ROWS - 1, action_space=space, name="noise",
    )  # fmt: skip
    walk = Fit([agent], TransitionSource(log, agent.needs(log.spec)), [0], 10**9, chunk=SLICE).chunks()
    held["state"] = agent.init(spec, jax.random.key(0))

    def update() -> int:
        jax.block_until_ready(next(walk).states)
        return SLICE

    return {"fit": fit, "rollout": rollout, "update": update}


def serve(parts: dict[str, Any], **more: Any) -> None:
    """Answers how many seconds a unit takes, and what `more` answers."""
    import time

    def timed(request: dict[str, Any]) -> dict[str, Any]:
        start = time.perf_counter()
        made = parts[request["part"]]()
        return {"seconds": (time.perf_counter() - start) / made}

    protocol.serve({"time": timed, **more})


def report(arguments: argparse.Namespace) -> int:
    """Measures by turns, and prints."""
    peer = arguments.peer_python or peers.setup(sys.executable)
    here, threads = Path(__file__), str(arguments.threads)
    # XLA takes all cores that it may use, whatever OMP_NUM_THREADS says.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: arguments.threads])
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "OMP_NUM_THREADS": threads}
    workers = {
        "deadreckon": protocol.Worker("deadreckon", [sys.executable, str(here), "--serve"], environment, 600),
        "pytorch": protocol.Worker("pytorch", [str(peer), str(here.with_name("peer_mbpo.py")), threads], environment, 600),
    }
    found: dict[str, dict[str, list[float]]] = {part: {name: [] for name in workers} for part in PARTS}
    rates: dict[str, list[float]] = {part: [] for part in PARTS}
    try:
        for i in range(arguments.repeats + 1):
            for part, times in found.items():
                for name, worker in workers.items():
                    seconds = worker.ask("time", part=part)["seconds"]
                    if i:  # the first compiles, or warms up
                        times[name].append(seconds)
                    if i and name == "deadreckon":
                        rates[part] += worker.ask("matmul", shapes=[[1024, 1024]], seconds=0.3)["rates"]
    finally:
        for worker in workers.values():
            worker.close()
    total: dict[str, list[float]] = {name: [0.0] * arguments.repeats for name in workers}
    kept = True
    print("| part | deadreckon | PyTorch | ratio | share of the rate | deadreckon, in 1,000 environment steps |")
    print("|---|---:|---:|---:|---:|---:|")
    for part, times in found.items():
        own, other = (1e3 * statistics.median(times[name]) for name in workers)
        ratio = statistics.median(b / a for a, b in zip(*times.values()))
        share = statistics.median(products(part) / (t * r) for t, r in zip(times["deadreckon"], rates[part]))
        kept &= ratio >= RATIO or (share >= SHARE and ratio >= 1)
        shown = f"{part}: {UNITS[part]} | {own:,.2f} ms | {other:,.2f} ms | {ratio:.2f} | {share:.0%}"
        print(f"| {shown} | {own * PARTS[part] / 1e3:,.1f} s |")
        for name in workers:
            total[name] = [t + PARTS[part] * s for t, s in zip(total[name], times[name])]
    ratios = sorted(b / a for a, b in zip(*total.values()))
    own, other = (statistics.median(seconds) for seconds in total.values())
    ratio = statistics.median(ratios)
    print(f"| all | {own:,.1f} s | {other:,.1f} s | {ratio:.2f} [{ratios[0]:.2f}, {ratios[-1]:.2f}] | | {own:,.1f} s |")
    rate = statistics.median(r for part in rates.values() for r in part)
    print(f"\nrate: XLA's 1024x1024x1024 product, {rate / 1e9:.0f} GFLOP/s")
    return 0 if kept else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peer-python", type=Path, help="Python with torch (default: .cache/peer, made if absent)")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--serve", action="store_true", help="what the driver starts")
    arguments = parser.parse_args()
    if arguments.serve:
        import worker_ours

        serve(ours(), matmul=worker_ours.matmul)
        return 0
    return protocol.told(lambda: report(arguments))


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
