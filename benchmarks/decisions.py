"""Whether a decision card can be trusted: `python benchmarks/decisions.py`, then `... --table`.

Logs of many kinds whose truth is known (`decision_study`), policies learned from four fifths of each, and rules that choose
one of them or none. A trial is a family and a seed, and one small file, so what is there is not done again. Seeds of the
development split are 0, 1, ..., those of the confirmatory one 1,000,000, ...; nothing is tuned on the latter.

The runner of `deadreckon bench` is not used: its jobs are cells of a suite (an agent, a log, a number of updates), and its
results count for one version of the package alone, while a log here, its policies and the old rules stay what they are when
the new rule changes.
"""

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ONE_THREAD = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
}  # fmt: skip


MAPS = 40_000  # pieces of memory that compiled programs may take before they are forgotten; a process may have 65,530


def one(family: str, seed: int, rules: list[str], path: str) -> float:
    """In a worker: a trial, and how long it took."""
    import jax
    from decision_study.trial import trial

    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MAPS:
        jax.clear_caches()
    began = time.perf_counter()
    trial(family, seed, rules, Path(path))
    return time.perf_counter() - began


def place(out: Path, family: str, seed: int) -> Path:
    """Where a trial's file lies."""
    return out / family / f"{seed}.json"


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--families", nargs="*", default=None, help="all by default")
    add("--trials", type=int, default=100, help="logs a family")
    add("--split", choices=["development", "confirmatory"], default="development", help="which seeds, and families")
    add("--rules", nargs="*", default=None, help="all by default; those that a file has are not done again")
    add("--redo", nargs="*", default=[], help="rules that are done again, where they have changed")
    add("--workers", type=int, default=2)
    add("--out", type=Path, default=Path("runs/decisions"))
    add("--table", action="store_true", help="print tables of what is there, and do nothing")
    return parser.parse_args()


def work(options: argparse.Namespace, families: list[str], rules: list[str]) -> int:
    """All trials that are not there yet; returns how many went wrong."""
    from decision_study.trial import seeds

    from deadreckon.files import read_json, write_json

    todo = [(family, seed) for seed in seeds(options.split, options.trials) for family in families]
    # Family by family, so that what is compiled for one log serves the next.
    todo.sort(key=lambda pair: families.index(pair[0]))
    for family, seed in todo:
        if options.redo and (path := place(options.out, family, seed)).exists():
            known = read_json(path)
            if set(options.redo) & set(known["rules"]):
                known["rules"] = {rule: said for rule, said in known["rules"].items() if rule not in options.redo}
                write_json(path, known)
    began, done, wrong, seconds = time.perf_counter(), 0, 0, 0.0
    with ProcessPoolExecutor(options.workers, get_context("spawn"), initializer=os.nice, initargs=(10,)) as pool:
        waiting = {pool.submit(one, f, s, rules, str(place(options.out, f, s))): (f, s) for f, s in todo}
        for each in as_completed(waiting):
            done += 1
            try:
                seconds += each.result()
            except Exception as error:  # noqa: BLE001 - the others go on, and this one is tried again by the next command
                wrong += 1
                print(f"\n{waiting[each]}: {type(error).__name__}: {error}", file=sys.stderr)
            left = (time.perf_counter() - began) / done * (len(todo) - done)
            words = f"\r{done:,} of {len(todo):,} logs, {seconds / done:.2f} s each, {left / 60:.0f} min to go, {wrong} failed"
            print(words, end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return wrong


def main() -> int:
    os.environ |= ONE_THREAD  # before anything starts threads; the workers inherit it
    options = parse()
    from decision_study import FAMILIES
    from decision_study.rules import RULES
    from decision_study.summary import tables
    from decision_study.trial import CONFIRM

    from deadreckon.files import read_json

    confirm = options.split == "confirmatory"
    families = options.families or [name for name, family in FAMILIES.items() if confirm or family.split == "development"]
    for name in families:
        if name not in FAMILIES or (FAMILIES[name].split == "confirmatory" and not confirm):
            print(f"error: no {options.split} family {name!r}; there are {', '.join(FAMILIES)}", file=sys.stderr)
            return 2
    rules = options.rules or list(RULES)
    if not options.table:
        return 1 if work(options, families, rules) else 0
    files = [path for name in families for path in sorted((options.out / name).glob("*.json"), key=lambda p: int(p.stem))]
    trials = [read_json(path) for path in files if (int(path.stem) >= CONFIRM) == confirm]
    if not trials:
        print(f"error: no {options.split} trials in {options.out}", file=sys.stderr)
        return 2
    print(tables(trials, rules, {name: family.better for name, family in FAMILIES.items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
