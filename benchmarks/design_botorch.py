"""Our `gp` beside BoTorch, on the tables of design.py; BoTorch lives in an environment of its own.

    python3 -m venv .cache/botorch && .cache/botorch/bin/pip install torch botorch
    python -m benchmarks.design_botorch --peer-python .cache/botorch/bin/python --seeds 10 --out .cache/botorch.jsonl
    python -m benchmarks.design_botorch --peer-python .cache/botorch/bin/python --speed

Each proposes 16 designs from the table alone; what BoTorch proposes is made different and kept within all rules by `mbo.batch`,
as ours is, with linear constraints of numbers known to its optimiser too. Printed are best / median true scores, means over
seeds, the seconds of a table, and by how much `auto` is above each rival, paired by seed, with Student's 95 % interval. With
`--out` every seed of a table is a line of a file as soon as it is done, and what the file has is not run again. `--speed`: 128
proposals on 1,000 rows of 20 variables; BoTorch's greedy batch is measured for 4 proposals, and the posterior mean's for all.
"""

import argparse
import contextlib
import json
import subprocess
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.design import COUNT, scikit_learn
from deadreckon.mbo import designer
from deadreckon.mbo.batch import batch
from deadreckon.mbo.designs import Designs
from deadreckon.stats.comparison import paired
from tests.mbo.practice import TABLES, wide

HERE = Path(__file__).resolve().parent


