"""How long a policy takes for one row and for 10,000 rows of a table, by numpy alone and in JAX.

    python benchmarks/predict.py

Two layers of 256 units, twelve columns (`table_policy.py`). Times are those of `predict` from rows to named actions, in this
process; the median and the quartiles of many calls. Where other work shares the cores, the processor time is less. Exit code 1:
by numpy and by the clock, in the median, one row took 1 ms or more, or a table 100 ms.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import table_policy

import deadreckon as dr
from deadreckon.bench.idle import measuring
from deadreckon.policies import portable

ROWS, ONE, MANY = 10_000, 1e-3, 0.1  # rows of the data frame; seconds that are promised by numpy alone


def seconds(call, calls: int) -> tuple[list[float], float]:
    """Of each call, after some that do not count, and the mean processor time of all threads."""
    out, charged = [], 0.0
    for i in range(calls + calls // 10 + 1):
        start, before = time.perf_counter(), time.process_time()
        call()
        if i > calls // 10:
            out.append(time.perf_counter() - start)
            charged += time.process_time() - before
    return out, charged / len(out)


def main() -> int:
    frame = table_policy.table(ROWS, seed=1)
    cases = {
        "one row, a dictionary": (frame.iloc[1].to_dict(), 2_000),
        f"{ROWS:,} rows, a pandas data frame": (frame, 40),
        f"{ROWS:,} rows, a list of dictionaries": (frame.to_dict("records"), 40),
    }
    with tempfile.TemporaryDirectory() as folder:
        file = table_policy.saved(Path(folder) / "policy.npz")
        players = {"numpy": portable.load(file), "JAX": dr.load_policy(file)}
        print("| rows | player | ms, median [quartiles] | ms of processor time, mean |\n|---|---|---:|---:|")
        kept = True
        for name, (rows, calls) in cases.items():
            for player, policy in players.items():
                took, charged = seconds(lambda p=policy, r=rows: p.predict(r), calls)
                low, middle, high = (1e3 * each for each in statistics.quantiles(took, n=4))
                print(f"| {name} | {player} | {middle:.3g} [{low:.3g}, {high:.3g}] | {1e3 * charged:.3g} |")
                kept &= player != "numpy" or middle < 1e3 * (ONE if calls > 1_000 else MANY)
    return 0 if kept else 1


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
