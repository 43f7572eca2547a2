"""A Parquet table larger than memory: converted, described and trained on, with peaks of anonymous memory and rates.

    python benchmarks/larger.py [--rows 100000000]
    python benchmarks/larger.py --rows 10000000 --pandas    # reading the table with pandas, and nothing else

Each command is a process of its own, whose `RssAnon` is read 50 times a second. Updates per second are those that
`train` tells at its end, which leave out start-up and compilation; runs on the folder and on a log in memory take turns.
"""

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from deadreckon.bench.idle import measuring

MAIN = "import sys; from deadreckon.cli.main import main; sys.exit(main(sys.argv[1:]))"
PANDAS = "import sys, pandas; pandas.read_parquet(sys.argv[1])"
GROUP, EPISODE = 500_000, 1_000  # rows of a row group, of an episode
NAMED = ("--action", "a", "--reward", "r", "--episode", "episode", "--time", "t", "--terminal", "done")
SIZES = [f"x{index}" for index in range(12)] + [f"a_{index}" for index in range(4)] + ["r"]


def make(path: Path, rows: int) -> None:
    """Writes a table of 20 columns: episode, time, 12 observations, 4 actions, reward and terminal."""
    rng = np.random.default_rng(0)
    fields = [("episode", pa.int64()), ("t", pa.int64()), *((name, pa.float32()) for name in SIZES), ("done", pa.bool_())]
    schema = pa.schema(fields)
    with parquet.ParquetWriter(path, schema) as writer:
        for start in range(0, rows, GROUP):
            row = np.arange(start, min(start + GROUP, rows))
            numbers = [rng.standard_normal(len(row), dtype=np.float32) for _ in SIZES]
            columns = [row // EPISODE, row % EPISODE, *numbers, row % (2 * EPISODE) == 2 * EPISODE - 1]
            writer.write_table(pa.table(columns, schema=schema))


class Ended(NamedTuple):
    """A command that has ended: its words, seconds, peak of anonymous memory in GB, exit status, standard error and output."""

    command: list[str]
    seconds: float
    peak: float
    code: int
    told: str
    output: str


def ended(*command: str | Path, main: str = MAIN) -> Ended:
    """Runs a command of deadreckon, or another `main`, in a process of its own."""
    words, start, peak = list(map(str, command)), time.perf_counter(), 0
    with tempfile.TemporaryFile("w+") as told, tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen([sys.executable, "-c", main, *words], stdout=output, stderr=told)
        while process.poll() is None:
            lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
            peak = max([peak, *(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))])
            time.sleep(0.02)
        seconds = time.perf_counter() - start
        told.seek(0)
        output.seek(0)
        return Ended(words, seconds, peak * 1024 / 1e9, process.returncode, told.read(), output.read())


def run(*command: str | Path, main: str = MAIN) -> tuple[float, float, str]:
    """Seconds that a command takes, its peak of anonymous memory in GB, and what it tells; it must succeed."""
    done = ended(*command, main=main)
    if done.code:
        raise SystemExit(f"{command} failed: {done.told}")
    return done.seconds, done.peak, done.told


def updates(log: Path, runs: Path, steps: int, stream: bool) -> tuple[float, float]:
    """Updates per second of TD3+BC, and the peak of memory."""
    asked = ("train", "--agent", "td3_bc", "--data", log, "--stream", str(stream), "--steps", str(steps))
    _, peak, told = run(*asked, "--out", runs / str(time.time_ns()))
    return float(re.findall(r"([\d,]+) updates/s", told)[-1].replace(",", "")), peak


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=100_000_000)
    parser.add_argument("--memory-rows", type=int, default=1_000_000, help="rows of the log in memory")
    parser.add_argument("--steps", type=int, default=5_000)
    parser.add_argument("--episodes", type=int, default=50, help="held-out episodes that a policy is judged on")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--pandas", action="store_true", help="only read the table with pandas")
    given = parser.parse_args()
    with measuring(), tempfile.TemporaryDirectory(prefix="larger-") as name:
        folder = Path(name)
        make(folder / "large.parquet", given.rows)
        size = (folder / "large.parquet").stat().st_size / 1e9
        print("| what | seconds | rows/s or updates/s | peak of RssAnon, GB |\n| --- | ---: | ---: | ---: |")
        if given.pandas:
            seconds, peak, _ = run(folder / "large.parquet", main=PANDAS)
            print(f"| pandas.read_parquet, {given.rows:,} x 20 | {seconds:.0f} | {given.rows / seconds:,.0f} | {peak:.2f} |")
            return
        make(folder / "small.parquet", given.memory_rows)
        seconds, peak, _ = run("data", "convert", folder / "large.parquet", folder / "large", *NAMED)
        what = f"convert {given.rows:,} x 20 ({size:.1f} GB)"
        print(f"| {what} | {seconds:.0f} | {given.rows / seconds:,.0f} | {peak:.2f} |", flush=True)
        (folder / "large.parquet").unlink()
        run("data", "convert", folder / "small.parquet", folder / "small", *NAMED)
        seconds, peak, _ = run("data", "info", folder / "large")
        print(f"| data info | {seconds:.0f} | {given.rows / seconds:,.0f} | {peak:.2f} |", flush=True)
        pairs = []
        for _ in range(given.pairs):
            large = updates(folder / "large", folder / "runs", given.steps, True)
            small = updates(folder / "small", folder / "runs", given.steps, False)
            pairs.append((large, small))
        for what, which in (("the folder, streamed", 0), (f"{given.memory_rows:,} rows in memory", 1)):
            rates, peaks = zip(*(pair[which] for pair in pairs), strict=True)
            print(f"| TD3+BC, {what} | | {statistics.median(rates):,.1f} | {max(peaks):.2f} |")
        ratios = [large[0] / small[0] for large, small in pairs]
        judged = folder / "judged"
        updates(folder / "large", judged, 10, True)
        asked = ("--policies", next(judged.iterdir()), "--estimators", "fqe", "--steps", "1000")
        seconds, peak, _ = run("ope", *asked, "--data", folder / "large", "--episodes", str(given.episodes))
        print(f"| ope (FQE), {given.episodes} held-out episodes | {seconds:.0f} | | {peak:.2f} |")
        print(f"\nRatio of the rates by pairs: {', '.join(f'{ratio:.2f}' for ratio in ratios)}")


if __name__ == "__main__":
    main()
