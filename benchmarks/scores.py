"""What d3rlpy learns from our logs, judged by us: `python benchmarks/scores.py`.

d3rlpy's TD3+BC, IQL, CQL and BEAR learn from the same rows, for as many updates, with networks as wide as in the suites
`evidence/agents-maze2d.toml` and `evidence/agents-hopper.toml`, and are judged in the same simulator in as many episodes; ours
are the results of these suites. What a seed is done with is kept in OUT and not done again. The table is printed as Markdown.
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
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import Suite, read
from deadreckon.collect import collect
from deadreckon.files import read_json, write_json
from deadreckon.stats.crossed import mean_interval
from deadreckon.tasks.registry import of_log

HERE = Path(__file__).resolve().parent
SUITES = [HERE.parent / "evidence" / f"agents-{name}.toml" for name in ("maze2d", "hopper")]
ALGORITHMS = {"td3_bc": "TD3+BC", "iql": "IQL", "cql": "CQL", "bear": "BEAR"}  # and their names in the suites
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
    add("--suites", nargs="+", type=Path, default=SUITES, help="what ours learned, from which rows and for how long")
    add("--only", nargs="+", choices=ALGORITHMS, default=list(ALGORITHMS))
    add("--threads", type=int, default=2, help="of torch")
    add("--peer-python", type=Path, help="Python with d3rlpy (default: .cache/peer, made if absent)")
    add("--timeout", type=float, default=7200.0, help="seconds to wait for a seed")
    add("--out", type=Path, default=Path("runs/scores"), help="what is measured is OUT/LOG/ALGORITHM-SEED.json")
    return parser.parse_args()


def measure(suite: Suite, name: str, worker: Worker, arguments: argparse.Namespace) -> None:
    """Trains and judges what is not measured yet."""
    log = dr.read(collect(name, steps=suite.rows))
    task, width = of_log(name), WIDTH.get(name.partition("-")[0], 256)
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "log.npz"
        columns = {key: getattr(log, key) for key in ("observations", "actions", "rewards")}
        ends = {key: np.asarray(getattr(log, key), np.float32) for key in ("terminals", "timeouts")}
        np.savez(rows, **{key: np.asarray(column, np.float32) for key, column in columns.items()}, **ends)
        for algo in arguments.only:
            for seed in range(suite.seeds):
                path = file_of(arguments, suite, name, algo, seed)
                if path.exists():
                    continue
                worker.ask(
                    "learn", log=str(rows), algo=algo, seed=seed, updates=suite.steps[name], width=width,
                    threads=arguments.threads,
                )  # fmt: skip
                found = dr.evaluate(Remote(worker), task, episodes=suite.episodes)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_json(path, {"steps": suite.steps[name], "scores": found.scores[0].tolist()})
                print(f"{name} {algo} seed {seed}: {found.score(0)}", file=sys.stderr, flush=True)


def file_of(arguments: argparse.Namespace, suite: Suite, name: str, algo: str, seed: int) -> Path:
    return arguments.out / name / f"{algo}-{suite.steps[name]}-{seed}.json"


def ours(suite: Suite, name: str, algo: str) -> str:
    """Our score of the last evaluation."""
    jobs = [job for job in plan(suite) if (job.on, job.method) == (name, ALGORITHMS[algo])]
    scores = [row["episodes"] for row in store_of([suite], Path()).of(jobs).to_pylist()]
    if len(scores) < suite.seeds:
        raise BenchError(f"{suite.name} has {len(scores)} of {suite.seeds} seeds of {ALGORITHMS[algo]} on {name}; run it first")
    return str(mean_interval(np.array(scores)))


def table(suites: list[Suite], arguments: argparse.Namespace) -> str:
    """Scores with 95 % intervals over seeds and episodes."""
    lines = ["| log | | " + " | ".join(ALGORITHMS[algo] for algo in arguments.only) + " |"]
    lines.append("|---|---|" + "---:|" * len(arguments.only))
    for suite in suites:
        for name in suite.on:
            theirs = []
            for algo in arguments.only:
                files = [file_of(arguments, suite, name, algo, seed) for seed in range(suite.seeds)]
                theirs.append(str(mean_interval(np.array([read_json(file)["scores"] for file in files]))))
            lines.append(f"| {name} | deadreckon | " + " | ".join(ours(suite, name, algo) for algo in arguments.only) + " |")
            lines.append("| | d3rlpy | " + " | ".join(theirs) + " |")
    return "\n".join(lines)


def compare(arguments: argparse.Namespace) -> int:
    python = arguments.peer_python or peers.setup(sys.executable)
    if not peers.ready(python):
        raise BenchError(f"{python} has not d3rlpy {peers.D3RLPY} with torch {peers.TORCH}")
    suites = [read(path) for path in arguments.suites]
    command = [str(python), str(HERE / "peer_scores.py")]
    worker = Worker("peer", command, {**os.environ, "PYTHONWARNINGS": "ignore"}, arguments.timeout)
    try:
        for suite in suites:
            for name in suite.on:
                measure(suite, name, worker, arguments)
    finally:
        worker.close()
    print(table(suites, arguments))
    return 0


if __name__ == "__main__":
    sys.exit(protocol.told(lambda: compare(parse())))
