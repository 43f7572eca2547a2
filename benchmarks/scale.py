"""Logs of extreme shapes through `data info`, `train` and `ope`: seconds and peaks of memory, or the one line of a refusal.

    python benchmarks/scale.py                       # all logs
    python benchmarks/scale.py --only steps actions  # some of them

Each command is a process of its own, whose `RssAnon` is read 50 times a second (see `larger.py`). A command fails here if it
ends with a traceback, with a message of several lines, or by a signal; a refusal in one line is an outcome, and is printed.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import protocol
import pyarrow as pa
from larger import Ended, ended
from pyarrow import parquet

from deadreckon.bench.idle import measuring

GROUP = 250_000  # rows of a row group at most
Columns = dict[str, np.ndarray]
FLAGS = ("--action", "a", "--reward", "r", "--episode", "episode", "--time", "t", "--terminal", "done")
CHOICES, VECTORS = "bc", "td3_bc"  # agents of discrete and of continuous actions


def _rows(rows: int, episode: int, sizes: int, action: str, scale: float = 1.0, constant: bool = False) -> Iterator[Columns]:
    """Pieces of a log: random observations, actions and rewards, in episodes of one length that end in a terminal state."""
    rng = np.random.default_rng(0)
    group = max(1, min(GROUP, 20_000_000 // sizes))
    for start in range(0, rows, group):
        row = np.arange(start, min(start + group, rows))
        draw = (lambda: np.ones(len(row), np.float32)) if constant else lambda: rng.standard_normal(len(row), np.float32)  # noqa: B023
        columns = {"episode": row // episode, "t": row % episode} | {f"x{i}": draw() for i in range(sizes)}
        if action == "vector":
            columns |= {"a_0": np.tanh(draw()), "a_1": np.tanh(draw())}
        else:
            columns["a"] = rng.integers(0, int(action), len(row))
        yield columns | {"r": draw() * np.float64(scale), "done": row % episode == episode - 1}


CASES: dict[str, tuple[str, str, Callable[[], Iterator[Columns]]]] = {
    "bandit": ("1,000,000 episodes of one step", CHOICES, lambda: _rows(1_000_000, 1, 5, "5")),
    "steps": ("one episode of 5,000,000 steps", VECTORS, lambda: _rows(5_000_000, 5_000_000, 5, "vector")),
    "actions": ("2,000 actions, 200,000 rows", CHOICES, lambda: _rows(200_000, 100, 5, "2000")),
    "columns": ("5,000 observation columns, 20,000 rows", VECTORS, lambda: _rows(20_000, 100, 5_000, "vector")),
    "rewards": ("rewards of 1e30, 100,000 rows", VECTORS, lambda: _rows(100_000, 100, 5, "vector", 1e30)),
    "constant": ("every column constant, 100,000 rows", VECTORS, lambda: _rows(100_000, 100, 5, "vector", constant=True)),
    "rows": ("10,000,000 rows", VECTORS, lambda: _rows(10_000_000, 1_000, 12, "vector")),
}


def write(path: Path, pieces: Iterator[Columns]) -> None:
    """A Parquet table of the pieces, a row group each."""
    first = pa.table(next(pieces))
    with parquet.ParquetWriter(path, first.schema) as writer:
        writer.write_table(first)
        for piece in pieces:
            writer.write_table(pa.table(piece))


def outcome(done: Ended) -> str:
    """`done`, or what a refusal says.

    Raises:
        BenchError: neither: a traceback, several lines, or a signal.
    """
    if done.code == 0:
        warned = [line.split("warning: ", 1)[1] for line in done.told.splitlines() if "warning: " in line]
        return "done" + "".join(f"; warning: {line}" for line in warned)
    lines = [line for line in done.told.splitlines() if line.startswith("deadreckon: ") and "warning: " not in line]
    lines = lines or [
        line for line in done.output.splitlines() if line.startswith("seed 0 failed: ")
    ]  # its run folder is whole
    if done.code < 0 or "Traceback" in done.told or len(lines) != 1:
        raise protocol.BenchError(f"{' '.join(done.command)} ended with code {done.code}: {done.told[-3000:]}")
    return lines[0].removeprefix("deadreckon: ")


def case(name: str, folder: Path, steps: int) -> bool:
    """Prints the rows of a log; False where a command failed."""
    about, agent, pieces = CASES[name]
    table, run = folder / "log.parquet", folder / "run"
    write(table, pieces())
    size = table.stat().st_size / 1e9
    judged = ("--estimators", "fqe", "--steps", "1000")
    commands = {
        "data info": ("data", "info", table, *FLAGS),
        f"train ({agent}, {steps:,} updates)": (
            "train", "--agent", agent, "--data", table, *FLAGS, "--steps", str(steps), "--out", run,
        ),
        "ope (FQE, 1,000 updates)": ("ope", "--policies", run, "--data", table, *FLAGS, *judged),
    }  # fmt: skip
    kept = True
    for what, command in commands.items():
        done = ended(*command)
        try:
            told = outcome(done)
        except protocol.BenchError as error:
            kept, told = False, f"FAILED: {str(error)[-1500:]}"
        told = told.replace(str(folder), "...").replace("|", r"\|").replace("\n", " ")
        print(f"| {about} ({size:.2f} GB) | {what} | {done.seconds:.0f} | {done.peak:.2f} | {told} |", flush=True)
        if not (run / "run.json").exists() and what != "data info":
            break  # there is no policy to judge
    return kept


def main() -> int:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--only", nargs="*", choices=CASES, default=list(CASES), help="logs; default all")
    add("--steps", type=int, default=500, help="updates of `train`")
    given = parser.parse_args()
    print("| log (as Parquet) | command | seconds | peak of RssAnon, GB | outcome |\n| --- | --- | ---: | ---: | --- |")
    kept = True
    with measuring():
        for name in given.only:
            with tempfile.TemporaryDirectory(prefix="scale-") as folder:
                kept &= case(name, Path(folder), given.steps)
    return not kept


if __name__ == "__main__":
    raise SystemExit(protocol.told(main))
