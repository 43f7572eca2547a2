"""Import times beside d3rlpy's, and the memory that fitted Q evaluation of eleven policies takes on a million transitions.

    python benchmarks/footprint.py

Each import is a process of its own; they take turns. The memory is the peak of a process that makes the log, asks the policies,
and updates all critics (peak resident set, so with the log itself, Python and JAX).
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import peers
import protocol

from deadreckon.bench.idle import measuring

ROWS, UPDATES, LIMIT = 1_000_000, 60, 2.0


def import_seconds(python: Path | str, statement: str) -> float:
    code = f"import time; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"
    return float(said([str(python), "-c", code])[0])


def memory(rows: int) -> tuple[float, float]:
    """Peak GB of FQE with a critic for each of eleven policies, and the seconds until it could begin; in a fresh process."""
    import ours

    start = time.perf_counter()
    options = protocol.options("fqe-11", batch=256, width=256, threads=2, rows=rows)
    run = ours.make_ours("fqe-11", options)
    ready = time.perf_counter()
    run(UPDATES)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9  # kibibytes on Linux
    return peak, ready - start


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peer-python", type=Path, help="Python with d3rlpy (default: .cache/peer, made if absent)")
    parser.add_argument("--repeats", type=int, default=5, help="imports of each kind")
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--memory-only", action="store_true", help="what the driver starts for the memory")
    arguments = parser.parse_args()
    if arguments.memory_only:
        print(*memory(arguments.rows))
        return 0
    return protocol.told(lambda: report(arguments))


def said(command: list[str]) -> list[str]:
    """The words that a process prints last, on the CPU."""
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "JAX_PLATFORMS": "cpu"})
    if done.returncode:
        raise protocol.BenchError(f"{' '.join(command[:3])} failed: {done.stderr.strip().splitlines()[-1]}")
    return done.stdout.splitlines()[-1].split()


def report(arguments: argparse.Namespace) -> int:
    """Measures and prints."""
    peer = arguments.peer_python or peers.setup(sys.executable)
    if not peers.ready(peer):
        raise protocol.BenchError(f"{peer} has not d3rlpy {peers.D3RLPY} with torch {peers.TORCH}")
    cases = {
        "import deadreckon": (sys.executable, "import deadreckon"),
        "import deadreckon.ope": (sys.executable, "import deadreckon.ope"),
        "import d3rlpy": (peer, "import d3rlpy"),
        "import d3rlpy.ope": (peer, "import d3rlpy.ope"),
    }
    times: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(arguments.repeats + 1):  # the first of each fills the disk's cache and does not count
        for name, case in cases.items():
            times[name].append(import_seconds(*case))
    print("| import | seconds, median |\n|---|---:|")
    for name, found in times.items():
        print(f"| `{name}` | {statistics.median(found[1:]):.2f} |")
    command = [sys.executable, __file__, "--memory-only", "--rows", str(arguments.rows)]
    peak, ready = map(float, said(command))
    print(f"\nFQE of {protocol.POLICIES} policies on {arguments.rows:,} transitions: {peak:.2f} GB at the peak", end="")
    print(f"; log, actions of all policies and critics were ready after {ready:.0f} s")
    return 0 if peak < LIMIT or arguments.rows != ROWS else 1


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
