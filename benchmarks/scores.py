"""What d3rlpy learns from our logs, judged by us: `python benchmarks/scores.py --ours runs/agents`.

d3rlpy's TD3+BC, IQL, CQL and BEAR learn from the same rows, for as many updates, with networks as wide as in
`examples/agents_table.py`, and are judged in the same simulator in as many episodes; ours are that example's runs. What a seed
is done with is kept in OUT and not done again. The table is printed as Markdown.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import peers
import protocol
from protocol import BenchError, Worker

import deadreckon as dr
from deadreckon.files import read_json, write_json
from deadreckon.stats.crossed import mean_interval
from deadreckon.tasks.registry import of_log

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "examples"))
import gym_tables  # noqa: E402 - the rows that the example learns from, and how it shows scores

ALGORITHMS = {"td3_bc": "TD3+BC", "iql": "IQL", "cql": "CQL", "bear": "BEAR"}  # and their names in the example's runs
WIDTH = {"maze2d": 64}  # of the networks there; 256 elsewhere


class Remote:
    """What the worker learned, as a policy for `dr.evaluate`."""

    has_log_prob = False

    def __init__(self, worker: Worker):
        self._worker = worker

    def start(self, n: int) -> None:
        return None

    def act(self, step: Any, carry: None, key: Any, *, greedy: bool = False) -> tuple[np.ndarray, None]:
        return np.asarray(self._worker.ask("act", observation=np.asarray(step.observation).tolist())["action"]), None


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--logs", nargs="+", default=["maze2d-umaze-v1", "hopper-medium-v2"], help="of the catalogue")
    add("--log-steps", type=int, default=200_000, help="rows of the logs")
    add("--only", nargs="+", choices=ALGORITHMS, default=list(ALGORITHMS))
    add("--steps", type=int, default=10_000, help="updates")
    add("--seeds", type=int, default=3)
    add("--episodes", type=int, default=20, help="a seed")
    add("--threads", type=int, default=2, help="of torch")
    add("--peer-python", type=Path, help="Python with d3rlpy (default: .cache/peer, made if absent)")
    add("--timeout", type=float, default=7200.0, help="seconds to wait for a seed")
    add("--ours", type=Path, default=Path("runs/agents"), help="runs of examples/agents_table.py")
    add("--out", type=Path, default=Path("runs/scores"), help="what is measured is OUT/LOG/ALGORITHM-SEED.json")
    return parser.parse_args()


def measure(name: str, log: dr.Dataset, worker: Worker, arguments: argparse.Namespace) -> None:
    """Trains and judges what is not measured yet."""
    task, width = of_log(log.name), WIDTH.get(name.partition("-")[0], 256)
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "log.npz"
        columns = {key: getattr(log, key) for key in ("observations", "actions", "rewards")}
        ends = {key: np.asarray(getattr(log, key), np.float32) for key in ("terminals", "timeouts")}
        np.savez(rows, **{key: np.asarray(column, np.float32) for key, column in columns.items()}, **ends)
        for algo in arguments.only:
            for seed in range(arguments.seeds):
                path = file_of(arguments, name, algo, seed)
                if path.exists():
                    continue
                worker.ask(
                    "learn", log=str(rows), algo=algo, seed=seed, updates=arguments.steps, width=width,
                    threads=arguments.threads,
                )  # fmt: skip
                found = dr.evaluate(Remote(worker), task, episodes=arguments.episodes)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_json(path, {"steps": arguments.steps, "scores": found.scores[0].tolist()})
                print(f"{name} {algo} seed {seed}: {found.score(0)}", file=sys.stderr, flush=True)


def file_of(arguments: argparse.Namespace, name: str, algo: str, seed: int) -> Path:
    return arguments.out / name / f"{algo}-{arguments.steps}-{seed}.json"


def table(arguments: argparse.Namespace) -> str:
    """Scores with 95 % intervals over seeds and episodes."""
    lines = ["| log | | " + " | ".join(ALGORITHMS[algo] for algo in arguments.only) + " |"]
    lines.append("|---|---|" + "---:|" * len(arguments.only))
    for name in arguments.logs:
        ours, theirs = [], []
        for algo in arguments.only:
            files = [file_of(arguments, name, algo, seed) for seed in range(arguments.seeds)]
            theirs.append(str(mean_interval(np.array([read_json(file)["scores"] for file in files]))))
            try:
                run = dr.load_run(arguments.ours / name / ALGORITHMS[algo])
            except dr.UserError as error:
                raise BenchError(f"--ours: {error}") from None
            steps = np.asarray(run.evaluations["step"])
            if steps.max() != arguments.steps:
                raise BenchError(f"{run.path} has {steps.max():,} updates, d3rlpy {arguments.steps:,}")
            ours.append(gym_tables.last_score(run))
        lines += [f"| {name} | deadreckon | " + " | ".join(ours) + " |", "| | d3rlpy | " + " | ".join(theirs) + " |"]
    return "\n".join(lines)


def compare(arguments: argparse.Namespace) -> int:
    python = arguments.peer_python or peers.setup(sys.executable)
    if not peers.ready(python):
        raise BenchError(f"{python} has not d3rlpy {peers.D3RLPY} with torch {peers.TORCH}")
    command = [str(python), str(HERE / "peer_scores.py")]
    worker = Worker("peer", command, {**os.environ, "PYTHONWARNINGS": "ignore"}, arguments.timeout)
    try:
        for name in arguments.logs:
            measure(name, gym_tables.log_of(name, arguments.log_steps), worker, arguments)
    finally:
        worker.close()
    print(table(arguments))
    return 0


if __name__ == "__main__":
    sys.exit(protocol.told(lambda: compare(parse())))