class Peer:
    """BoTorch in a process of its own; one JSON line a request."""

    def __init__(self, python: str):
        command = [python, str(HERE / "peer_botorch.py")]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, **asked: Any) -> dict[str, Any]:
        """The answer to a request.

        Raises:
            RuntimeError: it failed.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(asked) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        if not answer["ok"]:
            raise RuntimeError(answer["error"])
        return answer


class Cube:
    """Designs as numbers in [0, 1], of categories as indices, and back."""

    def __init__(self, data: Designs):
        self.data = data
        seen = np.array(data.x, np.float64)
        self.logs = [i for i, v in enumerate(data.variables) if v.log]
        self.levels = {i: len(v.levels) for i, v in enumerate(data.variables) if v.kind == "categorical"}
        ends = np.array([(v.low, v.high) for v in data.variables], np.float64)
        ends[:, 0] = np.where(np.isfinite(ends[:, 0]), ends[:, 0], seen.min(0))
        ends[:, 1] = np.where(np.isfinite(ends[:, 1]), ends[:, 1], seen.max(0))
        ends[self.logs] = np.log(ends[self.logs])
        self.low, self.span = ends[:, 0], np.maximum(np.ptp(ends, axis=1), 1e-12)
        for i in self.levels:
            self.low[i], self.span[i] = 0.0, 1.0

    def encode(self, x: np.ndarray) -> np.ndarray:
        """(rows, variables) of the same shape."""
        x = np.array(x, np.float64)
        x[:, self.logs] = np.log(x[:, self.logs])
        return (x - self.low) / self.span

    def decode(self, z: np.ndarray) -> np.ndarray:
        """(rows, variables) designs, whole numbers rounded; rules are seen to by `batch`."""
        x = z * self.span + self.low
        x[:, self.logs] = np.exp(x[:, self.logs])
        for i, v in enumerate(self.data.variables):
            if v.kind != "continuous":
                x[:, i] = np.round(x[:, i])
            if v.kind != "categorical":
                x[:, i] = x[:, i].clip(v.low, v.high)
        return x.astype(np.float32)

    def planes(self) -> tuple[list[Any], list[Any]]:
        """Constraints of numbers, as at least a bound and as equal to one, in these coordinates."""
        least: list[Any] = []
        equal: list[Any] = []
        for each in self.data.rules.linear:
            at = [column for column, _ in each.weights]
            if any(self.data.variables[i].leveled or i in self.logs for i in at):
                continue
            weight = np.array([float(w) for _, w in each.weights])
            bound = float(each.bound) - float(weight @ self.low[at])
            scaled = (weight * self.span[at]).tolist()
            if each.equal:
                equal.append([at, scaled, bound])
            else:
                least.append([at, [-w for w in scaled], -bound])
        return least, equal


def botorch(peer: Peer, data: Designs, n: int, seed: int, acquisition: str, threads: int = 1) -> dict[str, Any]:
    """What BoTorch answers, its designs decoded."""
    cube = Cube(data)
    least, equal = cube.planes()
    known = data.std_error is not None and bool((data.std_error > 0).all())
    fixed = {column: (value - cube.low[column]) / cube.span[column] for column, value in data.rules.fixed}
    answer = peer.ask(
        op="propose", x=cube.encode(data.x).tolist(), y=data.y.tolist(), n=n, seed=seed, threads=threads,
        noise=np.square(data.std_error).tolist() if known and data.std_error is not None else None, levels=cube.levels,
        fixed=fixed, at_least=least, equal=equal, acquisition=acquisition,
    )  # fmt: skip
    return answer | {"x": cube.decode(np.array(answer["x"]))}


def speed(peer: Peer) -> None:
    """Seconds of a fit and of proposals, each alone on one core."""
    data = wide(1000, variables=20).designs()
    begun = time.perf_counter()
    begun_own = time.process_time()
    designer("gp", folds=0).propose(data, 128)
    own, wall = time.process_time() - begun_own, time.perf_counter() - begun
    print(f"gp: fit and 128 proposals {wall:.1f} s ({own:.1f} s of processor time)", flush=True)
    for acquisition, n in (("mean", 128), ("noisy-ei", 4)):
        found = botorch(peer, data, n, 0, acquisition)
        print(f"BoTorch, {acquisition}: fit {found['fit']:.1f} s, {n} proposals {found['search']:.1f} s", flush=True)


RIVALS = "BoTorch, noisy EI", "BoTorch, mean", "scikit-learn"


def scores_of(peer: Peer, name: str, seed: int) -> list[float]:
    """Best and median true score of `auto` and of each of `RIVALS`, and the seconds of all but scikit-learn."""
    table = TABLES[name](seed=seed)
    data, begun = table.designs(), time.perf_counter()
    made, took = [designer("auto").propose(data, COUNT, seed=seed).x], [time.perf_counter() - begun]
    for acquisition in ("noisy-ei", "mean"):
        begun = time.perf_counter()
        found = botorch(peer, data, COUNT, seed, acquisition)["x"]
        made.append(batch(data, found, COUNT, seed=seed))
        took.append(time.perf_counter() - begun)
    true = [table.true(data, x) for x in [*made, scikit_learn(data, seed)]]
    return [float(value) for y in true for value in (y.max(), np.median(y))] + took


def kept(path: Path | None, made_by: dict[str, Any]) -> dict[tuple[str, int], list[float]]:
    """What a file has of tables and seeds, made by the same code; a last line that was cut off counts for nothing."""
    found = {}
    for line in path.read_text().splitlines() if path and path.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            each = json.loads(line)
            if each["made_by"] == made_by:
                found[each["table"], each["seed"]] = each["row"]
    return found


def main() -> None:
    """Prints a row a table, and then the differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer-python", required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--tables", nargs="+", default=list(TABLES))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--speed", action="store_true")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    peer = Peer(asked.peer_python)
    versions = peer.ask(op="versions")["versions"]
    print(versions, flush=True)
    if asked.speed:
        speed(peer)
        return
    print(f"| table | auto | {' | '.join(RIVALS)} | seconds: auto, BoTorch's two |\n" + "|---" * 6 + "|")
    gains = [f"| table | {' | '.join(f'{rival}: best | median' for rival in RIVALS)} |", "|---" * 7 + "|"]
    made_by = {"count": COUNT, "auto": type(designer("auto")).revision, "peer": versions}
    done = kept(asked.out, made_by)
    for name in asked.tables:
        for seed in range(asked.seeds):
            if (name, seed) in done:
                continue
            done[name, seed] = scores_of(peer, name, seed)
            if asked.out:
                with asked.out.open("a") as file:
                    line = {"table": name, "seed": seed, "made_by": made_by, "row": done[name, seed]}
                    file.write(json.dumps(line) + "\n")
        all_rows = np.array([done[name, seed] for seed in range(asked.seeds)])
        a = all_rows.mean(0)
        cells = [f"{a[i]:.2f} / {a[i + 1]:.2f}" for i in (0, 2, 4, 6)]
        print(f"| {name} | {' | '.join(cells)} | {', '.join(f'{s:.1f}' for s in a[8:])} |", flush=True)
        told = [f"{paired({name: all_rows[:, i % 2]}, {name: all_rows[:, i]}):.2f}" for i in range(2, 8)]
        gains.append(f"| {name} | {' | '.join(told)} |")
    print("\nAbove each rival:\n\n" + "\n".join(gains))


if __name__ == "__main__":
    main()
